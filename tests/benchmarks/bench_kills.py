"""Commands that replace a result and are killed: what state each folder is in then.

Not part of the test run. From the repository:

    python tests/benchmarks/bench_kills.py [COUNT] [--seed N]

COUNT times, `run`, `batch`, `compare` or `live --record` replaces the result of one value of a
parameter by that of another, and is ended by TERM, KILL, INT or HUP at a random moment. A row of
the table is a command, a signal, and the states that its folders were left in.
"""

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from kills import COMMANDS, study


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", nargs="?", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=2026)
    given = parser.parse_args()
    counts: Counter[tuple[str, str, str]] = Counter()
    n_faulty = 0
    with tempfile.TemporaryDirectory() as folder:
        for command in COMMANDS:
            n_cases = given.count // len(COMMANDS)
            for case in study(Path(folder) / command, command, n_cases, given.seed):
                counts[command, case.signal, " ".join(case.states)] += 1
                n_faulty += bool(case.faults)
                if case.faults:
                    print(*case[:-1], *case.faults, sep="\n    ", flush=True)
    print(f"{'command':9}{'signal':9}{'folders':20}{'cases':>5}")
    for (command, name, states), count in sorted(counts.items()):
        print(f"{command:9}{name:9}{states:20}{count:5}")
    print(f"{n_faulty} of {counts.total()} are at fault")


if __name__ == "__main__":
    main()
