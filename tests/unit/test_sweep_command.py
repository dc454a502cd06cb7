"""`dlgmd sweep`: its numbers are those of `run`, and what was computed is never lost."""

import csv
import json
import math
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import N_FRAMES, looming_frames, write_video

import dlgmd_cli
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.parameters import DlgmdParameters

CUBES = "dlgmd-out/sweep-translating-cubes"
FILES = {"sweep.csv", "sweep.jsonl", "sweep.yaml"}
SMALL = ["--size", "40x30", "--cube-size", 8]
TINY = [*SMALL, "--x", "sigma_e=0.5,1", "--y", "sigma_i=1.5:2.5:0.5", "--no-plots"]


def rows(path):
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def record(folder):
    return yaml.safe_load(Path(folder, "sweep.yaml").read_text(encoding="utf-8"))


def summary_of_run(dlgmd, *arguments):
    result = dlgmd("run", *arguments, "--no-plots", "--json", "--overwrite")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_files_and_columns(dlgmd):
    result = dlgmd("sweep", *TINY[:-1], "--format", "svg", "--format", "png")
    assert result.exit_code == 0, result.output
    assert set(os.listdir(CUBES)) == FILES | {"sweep.png", "sweep.svg"}
    assert os.listdir("dlgmd-out") == ["sweep-translating-cubes"]
    assert result.stdout.splitlines()[-1] == os.path.join(*CUBES.split("/"))
    found = rows(f"{CUBES}/sweep.csv")
    assert list(found[0]) == ["sigma_e", "sigma_i", "speed_px", "attenuation_db"]
    assert len(found) == 2 * 3 * 4
    keys = [(row["speed_px"], row["sigma_i"], row["sigma_e"]) for row in found]
    assert keys[:3] == [("1", "1.5", "0.5"), ("1", "1.5", "1"), ("1", "2", "0.5")]
    assert len(set(keys)) == len(keys)


def test_attenuation_is_that_of_the_paper_s_fig_11(dlgmd):
    result = dlgmd("sweep", "--x", "sigma_e=1.1", "--y", "sigma_i=1.5", "--no-plots")
    assert result.exit_code == 0
    found = [round(float(row["attenuation_db"]), 1) for row in rows(f"{CUBES}/sweep.csv")]
    assert found == [-12.8, -0.8, 1.4, 2.3]


def test_cubes_at_three_points_are_what_run_says_of_their_clips(dlgmd):
    grid = ["--x", "sigma_e=0.4:1.1:0.35", "--y", "sigma_i=1.5,4"]
    assert dlgmd("sweep", *grid, "--no-plots", "--jobs", 2).exit_code == 0
    cubes = record(CUBES)["sweep"]["cubes"]
    assert cubes == {
        "speeds_px": [1.0, 2.0, 3.0, 4.0],
        "side_px": 40.0,
        "frames": 41,
        "width": 200,
        "height": 150,
    }
    found = {
        (float(r["sigma_e"]), float(r["sigma_i"]), float(r["speed_px"])): r["attenuation_db"]
        for r in rows(f"{CUBES}/sweep.csv")
    }
    for sigma_e, sigma_i, speed in ((0.4, 1.5, 4.0), (1.1, 1.5, 1.0), (0.75, 4.0, 3.0)):
        clip = f"synth translating-cubes --speed {speed} --size 200x150 --contrast -1"
        clip += " --background 1 --object-size 40 --frames 41 --lossless --overwrite"
        assert dlgmd(*clip.split()).exit_code == 0
        changed = {"alpha": 0, "beta": 0, "lam": 0, "a": 1.5, "r": 4}
        changed |= {"sigma_e": sigma_e, "sigma_i": sigma_i}
        params = [text for key, value in changed.items() for text in ("--param", f"{key}={value}")]
        summary = summary_of_run(dlgmd, "translating-cubes.avi", "--scale", 1, *params)
        assert found[sigma_e, sigma_i, speed] == f"{summary['mean_attenuation_db']:.9g}"


