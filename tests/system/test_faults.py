"""Whatever befalls a run, it ends with a whole result or one clear line, and nothing else."""

import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest
from click.testing import CliRunner
from conftest import looming_frames, until, write_video
from damaged import all_inputs
from disturbed import (
    PATIENCE_S,
    environment,
    faults_of,
    hidden_in,
    results_of,
    small_disk,
    small_files,
    started,
)
from kills import COMMANDS, Campaign

from dlgmd_cli.commands.app import cli
from dlgmd_cli.machine.pool import run_tasks
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.record import read_record

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="signals and limits differ there"),
]
THOROUGH = bool(os.environ.get("DLGMD_THOROUGH"))
N_KILLS = 250 if THOROUGH else 8


def run(*arguments):
    return CliRunner().invoke(cli, ["run", *map(str, arguments)], prog_name="dlgmd")


def one_line(result):
    """The error that a failed run says last and once."""
    lines = result.stderr.splitlines()
    assert [line for line in lines if line.startswith("Error: ")] == lines[-1:], result.stderr
    assert "internal error" not in result.stderr
    return lines[-1]


def try_input(decoder, out, case):
    """How a run over an input ended, and what is wrong about it; called in a process of a pool."""
    out = out / f"{case.path.parent.name}-{case.name.replace('/', '_').replace('.', '-')}"
    result = run(case.path, "--out", out, "--decoder", decoder, "--no-plots")
    faults = [*faults_of(out), *(hidden_in(out) if out.exists() else [])]
    if result.exit_code not in (0, 1) or "internal error" in result.stderr:
        faults.append(f"exit code {result.exit_code}: {result.stderr} {result.exception!r}")
    if result.exit_code != {"error": 1, "recovers": 0}.get(case.expected, result.exit_code):
        faults.append(f"expected {case.expected}, but: {result.stderr}")
    # Where nothing can be seen, the result is kept.
    is_left = out.exists() and "nothing can be seen" not in result.stderr
    if result.exit_code == 1 and (is_left or result.stderr.count("Error: ") != 1):
        faults.append(f"left {out}, or not one line: {result.stderr}")
    if result.exit_code == 0 and len(list(out.glob(f"*/{store.RUN}"))) != 1:
        faults.append("no result")
    return result.exit_code, faults


@pytest.mark.parametrize("decoder", ["opencv", *(["pyav"] if find_spec("av") else [])])
def test_inputs(tmp_path, decoder):
    inputs = all_inputs(tmp_path / "inputs")
    function, endings = partial(try_input, decoder, tmp_path / "out"), set()
    for case, outcome in run_tasks(function, inputs, 2, timeout_s=PATIENCE_S):
        exit_code, faults = outcome.result()  # raises if it took its process with it
        assert faults == [], case
        endings.add(exit_code)
    assert endings == {0, 1}


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    return write_video(tmp_path_factory.mktemp("clip") / "clip.avi", looming_frames(20, 64, 48))


@pytest.fixture(scope="module")
def whole(tmp_path_factory, clip):
    """The files of an undisturbed run."""
    out = tmp_path_factory.mktemp("whole")
    assert run(clip, "--out", out, "--no-plots").exit_code == 0
    return results_of(out)


def then_as_ever(out, path, whole):
    """Another run gives what an undisturbed one does, and leaves nothing else."""
    assert run(path, "--out", out, "--no-plots", "--overwrite").exit_code == 0
    found = results_of(out)
    assert found == {name: data for name, data in whole.items() if name in found}
    assert len(found) == 5 and hidden_in(out) == []


