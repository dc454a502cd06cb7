"""What happens to the disk under a batch: no room, no access, and others who remove and change."""

import os
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from unittest import mock

from faults.batch_bench import at_event, invoke
from faults.batch_outcome import SUMMARY, judge_batch, rows_of
from faults.processes import mount, unmount


def nowhere_to_write(bench):
    """Folders that nobody can write to, not even root."""
    video = bench.videos / bench.names[0]
    places = [video / "out", video, Path("/dev/null/out")]
    places += [Path(path) / "out" for path in ("/proc", "/sys") if os.path.isdir(path)]
    outcomes = []
    for place in places:
        with bench.with_results_in(place):
            ended = invoke(bench.command())
        # What is no folder of ours counts as none.
        none = bench.folder / "none"
        outcomes.append(judge_batch(f"out {place}", ended, none, bench.truth, {1}))
    read_only = bench.folder / "read-only"
    read_only.mkdir(exist_ok=True)
    if mount("-t", "tmpfs", "-o", "ro,size=64k", "none", read_only):
        try:
            with bench.with_results_in(read_only / "out"):
                outcomes.append(bench.run("read-only mount", {1}))
        finally:
            unmount(read_only)
    outcomes[-1] = bench.then_as_ever(outcomes[-1])
    return outcomes


def no_room_on_disk(bench, shares=(0.0, 0.03, 0.3, 0.9)):
    """A file system of its own that is too small for all; then there is room, and it goes on."""
    outcomes, mounted = [], bench.folder / "small"
    mounted.mkdir(exist_ok=True)
    needed_kib = sum(4 * (len(data) // 4096 + 1) for data in bench.truth.values())
    for share in shares:
        size = int(share * needed_kib)
        options = f"size={max(size, 4)}k,nr_inodes={3 if size == 0 else 400}"
        if not mount("-t", "tmpfs", "-o", options, "none", mounted):
            return outcomes
        try:
            with bench.with_results_in(mounted / "out"):
                outcome = bench.run(f"disk of {size} KiB", {1})
                outcome = _because(bench, outcome, "No space left on device")
                mount("-o", "remount,size=50m,nr_inodes=4000", mounted)
                outcomes.append(bench.then_as_ever(outcome))
        finally:
            unmount(mounted)
    return outcomes


def no_files_so_large(bench, shares=(0.0, 0.001, 0.3, 0.99)):
    """Files may not grow beyond a size: what a quota does; workers inherit it."""
    try:
        import resource
    except ImportError:
        return []
    before, outcomes = resource.getrlimit(resource.RLIMIT_FSIZE), []
    largest = max(map(len, bench.truth.values()))
    for size in [int(share * largest) for share in shares]:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            outcome = bench.run(f"files of {size} bytes", {1})
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        outcomes.append(bench.then_as_ever(_because(bench, outcome, "File too large")))
    return outcomes


def results_removed(bench, numbers=(0, 4, 9)):
    """The folder of all results goes, once or again and again; or summary.csv alone."""
    outcomes = []
    for number in numbers:
        with at_event(lambda worker: bench.clear(), number):
            outcome = bench.run(f"removed at event {number}", allows_loss=True)
        outcomes.append(bench.then_as_ever(outcome))
    with at_event(lambda worker: bench.clear(), None):
        outcome = bench.run("removed at every event", allows_loss=True)
    outcomes.append(bench.then_as_ever(outcome))
    with at_event(lambda worker: (bench.out / SUMMARY).unlink(missing_ok=True), None):
        outcome = bench.run("summary removed at every event", {0})
    outcomes.append(bench.then_as_ever(outcome))
    return outcomes


def results_replaced(bench):
    """Strangers put something where the last result and the summary are to go."""
    last = Path(bench.names[-1]).with_suffix("")
    theirs = {
        "a file": last,
        "a folder of others": last / "thesis.tex",
        "a folder in a folder": last / "run.yaml" / "x",
        "a folder instead of the summary": Path(SUMMARY, "x"),
        "a file instead of a folder": last.parent,
    }
    outcomes = []
    for name, relative in theirs.items():
        path = bench.out / relative
        if path == bench.out:
            continue

        def put(worker, path=path):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("mine\n")

        with at_event(put, 0):
            outcome = bench.run(name, {1}, ignored=[relative.as_posix()])
        if not outcome.problem and path.read_text() != "mine\n":
            outcome = replace(outcome, problem="was overwritten")
        path.unlink()
        if path.parent not in (bench.out, bench.out / last.parent):
            path.parent.rmdir()
        outcomes.append(bench.then_as_ever(outcome))
    return outcomes


def inputs_disturbed(bench):
    """Videos that are removed or changed between being found and being read."""
    last = bench.videos / bench.names[-1]
    kept = bench.folder / "kept"
    ways = {
        "a video removed": lambda: last.unlink(),
        "a video emptied": lambda: last.write_bytes(b""),
        "a video replaced by text": lambda: last.write_text("no video\n" * 100),
        "a video replaced by a folder": lambda: (last.unlink(), last.mkdir()),
        "a folder of videos removed": lambda: shutil.rmtree(last.parent),
        "all videos removed": lambda: shutil.rmtree(bench.videos),
    }
    outcomes = []
    for name, disturb in ways.items():
        shutil.copytree(bench.videos, kept)
        with at_event(lambda worker, disturb=disturb: disturb(), 0):
            outcome = bench.run(name, {1})
        shutil.rmtree(bench.videos, ignore_errors=True)
        kept.rename(bench.videos)
        if not outcome.problem and sorted(rows_of(bench.out)) != bench.names:
            outcome = replace(outcome, problem="not every video has a row")
        outcomes.append(bench.then_as_ever(outcome))
    return outcomes


def nothing_temporary(bench):
    """TMPDIR is missing, or no temporary file can be had at all."""
    outcomes = []
    with mock.patch.dict(os.environ, {"TMPDIR": "/nowhere"}):
        outcomes.append(bench.then_as_ever(bench.run("TMPDIR is missing", {0})))

    def refuse(*arguments, **options):
        raise FileNotFoundError(2, "No usable temporary directory found")

    with mock.patch.object(tempfile, "TemporaryFile", refuse):
        outcomes.append(bench.then_as_ever(bench.run("no temporary files", {0})))
    return outcomes


def _because(bench, outcome, reason):
    """`outcome`, unless videos failed for another reason."""
    others = [row for row in rows_of(bench.out).values() if row["status"] != "done"]
    if not outcome.problem and not all(reason in row["error"] for row in others):
        return replace(outcome, problem=f"not for '{reason}': {others}")
    return outcome