@pytest.mark.parametrize(
    "options",
    [
        [],
        ["--normalise", "sequence", "--size", "24x18", "--param", "kappa=100", "--param", "n_sp=1"],
    ],
)
def test_a_video_at_three_points_is_what_run_says(dlgmd, clips, options):
    grid = ["--x", "r=2:6:2", "--y", "sigma_i=1,5", "--param", "a=0.8"]
    result = dlgmd("sweep", clips / "loom.avi", *grid, *options, "--no-plots", "--jobs", 1)
    assert result.exit_code == 0, result.output
    found = {(r["r"], r["sigma_i"]): r for r in rows("dlgmd-out/sweep-loom/sweep.csv")}
    assert list(found) == [(r, s) for s in ("1", "5") for r in ("2", "4", "6")]
    columns = list(found["2", "1"])
    assert columns == [
        *("r", "sigma_i", "mp_max", "mp_max_frame", "sharpness", "distinguishability"),
        *("first_collision_frame", "first_collision_time_s", "mean_attenuation_db"),
    ]
    for r, sigma_i in (("2", "1"), ("6", "5"), ("4", "1")):
        params = ["--param", f"r={r}", "--param", f"sigma_i={sigma_i}", "--param", "a=0.8"]
        summary = summary_of_run(dlgmd, clips / "loom.avi", *params, *options)
        for column in set(columns) & set(summary):
            value = summary[column]
            shown = "" if value is None else f"{value:.9g}"
            assert found[r, sigma_i][column] == shown, column
        assert found[r, sigma_i]["first_collision_frame"] != "" or not options
        mp = [float(row["mp"]) for row in rows("dlgmd-out/loom/mp.csv") if row["mp"]]
        mean = np.mean(mp) / max(mp)
        assert float(found[r, sigma_i]["sharpness"]) == pytest.approx(mean, rel=1e-6)
        assert found[r, sigma_i]["distinguishability"] == ""


@pytest.mark.parametrize("model", ["lgmd", "emd-lgmd"])
def test_other_models(dlgmd, clips, model):
    grid = ["--x", {"lgmd": "w_i=0.2:0.4:0.1", "emd-lgmd": "tau_low=1:3:1"}[model]]
    grid += ["--y", "t_mp=0.3,0.6", "--model", model, "--no-plots"]
    assert dlgmd("sweep", clips / "loom.avi", *grid).exit_code == 0
    key = grid[1].partition("=")[0]
    (row,) = [
        r
        for r in rows("dlgmd-out/sweep-loom/sweep.csv")
        if float(r[key]) == pytest.approx({"lgmd": 0.3, "emd-lgmd": 2}[model])
        and r["t_mp"] == "0.3"
    ]
    summary = summary_of_run(dlgmd, clips / "loom.avi", "--model", model, "--param", "t_mp=0.3")
    assert row["mp_max"] == f"{summary['mp_max']:.9g}"
    assert row["mean_attenuation_db"] == f"{summary['mean_attenuation_db']:.9g}"


def test_distinguishability_may_be_infinite_and_that_is_said(dlgmd, tmp_path):
    frames = looming_frames(24, 96, 72)
    write_video(tmp_path / "late.avi", frames[:1] * 14 + frames, fourcc="FFV1")
    grid = ["--x", "sigma_e=1,1.5", "--y", "a=0.5,100", "--false-positive-frame", 5]
    result = dlgmd("sweep", "late.avi", *grid)
    assert result.exit_code == 0
    assert "inf: no membrane potential within 5 frames of the false positive" in result.stdout
    found = [row["distinguishability"] for row in rows("dlgmd-out/sweep-late/sweep.csv")]
    assert found == ["inf", "inf", "", ""]
    grid[-1] = 37
    result = dlgmd("sweep", "late.avi", *grid, "--out", "o", "--no-plots")
    found = [float(r["distinguishability"] or "nan") for r in rows("o/sweep-late/sweep.csv")]
    assert all(1.0 <= value < 2.0 for value in found[:2]) and "inf" not in result.stdout


