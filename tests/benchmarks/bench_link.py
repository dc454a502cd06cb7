"""How long an alarm takes to the command that brakes, with and without an attacker's datagrams.

    PYTHONPATH=tests python tests/benchmarks/bench_link.py [RUNS]

prints milliseconds from handing over the answer to the first command of an alarm, of four alarms a
run: the median and the longest. An autopilot answers from another process; the datagrams come from
a second address, 2,000 a second.
"""

import sys

import numpy as np
from linked import alarms


def delays_ms(seeds):
    """The delays of the alarms in runs with these seeds; None is for no datagrams."""
    found = []
    for seed in seeds:
        began_s, arrived = alarms(seed)
        for begin_s in began_s:
            after = [time_s - begin_s for time_s, *_ in arrived if time_s >= begin_s]
            found += [1e3 * min(after)] if after else []
    return found


def main(n_runs=3):
    for name, seeds in (("without", [None] * n_runs), ("with", range(1, n_runs + 1))):
        delays = delays_ms(seeds)
        print(
            f"{name} datagrams: {len(delays)} alarms, median {np.median(delays):.2f} ms,", end=" "
        )
        print(f"longest {max(delays):.2f} ms")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
