"""Rules of the alarm side by side: spikes of a neuron, the rule of flight, either, and both.

    python tests/benchmarks/bench_rules.py LABELS.csv [--stabilised]

prints a table in Markdown. "Both" needs an alarm of `flight`, and a spike in the last 0.3 s;
"flight vetoed" leaves an alarm of `flight` out if the normalised potential has stayed below half
of T_MP in the last 0.3 s. A collision counts as detected within 1 s.
"""

import sys
from pathlib import Path

import numpy as np

from dlgmd_cli import run
from dlgmd_cli.results.labels import read_cases
from dlgmd_cli.results.scoring import score, tally
from dlgmd_cli.scenes.flights.braking import Brakes
from dlgmd_cli.tasks.evaluate.candidates import signal_of
from dlgmd_cli.tasks.evaluate.stopping import score_stops, stops_in

MODELS, RECENT_S = [3, 6, 8, 9], 0.3


def lately(flags, time_s):
    """Whether a flag was set in the last `RECENT_S`."""
    last_s = np.maximum.accumulate(np.where(flags, time_s, -np.inf))
    return time_s - last_s <= RECENT_S


def rules(results, expanding):
    """Name of a rule -> whether its alarm is on, for each frame."""
    expands = expanding.alarms
    found = {"flight": expands}
    for number, one in zip(MODELS, results, strict=True):
        near = lately(one.mp_abs >= 0.5 * one.params.t_mp, one.time_s)
        found |= {
            f"spikes of set {number}": one.alarms,
            f"either, set {number}": one.alarms | expands,
            f"both, set {number}": expands & lately(one.spikes, one.time_s),
            f"flight vetoed by set {number}": expands & near,
        }
    return found


def main(labels, *options):
    """Print the table of all rules over the labelled videos."""
    brakes = Brakes(agile=False if "--stabilised" in options else None)
    tallies, stopped = {}, {}
    for case in read_cases(Path(labels)):
        *results, expanding = run(case.path, [*MODELS, "flight"])
        task = case, expanding.record, expanding.time_s
        stops = stops_in(brakes, task) if Path(case.path).with_suffix(".yaml").exists() else None
        for name, is_on in rules(results, expanding).items():
            signal = signal_of(expanding, case, np.float64(is_on))
            signal = signal if stops is None else stops.on(signal)
            counts = tally(signal, 1, 0.5)
            tallies.setdefault(name, []).append(counts)
            if stops is not None:
                stopped.setdefault(name, []).append((stops, counts))
    n_collisions = int(score(next(iter(tallies.values())))["collisions"])
    print(f"| rule | detected, of {n_collisions} | median lead time, s | false per min | saved |")
    print("|---|---|---|---|---|")
    for name, own in tallies.items():
        row = score(own)
        saved = f"{score_stops(stopped[name])['saved']:.2f}" if name in stopped else "–"
        lead = f"{row['lead_s']:.2f}" if row["hits"] else "–"
        rate = f"{row['false_alarms_per_min']:.1f}"
        print(f"| {name} | {row['hits']:.0f} | {lead} | {rate} | {saved} |")


if __name__ == "__main__":
    main(*sys.argv[1:])