def test_points_that_are_not_possible_are_cells_without_a_value(dlgmd):
    grid = ["--x", "alpha=-1,0", "--y", "sigma_e=0,1", "--speed", 2]
    result = dlgmd("sweep", *SMALL, *grid)
    assert result.exit_code == 0
    warnings = [line for line in result.stderr.splitlines() if line.startswith("Warning")]
    assert warnings == ["Warning: 2 of 4 points cannot be computed: sigma_e = 0.0 is not above 0."]
    found = {(r["alpha"], r["sigma_e"]): r["attenuation_db"] for r in rows(f"{CUBES}/sweep.csv")}
    assert [bool(value) for value in found.values()] == [False, False, True, True]
    assert record(CUBES)["summary"] == {"points": 4, "computed": 2, "impossible": 2}


def test_base_parameters(dlgmd, tmp_path):
    def base(*options):
        assert dlgmd("sweep", *TINY, *options, "--overwrite").exit_code == 0
        return record(CUBES)

    paper = {**DlgmdParameters().to_dict(), "alpha": 0, "beta": 0, "lam": 0, "a": 1.5, "r": 4}
    del paper["sigma_e"], paper["sigma_i"]
    assert paper.items() <= base().items()
    assert {**paper, "a": 2}.items() <= base("--param", "a=2").items()
    assert {**paper, "formulation": "released"}.items() <= base("--formulation", "released").items()
    assert base("--model", "dlgmd")["r"] == 4
    assert base("--set", 9)["r"] == 6 and base("--set", 4)["lam"] == 0.7
    (tmp_path / "my.yaml").write_text("r: 3\n")
    assert base("--config", "my.yaml")["r"] == 3 and base("--config", "my.yaml")["lam"] == 0.7


def test_the_record_is_a_config(dlgmd, clips):
    options = ["--x", "r=2,3", "--y", "a=1,1.5", "--no-plots"]
    first = [*options, "--set", 5, "--scale", 0.75, "--param", "sigma_e=0.5"]
    assert dlgmd("sweep", clips / "loom.avi", *first).exit_code == 0
    again = [*options, "--config", "dlgmd-out/sweep-loom/sweep.yaml", "--out", "again"]
    assert dlgmd("sweep", clips / "loom.avi", *again).exit_code == 0
    one, other = (Path(out, "sweep-loom/sweep.csv") for out in ("dlgmd-out", "again"))
    assert one.read_bytes() == other.read_bytes()
    found = record("dlgmd-out/sweep-loom")
    assert found["sweep"] == {
        "x": {"key": "r", "values": [2, 3]},
        "y": {"key": "a", "values": [1.0, 1.5]},
        "false_positive_frame": None,
    }
    assert found["input"]["frames"] == found["processed"]["frames"] == N_FRAMES
    assert found["processed"]["width"] == 24 and found["options"] == {"scale": 0.75}
    assert (found["complete"], found["engine"], found["sigma_e"]) == (True, "opencv", 0.5)
    assert found["versions"].keys() == {"dlgmd", "python", "numpy", "opencv"}
    assert dlgmd("sweep", *TINY).exit_code == 0
    assert dlgmd("sweep", *TINY, "--config", f"{CUBES}/sweep.yaml", "--out", "b").exit_code == 0
    same = Path("b/sweep-translating-cubes/sweep.csv").read_bytes()
    assert same == Path(CUBES, "sweep.csv").read_bytes()


