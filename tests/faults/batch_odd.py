"""What users and systems do to a batch: streams, names, limits, and where things lie."""

import os
import shlex
import shutil
import subprocess
import sys
import time
import uuid
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from faults import THOROUGH
from faults.batch_bench import environment, without_survivors
from faults.batch_outcome import Ended, judge_batch, rows_of
from faults.outcome import HUNG, RECOVERED, Outcome
from faults.processes import PATIENCE_S

N_MANY = 3000 if THOROUGH else 1000
# Of so many files that are no videos, none may cost more than this.
_EACH_S = 0.02


def streams(bench):
    """Nobody reads what is printed, or nothing can be printed or read at all."""
    outcomes = []
    for name, shell, codes in (
        ("stdout closed", "{} >&-", {0}),
        ("stdin and stderr closed", "{} <&- 2>&-", {0}),
        ("all closed", "{} <&- >&- 2>&-", {0}),
        ("stdout full", "{} >/dev/full", {0, 1}),
        ("stderr full", "{} 2>/dev/full", {0, 1}),
        ("reader leaves", "{} | head -1", {0, 1}),
        ("reader of both gone", "{} 2>&1 | true", {0, 1}),
    ):
        if "full" in shell and not os.path.exists("/dev/full"):
            continue
        outcomes.append(bench.then_as_ever(_in_shell(bench, name, shell, codes)))
    return outcomes


def limits(bench):
    """Too few descriptors, processes or bytes: fewer videos at a time, or one clear line."""
    outcomes = []
    for name, shell in (
        ("64 descriptors", "ulimit -n 64; {} --jobs 8"),
        ("14 descriptors", "ulimit -n 14; {} --jobs 8"),
        ("0.8 GB of addresses", "ulimit -v 800000; {}"),
        ("small stacks", "ulimit -s 256; {}"),
    ):
        outcome = _in_shell(bench, name, shell, {0, 1})
        if name.endswith("descriptors") and not outcome.problem and outcome.ending != RECOVERED:
            outcome = replace(outcome, problem="fewer workers would have done it all")
        outcomes.append(bench.then_as_ever(outcome))
    return outcomes


def _in_shell(bench, name, shell, codes):
    """The outcome of a batch in a shell, `{}` being its command line."""
    mark = uuid.uuid4().hex
    words = [sys.executable, "-m", "dlgmd_cli", *bench.command()]
    script = shell.format(" ".join(map(shlex.quote, words)))
    command, bar, rest = script.partition(" | ")
    try:
        done = subprocess.run(
            ["sh", "-c", f"{{ {command}; echo $? >code; }}{bar}{rest}"],
            cwd=bench.folder,
            capture_output=True,
            timeout=PATIENCE_S,
            env=environment(mark),
        )
    except subprocess.TimeoutExpired:
        return Outcome(name, HUNG, f"for more than {PATIENCE_S:g} s")
    code, said = int((bench.folder / "code").read_text()), done.stderr.decode()
    # What was printed may be lost, but not what was computed.
    ended = Ended(code, "", said)
    return without_survivors(
        lambda: judge_batch(name, ended, bench.out, bench.truth, codes, is_heard=False), mark
    )


def many(bench):
    """Thousands of empty files: a row each, and soon."""
    with _videos(bench, {f"{number}.mp4": b"" for number in range(N_MANY)}) as names:
        began = time.monotonic()
        outcome = bench.run(f"{N_MANY} empty files", {1})
        taken_s = time.monotonic() - began
        if not outcome.problem and sorted(rows_of(bench.out)) != sorted(names):
            outcome = replace(outcome, problem="not every video has a row")
        if not outcome.problem and taken_s > _EACH_S * N_MANY:
            outcome = replace(outcome, ending=HUNG, problem=f"took {taken_s:.1f} s")
    bench.clear()
    return [outcome]


def names(bench):
    """Names that a file may have, and that nobody expects."""
    video = (bench.videos / bench.names[0]).read_bytes()
    odd = [
        b"-o.avi",
        b"--help.avi",
        b"summary.csv.avi",
        b"summary.avi",
        b"new\nline.avi",
        b"\x1b[31mred.avi",
        b"\xff\xfe.avi",
        b"\xed\xa0\x80.avi",
        "\u00e9.avi".encode(),
        "e\u0301.avi".encode(),
        "\u202egnp.avi".encode(),
        b" .avi",
        b"...avi",
        b"..\\up.avi",
        b'a,"b".avi',
        b"=cmd|'x'!A1.avi",
        b"$x_1$ %s {0} [red].avi",
        b"C:.avi",
        b"con.avi",
        b"run.yaml.avi",
        b"earlier.avi",
        b"n" * 251 + b".avi",
        "\u00fc".encode() * 125 + b".avi",
        b"d" * 200 + b".avi/" + b"d" * 200 + b".avi",
        b"clip.avi",
        b"CLIP.avi",
        b"clip.AVI",
        b"clip/clip.avi",
    ]
    with _videos(bench, dict.fromkeys(odd, video)) as made:
        outcome = bench.run("odd names", {0, 1})
        rows = rows_of(bench.out)
        failed = {name[:20]: row["error"] for name, row in rows.items() if row["status"] != "done"}
        if not outcome.problem and (len(rows) != len(made) or failed):
            outcome = replace(outcome, problem=f"{len(rows)} of {len(made)} rows; {failed}")
        if not outcome.problem:
            before = bench.done_at()
            outcome = bench.run("odd names", {0})
            if bench.done_at() != before:
                outcome = replace(outcome, problem="did again what was done")
    bench.clear()
    return [outcome]


def places(bench):
    """Results beside, within and instead of the videos, and behind links."""
    outcomes = []
    linked, within = bench.folder / "linked", bench.videos / "out"
    bench.out.mkdir()
    linked.symlink_to(bench.out)
    for name, out in (("a link to a folder", linked), ("among the videos", within)):
        with bench.with_results_in(out):
            outcome = bench.then_as_ever(bench.run(name, {0}))
            outcomes.append(outcome)
    linked.unlink()
    bench.clear()
    return outcomes


@contextmanager
def _videos(bench, contents):
    """Other videos instead of those of a bench, as far as the file system takes their names."""
    kept = bench.folder / "kept"
    bench.videos.rename(kept)
    truth, bench.truth = bench.truth, None
    made = []
    for name, content in contents.items():
        path = os.path.join(os.fsencode(bench.videos), os.fsencode(name))
        try:
            os.makedirs(os.path.dirname(path), exist_ok=True)
            Path(os.fsdecode(path)).write_bytes(content)
        except OSError:
            continue
        if not os.path.basename(path).startswith(b"."):
            made.append(os.fsdecode(name))
    yield made
    shutil.rmtree(bench.videos)
    kept.rename(bench.videos)
    bench.truth = truth
