"""How a run ended, and whether it may end so."""

from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.results.read import read_result
from dlgmd_cli.results.record import parse_record

ERROR, RECOVERED, INTERRUPTED = "error", "recovered", "interrupted"
CRASHED, HUNG, HALF_WRITTEN = "crashed", "hung", "half-written"
ENDINGS = (ERROR, RECOVERED, INTERRUPTED, CRASHED, HUNG, HALF_WRITTEN)
ENDING = {0: RECOVERED, 1: ERROR, 130: INTERRUPTED}


@dataclass(frozen=True)
class Outcome:
    """One of ENDINGS for a named case, and what is wrong about it, if anything."""

    name: str
    ending: str
    problem: str = ""

    def to_dict(self):
        return asdict(self)


def judge(name, code, stderr, out, expected="either", allows_partial=False):
    """The outcome of a run by its exit code, what it said, and what it left in `out`.

    `expected` is "error", "recovers" or "either"; `allows_partial` is for a process that was
    killed, whose hidden folder stays for the next one to remove.
    """
    if "Traceback" in stderr or "internal error" in stderr or code not in ENDING:
        return Outcome(name, CRASHED, f"exit code {code}: {stderr[-2000:]}")
    found = sorted(path.name for path in out.iterdir()) if out.exists() else []
    hidden = [entry for entry in found if entry.startswith(".")]
    results = [entry for entry in found if not entry.startswith(".")]
    if hidden and not allows_partial:
        return Outcome(name, HALF_WRITTEN, f"left {hidden}")
    for result in results:
        problem = fault_of_result(out / result, must_be_complete=code == 0)
        if problem:
            return Outcome(name, HALF_WRITTEN, f"{result}: {problem}")
    ending = ENDING[code]
    errors = [line for line in stderr.splitlines() if line.startswith("Error: ")]
    problem = ""
    if code == 1 and (len(errors) != 1 or stderr.splitlines()[-1] != errors[0]):
        problem = f"not one line: {stderr}"
    elif code == 1 and out.exists():
        problem = f"left {out.name} with {found}"
    elif code == 0 and (len(results) != 1 or errors):
        problem = f"ended well with {results}: {stderr}"
    elif code != {"error": 1, "recovers": 0}.get(expected, code):
        problem = f"expected: {expected}, got exit code {code}: {stderr}"
    return Outcome(name, ending, problem)


def fault_of_result(folder: Path, *, must_be_complete: bool):
    """What is wrong with a folder of results, or None."""
    try:
        n_rows = len(read_result(folder).frame)
        record = parse_record((folder / "run.yaml").read_bytes())
    except (DlgmdError, OSError) as error:
        return f"unreadable ({error})"
    if not record:
        return "no record"
    if record["processed"]["frames"] != n_rows:
        return f"{n_rows} rows, and on record are {record['processed']['frames']}"
    if must_be_complete and record["complete"] is not True:
        return "not complete, and exit code 0"
    return None


def table(groups):
    """Lines that count the endings of every group of outcomes."""
    lines = [f"{'':24}{'tried':>7}" + "".join(f"{ending:>14}" for ending in ENDINGS)]
    for group, outcomes in groups.items():
        counts = Counter(outcome.ending for outcome in outcomes)
        cells = "".join(f"{counts[ending]:>14}" for ending in ENDINGS)
        lines.append(f"{group:24}{len(outcomes):>7}{cells}")
    return lines
