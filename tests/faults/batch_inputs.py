"""All inputs in one batch: each has its row, and what is done is what `dlgmd run` makes of it."""

import os
import shutil
import subprocess
import sys
import uuid
from dataclasses import replace

from dlgmd_cli.batch.find import is_video
from dlgmd_cli.results.cells import text_cell
from dlgmd_cli.threads import limit_threads, n_processors
from faults.batch_bench import environment, invoke, without_survivors
from faults.batch_outcome import Ended, files_below, folders_of, judge_batch, rows_of, timeless
from faults.outcome import CRASHED, ERROR, HUNG, RECOVERED, Outcome

# More than any of them takes, and more than all of them.
EACH_S, ALL_S = "120", 900
N_JOBS, N_TRIES = 2, 6
# Larger files take long, and are held against nothing unless all are.
_LARGE_BYTES = 1_000_000
_EXPECTED = {"error": "failed", "recovers": "done"}
_ENDING = {"done": RECOVERED, "failed": ERROR, "timeout": HUNG}


def batch_of_inputs(inputs, folder, decoder, n_apart):
    """Inputs and their outcomes, the last one that of the batch as a whole.

    What is no file is left out; what has not a video's ending is given as a root of its own. Every
    `n_apart`th is held against a run of its own.
    """
    top, names = inputs[0].path.parents[1], {}
    for case in inputs:
        if os.path.lexists(case.path) and not case.path.is_dir():
            is_below = top in case.path.parents and is_video(case.path.name)
            path = case.path.relative_to(top.parent).as_posix() if is_below else case.path.name
            names[case] = text_cell(path)
    roots = [top, *(case.path for case, name in names.items() if "/" not in name)]
    out, mark = folder / "out", uuid.uuid4().hex
    options = ["--decoder", decoder, "--no-plots"]
    how = ["--jobs", str(N_JOBS), "--timeout", EACH_S]
    try:
        done = subprocess.run(
            [sys.executable, "-m", "dlgmd_cli", "batch", *roots, "--out", out, *options, *how],
            capture_output=True,
            timeout=ALL_S,
            env=environment(mark),
        )
    except subprocess.TimeoutExpired:
        return {None: Outcome("the batch", HUNG, f"for more than {ALL_S} s")}
    ended = Ended(done.returncode, done.stdout.decode(), done.stderr.decode())
    whole = without_survivors(lambda: judge_batch("the batch", ended, out, None, {1}), mark)
    rows = rows_of(out)
    folders, outcomes = folders_of(out), {}
    for number, (case, name) in enumerate(names.items()):
        outcomes[case] = _outcome(case, rows.get(name))
        is_apart = n_apart == 1 or (
            number % n_apart == 0 and case.path.lstat().st_size < _LARGE_BYTES
        )
        if is_apart and not outcomes[case].problem:
            mine = folders.get(str(case.path))
            fault = _difference_from_run(case, rows[name], mine, folder / "alone", options)
            outcomes[case] = replace(outcomes[case], problem=fault)
    return {**outcomes, None: whole}


def _outcome(case, row):
    """How a video ended by its row, and whether it may."""
    if row is None:
        return Outcome(case.name, CRASHED, "it has no row")
    ending = _ENDING.get(row["status"], CRASHED)
    if ending in (CRASHED, HUNG):
        return Outcome(case.name, ending, f"{case.path}: {row['status']}: {row['error']}")
    if row["status"] != _EXPECTED.get(case.expected, row["status"]):
        return Outcome(case.name, ending, f"expected: {case.expected}; {row['error']}")
    return Outcome(case.name, ending)


def _difference_from_run(case, row, mine, alone, options):
    """In what a row and its result differ from those of every run of its own; "" if in nothing.

    What FFmpeg makes of damage depends on how many threads it has and how they take turns, so that
    runs over the same file may differ, too; then there is nothing to be held against.
    """
    batch = (row["error"], timeless(files_below(mine)) if mine else {})
    runs = []
    for _ in range(N_TRIES):
        shutil.rmtree(alone, ignore_errors=True)
        limit_threads(max(1, n_processors() // N_JOBS))
        ended = invoke(["run", str(case.path), "--out", str(alone), *options])
        limit_threads(None)
        folders = list(alone.iterdir()) if alone.exists() else []
        files = timeless(files_below(folders[0])) if folders else {}
        why = ended.stderr.rstrip("\n").partition(f"Error: {case.path}: ")[2]
        runs.append((text_cell(why), files))
        if runs[-1] == batch:
            return ""
    are_alike = all(run == runs[0] for run in runs)
    return f"a run alone gives {runs[0][0] or 'other files'}" if are_alike else ""