def test_a_finished_sweep_is_only_drawn_again(dlgmd, monkeypatch):
    assert dlgmd("sweep", *TINY, "--jobs", 1).exit_code == 0
    before = Path(CUBES, "sweep.csv").read_bytes()
    monkeypatch.setattr(DLGMD, "respond", None)
    result = dlgmd("sweep", *TINY[:-1], "--format", "pdf", "--jobs", 1)
    assert result.exit_code == 0, result.output
    assert result.stderr == "6 of 6 points were there already.\n"
    assert set(os.listdir(CUBES)) == FILES | {"sweep.pdf"}
    assert Path(CUBES, "sweep.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("options", "differing"),
    [
        (["--y", "sigma_i=1.5"], "y"),
        (["--param", "k=2"], "parameters"),
        (["--speed", 1], "cubes"),
        (["--size", "42x30"], "cubes"),
        (["--model", "dlgmd", "--set", 9], "parameters"),
    ],
)
def test_other_settings_are_refused(dlgmd, options, differing):
    assert dlgmd("sweep", *TINY).exit_code == 0
    Path(CUBES, "notes.txt").write_text("mine")
    before = Path(CUBES, "sweep.csv").read_bytes()
    result = dlgmd("sweep", *TINY, *options)
    assert result.exit_code == 2
    assert result.stderr == (
        f"Error: {os.path.join(*CUBES.split('/'))}: a result of other settings stands here "
        f"({differing}). Add --overwrite to start anew, or choose another --out.\n"
    )
    assert Path(CUBES, "sweep.csv").read_bytes() == before
    assert dlgmd("sweep", *TINY, *options, "--overwrite").exit_code == 0
    assert Path(CUBES, "sweep.csv").read_bytes() != before or differing == "parameters"
    assert Path(CUBES, "notes.txt").read_text() == "mine"


def test_another_input_of_the_same_name_is_refused(dlgmd, tmp_path):
    write_video(tmp_path / "clip.avi", looming_frames())
    options = ["clip.avi", "--x", "r=2,3", "--y", "a=1,2", "--no-plots"]
    assert dlgmd("sweep", *options).exit_code == 0
    write_video(tmp_path / "clip.avi", looming_frames(12))
    result = dlgmd("sweep", *options)
    assert result.exit_code == 2 and "other settings stands here (input)" in result.stderr


def test_pictures_are_told_apart_by_their_files(dlgmd, pictures, tmp_path):
    copy = tmp_path / "shots"
    copy.mkdir()
    for path in pictures.iterdir():
        (copy / path.name).write_bytes(path.read_bytes())
    options = ["--input-fps", 30, "--x", "r=2,3", "--y", "a=1,2", "--no-plots"]
    for shots in ("shots", "shots/%d.png"):
        assert dlgmd("sweep", shots, *options, "--overwrite").exit_code == 0
        again = dlgmd("sweep", shots, *options)
        assert again.stderr == "4 of 4 points were there already.\n"
        os.utime(copy / "3.png", ns=(1, len(shots)))
        assert "other settings stands here (input)" in dlgmd("sweep", shots, *options).stderr


LONG = ["sweep", "--x", "sigma_e=0.2:2:0.2", "--y", "sigma_i=0.5:6:0.5", "--no-plots"]


def process(*arguments):
    root = Path(dlgmd_cli.__file__).parents[1]
    return subprocess.Popen(
        [sys.executable, "-m", "dlgmd_cli", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(root)},
        start_new_session=True,
    )


def lines_of_journal(folder=CUBES):
    path = Path(folder, "sweep.jsonl")
    return path.read_bytes().count(b"\n") if path.exists() else 0


def until(condition, running):
    deadline = time.monotonic() + 60
    while not condition() and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.005)


