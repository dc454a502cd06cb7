"""How a batch ended, and whether it may end so: row by row, and file by file."""

import csv
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from dlgmd_cli.batch.summary import COLUMNS
from dlgmd_cli.results.cells import cell, text_cell
from dlgmd_cli.results.record import parse_record
from faults.outcome import CRASHED, ENDING, HALF_WRITTEN, Outcome, fault_of_result

SUMMARY = "summary.csv"
STATUSES = ("done", "failed", "crashed", "killed", "timeout")
# The process may have been ended between its last rename and its answer.
_MAY_HAVE_A_RESULT = ("killed", "timeout")


@dataclass(frozen=True)
class Ended:
    """The exit code of a batch, and what it said."""

    code: int
    stdout: str
    stderr: str


def judge_batch(name, ended, out, truth, codes, *, allows_hidden=False, is_heard=True, **how):
    """The outcome of a batch by its exit code, what it said, and what it left.

    `truth` are the `timeless` files of an undisturbed one, `codes` the exit codes that it may
    have. `allows_hidden` is for one that was killed with all its processes. Not `is_heard` is one
    whose messages went nowhere. For the rest see `fault_of_files`.
    """
    said = f"exit code {ended.code}: {ended.stderr[-1500:]}"
    if (
        re.search("Traceback|internal error|Exception ignored", ended.stderr)
        or ended.code not in ENDING
        or any(row["status"] == "crashed" for row in rows_of(out).values())
    ):
        return Outcome(name, CRASHED, said)
    problem = fault_of_files(out, truth, allows_hidden=allows_hidden, **how)
    if problem:
        return Outcome(name, HALF_WRITTEN, f"{problem}; {said}")
    if ended.code not in codes:
        problem = "an exit code that may not be"
    elif is_heard:
        problem = fault_of_words(ended, out)
    return Outcome(name, ENDING[ended.code], problem or "")


def fault_of_words(ended, out):
    """What is wrong with what was said of a batch, or None."""
    lines = ended.stderr.splitlines()
    errors = [line for line in lines if line.startswith("Error: ")]
    if len(errors) != (ended.code == 1) or (errors and lines[-1] != errors[0]):
        return f"not one line, and the last: {ended.stderr}"
    if ended.code == 0 and any(row["status"] != "done" for row in rows_of(out).values()):
        return "ended well, and not all is done"
    times = Counter(lines)
    for name, row in rows_of(out).items():
        if row["status"] != "done":
            what = f"Warning: {name.removeprefix('./')}: {row['status']}"
            n_warnings = times[f"{what}: {row['error'].rstrip('.')}."]
            if n_warnings != 1:
                return f"{n_warnings} times {what!r} for {row}: {ended.stderr[-1500:]}"
    return None


def fault_of_files(out, truth, *, allows_hidden=False, ignored=(), allows_loss=False):
    """What is wrong with the files that a batch left, or None.

    `ignored` are files that others put there; with `allows_loss` they took results away, too.
    """
    files = {name: data for name, data in timeless(files_below(out)).items() if name not in ignored}
    hidden = sorted(str(path) for path in out.rglob(".dlgmd-*")) if out.exists() else []
    if hidden and not allows_hidden:
        return f"left {hidden}"
    files = {name: data for name, data in files.items() if "/.dlgmd-" not in f"/{name}"}
    rows, records = rows_of(out), {}
    mine = by_folder(files)
    theirs = mine if truth is None else by_folder(truth)
    for folder in sorted(mine):
        fault = fault_of_result(out / folder, must_be_complete=True)
        if fault:
            return f"{folder}: {fault}"
        if mine[folder] != theirs.get(folder):
            return f"{folder}: its files are not those of an undisturbed run"
        record = _record_in(out / folder)
        records[text_cell(record["input"]["path"])] = record
    if "?" in rows:
        return f"{SUMMARY} is not whole: {rows['?']}"
    return fault_of_rows(rows, records, allows_loss=allows_loss)


def by_folder(files):
    """Files by their folder, then by their name."""
    found = {}
    for path, data in files.items():
        folder, _, name = path.rpartition("/")
        found.setdefault(folder, {})[name] = data
    return found


def fault_of_rows(rows, records, *, allows_loss=False):
    """Where summary.csv and the records disagree, or None."""
    for name, row in rows.items():
        end = f"/{name.removeprefix('./')}"
        ends = [path for path in records if path.endswith(end)]
        if row["status"] not in STATUSES or bool(row["error"]) != (row["status"] != "done"):
            return f"{name}: {row}"
        if row["status"] != "done":
            if ends and row["status"] not in _MAY_HAVE_A_RESULT:
                return f"{name} is {row['status']}, and has a result"
            continue
        if not ends:
            if allows_loss:
                continue
            return f"{name} is done, and has no result"
        record = records[min(ends, key=len)]  # the others lie deeper
        facts = {**record["input"], **record["summary"], "wall_s": record["wall_s"]}
        for key in COLUMNS[3:]:
            value = facts[key]
            if row[key] != ("" if value is None else _as_text(key, value)):
                return f"{name}: {key} is {row[key]}, on record is {value}"
    return None


def _as_text(key, value):
    return f"{value:.3f}" if key == "wall_s" else cell(value)


def rows_of(out):
    """The rows of summary.csv by video; "?" is what is wrong with it; nothing if it is absent."""
    path = out / SUMMARY
    if not path.is_file():
        return {}
    text = path.read_text(encoding="utf-8")
    header, *rows = list(csv.reader(text.splitlines(keepends=True))) or [()]
    if tuple(header) != COLUMNS or not text.endswith("\n"):
        return {"?": {"status": text[:200]}}
    if any(len(row) != len(COLUMNS) for row in rows):
        return {"?": {"status": "a row of another length"}}
    names = Counter(row[0] for row in rows)
    if max(names.values(), default=1) > 1:
        return {"?": {"status": f"{names.most_common(1)}"}}
    return {row[0]: dict(zip(COLUMNS, row, strict=True)) for row in rows}


def folders_of(out):
    """The folder of every result by the path of its video."""
    folders = [path.parent for path in out.rglob("[!.]*/run.yaml")]
    return {_record_in(folder)["input"]["path"]: folder for folder in folders}


def _record_in(folder):
    return parse_record((folder / "run.yaml").read_bytes())


def files_below(folder):
    """The content of all files below a folder, by their names with slashes."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in Path(folder).rglob("*")
        if path.is_file() and not path.is_symlink()
    }


def timeless(files):
    """Files without what the clock puts into them; without summary.csv, whose rows are judged."""
    return {
        name: re.sub(rb"(?m)^wall_s: .*\n", b"", data) if name.endswith("run.yaml") else data
        for name, data in files.items()
        if name != SUMMARY
    }
