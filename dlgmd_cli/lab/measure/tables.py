"""The tables that `dlgmd lab measure` measures: a function each, which returns it in Markdown."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import dlgmd_cli
from dlgmd_cli.lab.measure import approaches
from dlgmd_cli.lab.measure.scores import number, of_all, reference, table
from dlgmd_cli.lab.measure.unmeasured import unmeasured
from dlgmd_cli.results.labels import read_cases


def without_contact() -> list[str]:
    """The paths of the real clips without contact at 20 frames/s and more."""
    cases = [case for name in ("footage", "clips") for case in read_cases(reference(name))]
    found = []
    for case in cases:
        with dlgmd_cli.open_video(case.path) as video:
            if not case.collisions and video.info.fps >= 19.9:
                found.append(case.path)
    return found


THRESHOLDS = (0.30, 0.35, 0.40, 0.47, 0.54)


def real() -> str:
    """Alarms of flight on real clips without contact, by threshold."""
    flight = dlgmd_cli.load_config("flight")
    models = tuple(
        replace(flight, values={**flight.values, "expansion_alarm": at}) for at in THRESHOLDS
    )
    n_alarms, duration_s = [0] * len(THRESHOLDS), 0.0
    for path in without_contact():
        results = dlgmd_cli.run(path, models)
        duration_s += float(results[0].time_s[-1])
        for place, result in enumerate(results):
            n_alarms[place] += len(result.alarm_list)
    rows = [[f"{at:.2f}", str(n)] for at, n in zip(THRESHOLDS, n_alarms, strict=True)]
    return table(["`expansion_alarm`, 1/s", f"false alarms, in {duration_s:.0f} s"], rows)


def footage() -> str:
    """Flight and sets of the neuron on real clips, most of them crashes at 10 frames/s."""
    scores = of_all(reference("footage"), "flight", 8, 9)
    head = ["model", f"announced, of {scores[0]['contacts']}", "median lead time, s"]
    head += ["false alarms", "false alarms/min", "time in alarm, %"]
    rows = []
    for row in scores:
        cells = [f"`{row['model']}`", row["announced"], number(row["lead_s"]), row["false_alarms"]]
        cells.append(number(row["false_alarms_per_min"], 1))
        rows.append([*cells, f"{100 * float(row['in_alarm']):.1f}"])
    return table(head, rows)


def paper() -> str:
    """The claims of the paper: how many hold, and each by verdict.

    The folder dlgmd-paper in the working folder keeps what is computed: an interrupted run goes on.
    """
    folder = Path("dlgmd-paper")
    options = ["--reference", reference("clips").parents[1], "--out", folder, "--overwrite"]
    command = [sys.executable, "-m", "dlgmd_cli", "lab", "paper", *options]
    subprocess.run([*map(str, command)], check=True)
    return (folder / "claims.md").read_text(encoding="utf-8").strip()


class Measured(NamedTuple):
    """A table that can be measured: the function, and about how many minutes of one core."""

    make: Callable[[], str]
    minutes: int


TABLES = {
    "real": Measured(real, 2),
    "footage": Measured(footage, 2),
    "approach": Measured(approaches.announced, 6),
    "approach-rate": Measured(approaches.rates, 3),
    "unmeasured": Measured(unmeasured, 10),
    "paper": Measured(paper, 180),
}