def leftovers():
    return set(Path(os.environ.get("TMPDIR", "/tmp")).glob("dlgmd-*"))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The table of the long sweep, by one process."""
    folder = tmp_path_factory.mktemp("undisturbed")
    done = process(*LONG, "--jobs", 1, "--out", folder)
    _, errors = done.communicate(timeout=300)
    assert done.returncode == 0, errors
    return (folder / "sweep-translating-cubes/sweep.csv").read_bytes()


@pytest.mark.skipif(sys.platform == "win32", reason="needs signals")
@pytest.mark.parametrize("jobs", [1, 2])
def test_an_interrupted_sweep_goes_on(dlgmd, undisturbed, jobs, tmp_path, monkeypatch):
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    running = process(*LONG, "--jobs", jobs)
    until(lambda: lines_of_journal() > 8, running)
    os.killpg(running.pid, signal.SIGINT)  # as a terminal does
    _, errors = running.communicate(timeout=60)
    assert running.returncode == 130, errors
    assert "Traceback" not in errors
    assert leftovers() == set()
    match = re.fullmatch(
        r"Interrupted; writing what was computed\.\n"
        r"\S+sweep-translating-cubes keeps (\d+) of 120 points; "
        r"the same command goes on from there\.\n",
        errors,
    )
    assert match, errors
    kept = int(match[1])
    assert 6 < kept < 120
    assert record(CUBES)["complete"] is False
    assert len(rows(f"{CUBES}/sweep.csv")) == 4 * kept
    result = dlgmd(*LONG, "--jobs", 3 - jobs)
    assert result.exit_code == 0
    there = re.match(r"(\d+) of 120 points were there already\.", result.stderr)
    assert int(there[1]) in (kept, kept + 1)
    assert Path(CUBES, "sweep.csv").read_bytes() == undisturbed
    assert record(CUBES)["complete"] is True


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_killed_sweep_goes_on_and_leaves_no_process(dlgmd, undisturbed, tmp_path, monkeypatch):
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    running = process(*LONG, "--jobs", 2)
    until(lambda: lines_of_journal() > 8, running)
    children = workers_of(running.pid)
    running.kill()
    running.communicate(timeout=60)
    assert len(children) == 2
    with Path(CUBES, "sweep.jsonl").open("ab") as journal:
        journal.write(b"[119, [[-3.0], [")
    deadline = time.monotonic() + 30
    while any(Path(f"/proc/{pid}").exists() for pid in children) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not any(Path(f"/proc/{pid}").exists() for pid in children)
    assert leftovers() == set()
    result = dlgmd(*LONG, "--jobs", 2)
    assert result.exit_code == 0 and "points were there already" in result.stderr
    assert Path(CUBES, "sweep.csv").read_bytes() == undisturbed


def workers_of(pid):
    """The worker processes of a sweep."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == pid and b"runs.serve" in (entry / "cmdline").read_bytes():
                found.append(int(entry.name))
        except (OSError, ValueError):
            continue
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_worker_that_dies_loses_no_point_that_was_done(dlgmd, undisturbed, tmp_path):
    running = process(*LONG, "--jobs", 2)
    until(lambda: lines_of_journal() > 8, running)
    os.kill(workers_of(running.pid)[0], signal.SIGKILL)
    _, errors = running.communicate(timeout=60)
    assert running.returncode == 1, errors
    kept, error = errors.splitlines()
    assert re.fullmatch(r"\S+ keeps \d+ of 120 points; the same command goes on from there\.", kept)
    assert error == (
        "Error: a worker process: it was killed by signal 9, as happens when memory runs out. "
        "Use fewer with --jobs, or process smaller frames."
    )
    assert dlgmd(*LONG).exit_code == 0
    assert Path(CUBES, "sweep.csv").read_bytes() == undisturbed


@pytest.mark.skipif(sys.platform == "win32", reason="its locks are others")
def test_two_sweeps_into_one_folder(dlgmd, undisturbed):
    running = process(*LONG, "--jobs", 1)
    until(lambda: lines_of_journal() > 2, running)
    result = dlgmd(*LONG, "--overwrite")
    assert result.exit_code == 2
    assert result.stderr == (
        f"Error: {os.path.join(*CUBES.split('/'))}: another 'dlgmd' is writing here. "
        "Wait for it, or choose another --out.\n"
    )
    running.communicate(timeout=120)
    assert Path(CUBES, "sweep.csv").read_bytes() == undisturbed


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_interrupted_while_the_workers_start(dlgmd):
    running = process(*LONG, "--jobs", 2)
    until(lambda: workers_of(running.pid), running)
    time.sleep(0.1)  # in the midst of importing
    os.killpg(running.pid, signal.SIGINT)
    _, errors = running.communicate(timeout=60)
    assert running.returncode == 130 and "Traceback" not in errors
    assert errors.startswith("Interrupted")


