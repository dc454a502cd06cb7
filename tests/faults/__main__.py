"""Run every fault and count the endings; exit code 1 if one of them may not be."""

import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from faults.outcome import table
from faults.suite import of_inputs, of_processes


def main():
    """Print the table, and what is wrong below it."""
    with tempfile.TemporaryDirectory() as folder:
        groups = of_inputs(Path(folder), ["opencv", *(["pyav"] if find_spec("av") else [])])
        for name, try_it in of_processes(Path(folder)).items():
            groups[name] = try_it()
    groups["all"] = [outcome for outcomes in groups.values() for outcome in outcomes]
    problems = [outcome for outcome in groups["all"] if outcome.problem]
    print("\n".join(table(groups)))
    for outcome in problems:
        print(f"{outcome.name}: {outcome.ending}: {outcome.problem}")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