@pytest.mark.parametrize("command", COMMANDS)
def test_kills(tmp_path, monkeypatch, command):
    """The old result is whole, or the new one, or there is none; and the next command works."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", environment()["PYTHONPATH"])
    cases = [*Campaign(tmp_path, command).cases(N_KILLS)]
    assert [case for case in cases if case.faults] == []


def test_a_disk_that_is_full(tmp_path, clip, whole):
    for size_kib in (0, 4, 8, 16):
        with small_disk(tmp_path / "disk", size_kib, 3 if size_kib == 0 else 64) as is_mounted:
            if not is_mounted:
                pytest.skip("this system does not permit to mount one")
            out = tmp_path / "disk/out"
            result = run(clip, "--out", out, "--no-plots")
            if result.exit_code == 0:
                assert size_kib == 16
            else:
                assert "cannot be written (No space left on device)" in one_line(result)
                assert not list(out.rglob(store.RUN)) and hidden_in(tmp_path / "disk") == []
            assert faults_of(out) == []
    then_as_ever(tmp_path / "out", clip, whole)


@pytest.mark.parametrize(
    ("n_bytes", "options"),
    [
        *((n_bytes, ("--no-plots",)) for n_bytes in (0, 1, 100, 500)),
        (500, ("--format", "svg")),
        (500, ("--format", "png")),
    ],
)
def test_files_that_may_not_grow(tmp_path, clip, whole, n_bytes, options):
    out = tmp_path / "out"
    then_as_ever(out, clip, whole)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    with small_files(n_bytes):
        result = run(clip, "--out", out, "--overwrite", *options)
    assert result.exit_code == 1 and "cannot be written (File too large)" in one_line(result)
    # What stands is gone only when the new result is whole.
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    then_as_ever(out, clip, whole)


@pytest.mark.parametrize("command", ["run", "batch"])
def test_places_that_cannot_be_written(clip, command):
    places = [clip / "out", Path("/dev/null/out"), Path("/proc/out"), Path("/sys/out")]
    for out in places:
        arguments = [command, str(clip), "--out", str(out), "--no-plots"]
        result = CliRunner().invoke(cli, arguments, prog_name="dlgmd")
        assert result.exit_code == 1 and "cannot be written (" in one_line(result)
        assert result.stderr.count("\n") == 1


def by_shell(tmp_path, script, *words):
    """What a shell makes of a script, in which {} stands for the command over a clip."""
    words = [sys.executable, "-m", "dlgmd_cli", *words, "--out", "out", "--no-plots"]
    return subprocess.run(
        ["bash", "-c", script.replace("{}", shlex.join(map(str, words)))],
        cwd=tmp_path,
        capture_output=True,
        timeout=PATIENCE_S,
        env=environment(),
        text=True,
    )


@pytest.mark.parametrize("memory_kb", range(150_000, 800_000, 200_000))
def test_memory_that_is_short(tmp_path, clip, whole, memory_kb):
    result = by_shell(tmp_path, f"ulimit -v {memory_kb} && {{}}", "run", clip)
    if result.returncode != 0:
        assert result.returncode == 1 and "not enough memory" in one_line(result)
        assert result.stderr.count("\n") == 1 and memory_kb < 700_000
    else:
        found = results_of(tmp_path / "out")
        assert len(found) == 5 and found.items() <= whole.items()


@pytest.mark.parametrize("n_files", [5, 10, 16])
@pytest.mark.parametrize("command", ["run", "batch"])
def test_descriptors_that_are_short(tmp_path, clip, whole, command, n_files):
    result = by_shell(tmp_path, f"ulimit -n {n_files} && {{}}", command, clip)
    found = results_of(tmp_path / "out")
    if result.returncode == 0:
        assert len(found) == 5 and found.items() <= whole.items()
    else:
        assert result.returncode == 1 and not found and one_line(result)
    assert command == "batch" or (result.returncode == 0) == (n_files > 5)


@pytest.mark.parametrize("n_threads", [2, 4, 8])
def test_threads_that_are_short(tmp_path, clip, whole, n_threads):
    """As a user whom limits apply to, but who may read everything."""
    if shutil.which("setpriv") is None or os.geteuid() != 0:
        pytest.skip("another user's limits are set as root, by setpriv")
    tmp_path.chmod(0o777)
    may = "+dac_override,+dac_read_search"
    user = f"setpriv --reuid 65534 --clear-groups --inh-caps {may} --ambient-caps {may}"
    result = by_shell(tmp_path, f"ulimit -u {n_threads} && exec {user} {{}}", "run", clip)
    assert (result.returncode, result.stderr) == (0, "")
    found = results_of(tmp_path / "out")
    assert len(found) == 5 and found.items() <= whole.items()


STREAMS = {
    "stdout closed": (">&-", {0}),
    "stderr closed": ("2>&-", {0}),
    "all closed": ("<&- >&- 2>&-", {0}),
    "stdout full": (">/dev/full", {0, 1}),
    "reader gone": ("| true", {0, 1}),
    "reader leaves": ("| head -1", {0, 1}),
}


@pytest.mark.parametrize("command", ["run", "batch"])
@pytest.mark.parametrize("name", STREAMS)
def test_streams_that_nobody_reads(tmp_path, clip, whole, name, command):
    redirection, codes = STREAMS[name]
    # (The inner braces stand for the command.)
    done = by_shell(tmp_path, f"{{ {{}}; echo $? >code; }} {redirection}", command, clip)
    assert int((tmp_path / "code").read_text()) in codes
    assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr
    # The result is whole before anything is printed.
    found = results_of(tmp_path / "out")
    assert len(found) == 5 and (command == "batch" or found.items() <= whole.items())
    assert faults_of(tmp_path / "out") == []


@pytest.fixture(scope="module")
def longest_clip(tmp_path_factory):
    frames = looming_frames(20, 320, 240) * 150
    return write_video(tmp_path_factory.mktemp("clip") / "long.avi", frames)


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_in_the_middle(tmp_path, longest_clip, name):
    with started("run", longest_clip, "--no-plots", cwd=tmp_path) as process:
        # The lock is taken just before the first frame.
        until(lambda: list(tmp_path.glob("dlgmd-out/long/.dlgmd-*")), PATIENCE_S)
        time.sleep(0.3)
        process.send_signal(getattr(signal, name))
        _, said = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130 and "Traceback" not in said, said
    record = read_record(tmp_path / "dlgmd-out/long/run.yaml")
    assert record["complete"] is False and 0 < record["processed"]["frames"] < 3000
    assert set(os.listdir(tmp_path / "dlgmd-out/long")) == {store.RUN, csv.ALARMS, *csv.TABLES}