def test_interrupted_before_the_first_point(dlgmd, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(DLGMD, "respond", interrupted)
    result = dlgmd("sweep", *TINY, "--jobs", 1)
    assert result.exit_code == 130 and result.stderr == "Interrupted.\n"


def test_an_internal_error_keeps_the_points(dlgmd, monkeypatch):
    respond, calls = DLGMD.respond, []

    def failing(self, view, **options):
        calls.append(1)
        if len(calls) > 200:
            raise IndexError
        return respond(self, view, **options)

    monkeypatch.setattr(DLGMD, "respond", failing)
    result = dlgmd("sweep", *TINY, "--jobs", 1)
    assert result.exit_code == 1 and "internal error (IndexError)" in result.stderr
    kept = re.search(r"keeps (\d+) of 6 points", result.stderr)
    monkeypatch.setattr(DLGMD, "respond", respond)
    again = dlgmd("sweep", *TINY)
    assert again.exit_code == 0 and again.stderr == f"{kept[1]} of 6 points were there already.\n"


USAGE = [
    ("--y r=4", "Missing option '--x'"),
    ("--x a=1 --y r", "Invalid value for '--y': 'r' is no axis"),
    ("--x a=1:2 --y r=4", "Invalid value for '--x': '1:2' is not FROM:TO:STEP"),
    ("--x q=1 --y r=4", "Invalid value for '--x': unknown parameter 'q'"),
    ("--x a=1 --y r=2.5", "Invalid value for '--y': r = 2.5 is not a whole number"),
    ("--x a=1 --y a=2", "--x and --y are both a"),
    ("--x a=-2:-1:0.5 --y r=4", "--x and --y: a = -2.0 is not at least 0"),
    ("--x w_i=1 --y a=1", "unknown parameter 'w_i'"),
    ("--x a=1 --y r=4 --model lgmd", "unknown parameter 'a'. See 'dlgmd sets show lgmd'"),
    ("--x a=1 --y r=4 --param a=2", "--param sets a, which is an axis"),
    (
        "--x formulation=default,released --y r=4 --formulation default",
        "--formulation sets what is an axis",
    ),
    ("--x a=1 --y r=4 --scale 0.5", "--scale is of an INPUT, and there is none"),
    ("--x a=1 --y r=4 --input-fps 5", "--input-fps is of an INPUT"),
    ("--x a=1 --y r=4 --normalise sequence", "--normalise is of an INPUT"),
    ("--x a=1 --y r=4 --decoder pyav", "--decoder is of an INPUT"),
    ("--x a=1 --y r=4 --false-positive-frame 5", "--false-positive-frame is of an INPUT"),
    ("--x a=1 --y r=4 --speed 0", "Invalid value for '--speed'"),
    ("--x a=1 --y r=4 --speed nan", "Invalid value for '--speed'"),
    ("--x a=1 --y r=4 --speed 159", "--frames: 1 frame of each cube, but fig11 needs at least 3"),
    ("--x a=1 --y r=4 --frames 2", "--frames: 2 frames of each cube, but fig11 needs at least 3"),
    ("--x a=1 --y r=4 --frames 99 --speed 9", "leaves the picture after 18 frames"),
    ("--x a=1 --y r=4 --cube-size 151", "cannot stand in a picture of 200x150"),
    ("--x a=1 --y r=4 --size 9x9", "Invalid value for '--size'"),
    ("--x a=1 --y r=4 --jobs 0", "--jobs"),
    ("--x a=1 --y r=4 --set 12", "there is no set 12"),
    ("--x w_i=1 --y delta_c=1 --model lgmd --engine numba", "has no engine 'numba'"),
    ("loom.avi --x a=1 --y r=4 --speed 1", "--speed is of the cubes that are shown without INPUT"),
    ("loom.avi --x a=1 --y r=4 --cube-size 3", "--cube-size is of the cubes"),
    ("loom.avi --x a=1 --y r=4 --frames 3", "--frames is of the cubes"),
    ("loom.avi --x a=1 --y r=4 --scale 1 --size 9x9", "--scale and --size exclude each other"),
]


@pytest.mark.parametrize(("line", "why"), USAGE, ids=[line for line, _ in USAGE])
def test_wrong_usage_is_exit_2(dlgmd, line, why):
    result = dlgmd("sweep", *shlex.split(line))
    assert result.exit_code == 2 and result.stdout == ""
    error = result.stderr.splitlines()[-1]
    assert error.startswith("Error: ") and why in error
    assert os.listdir(".") == []


def test_wrong_axes_import_nothing_heavy():
    program = (
        "import sys\n"
        "from dlgmd_cli.app import main\n"
        "sys.argv = ['dlgmd', 'sweep', '--x', 'r=1:2', '--y', 'a=1']\n"
        "try:\n    main()\n"
        "except SystemExit: pass\n"
        "print(sorted({'cv2', 'matplotlib', 'numpy', 'yaml'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("none.mp4", "none.mp4: there is no such file or folder"),
        ("text.mp4", "text.mp4: no frame could be decoded"),
        ("short.avi", "short.avi: 3 frames, but set9 needs at least 4. Use a longer clip."),
    ],
)
def test_bad_input_is_exit_1(dlgmd, tmp_path, name, why):
    (tmp_path / "text.mp4").write_bytes(b"hello")
    write_video(tmp_path / "short.avi", looming_frames(3))
    before = sorted(os.listdir("."))
    result = dlgmd("sweep", name, "--x", "sigma_e=1,2", "--y", "a=1,2")
    assert result.exit_code == 1 and result.stdout == ""
    assert why in result.stderr and result.stderr.count("\n") == 1
    assert sorted(os.listdir(".")) == before


def test_warnings_of_the_input_are_kept(dlgmd, tmp_path):
    write_video(tmp_path / "still.avi", looming_frames(1) * 8)
    options = ["still.avi", "--x", "r=2,3", "--y", "a=1,2"]
    for _ in range(2):
        result = dlgmd("sweep", *options)
        assert result.exit_code == 0
        assert "Warning: still.avi: no picture differs from the one before it" in result.stderr
    assert len(record("dlgmd-out/sweep-still")["warnings"]) == 1
    found = rows("dlgmd-out/sweep-still/sweep.csv")
    assert {(r["mp_max"], r["sharpness"], r["mean_attenuation_db"]) for r in found} == {
        ("0", "", "")
    }


def test_an_out_that_cannot_be_written(dlgmd, tmp_path):
    (tmp_path / "file").write_text("mine")
    result = dlgmd("sweep", *TINY, "--out", "file")
    assert result.exit_code == 1 and "cannot be written" in result.stderr
    Path(CUBES).mkdir(parents=True)
    Path(CUBES, "sweep.png").write_text("mine")
    result = dlgmd("sweep", *TINY, "--overwrite")
    assert result.exit_code == 2
    assert "this folder holds other files, such as sweep.png" in result.stderr
    assert Path(CUBES, "sweep.png").read_text() == "mine"


def test_nothing_passes_is_minus_infinity(dlgmd):
    grid = ["--x", "sigma_e=0.2,1.4", "--y", "sigma_i=5", "--speed", 1, "--set", 9]
    assert dlgmd("sweep", *grid, "--no-plots").exit_code == 0
    found = [row["attenuation_db"] for row in rows(f"{CUBES}/sweep.csv")]
    assert math.isfinite(float(found[0])) and found[1] == "-inf"
