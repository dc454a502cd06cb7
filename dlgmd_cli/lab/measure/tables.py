"""The tables that `dlgmd lab measure` measures: a function each, which returns it in Markdown."""

import math
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import dlgmd_cli
from dlgmd_cli.lab.measure import approaches
from dlgmd_cli.lab.measure.scores import Row, evaluated, number, of_all, reference, rows_of, table
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


THRESHOLDS = (0.30, 0.36, 0.42, 0.48, 0.54, 0.60)


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
    scores = of_all(reference("footage"), "flight", 3, 6, 8, 9)
    head = ["model", f"announced, of {scores[0]['contacts']}", "median lead time, s"]
    head += ["false alarms", "false alarms/min", "time in alarm, %"]
    rows = []
    for row in scores:
        cells = [f"`{row['model']}`", row["announced"], number(row["lead_s"]), row["false_alarms"]]
        cells.append(number(row["false_alarms_per_min"], 1))
        rows.append([*cells, f"{100 * float(row['in_alarm']):.1f}"])
    return table(head, rows)


def _errors(labels: Path) -> str:
    """The errors of the time to contact, by the true time."""
    head = ["true time, s", "with an estimate", "median error, s", "median ratio", "90 % ratio"]
    rows = []
    for row in evaluated(labels, "flight")["ttc"]:
        span = f"{float(row['left_from_s']):.1f}–{float(row['left_to_s']):.1f}"
        error = f"{float(row['error_s']):+.2f}" if row["error_s"] else "–"
        logs = (row["log_error"], row["log_error_p90"])
        ratios = [f"{math.exp(float(log)):.2f}" if log else "–" for log in logs]
        rows.append([span, number(row["estimated"]), error, *ratios])
    return table(head, rows)


def ttc_synthetic() -> str:
    """Errors of the time to contact of a cube and a ball."""
    with tempfile.TemporaryDirectory() as folder:
        for scene in ("looming-cube", "looming-ball"):
            dlgmd_cli.synth(scene, folder)
        labels = Path(folder, "labels.csv")
        text = "video,collision_frame\nlooming-cube.mp4,74\nlooming-ball.mp4,74\n"
        labels.write_text(text, encoding="utf-8")
        return _errors(labels)


def ttc_real() -> str:
    """Errors of the time to contact in real crashes at 10 frames/s."""
    return _errors(reference("footage"))


@cache
def _verdicts() -> list[Row]:
    """The rows of `claims.csv` on what the paper says of its model, one for each verdict.

    Figs. 8, 10 and 12 are judged on the authors' frames alone, and no time of Table IV is.
    """
    with tempfile.TemporaryDirectory() as folder:
        options = ["--quick", "--reference", reference("clips").parents[1]]
        command = [sys.executable, "-m", "dlgmd_cli", "lab", "paper", *options, "--out", folder]
        subprocess.run([*map(str, command)], check=True)
        rows = [row for row in rows_of(Path(folder, "claims.csv")) if row["whose"] == "paper"]
    rows = [row for row in rows if not row["id"].startswith(_TIMES)]
    found = {(row["id"], row["formulation"]): row for row in reversed(rows)}
    found |= {
        (row["id"], row["formulation"]): row for row in rows if row["shown_on"] == "authors' frames"
    }
    return [*found.values()]


# The claims on times, and what the other claims are about where that is not a figure.
_TIMES = "table4-time"
_PARTS = {
    "lateral": "III-C, large objects",
    "table4": "Table IV, DA",
    "ablation": "I, contributions",
}
VERDICTS = {"yes": "✓", "no": "✗", "undecided": "?", "empty": "○", "tie": "=", "untestable": "–"}


def paper_totals() -> str:
    """How many claims of the paper hold in each version."""
    versions = dict.fromkeys(row["formulation"] for row in _verdicts())
    rows = []
    for version in (name for name in reversed(versions) if name != "any"):
        own = [row["verdict"] for row in _verdicts() if row["formulation"] in (version, "any")]
        rows.append([f"`{version}`", *(str(own.count(verdict)) for verdict in VERDICTS)])
    return table(["version", *VERDICTS.values()], rows)


def paper_figures() -> str:
    """How many claims hold, of those that can be tested, by figure."""
    shown = ("default", "released-2021", "released-2020", "equations")
    of_figure: dict[str, list[Row]] = {}
    for row in _verdicts():
        if row["verdict"] != "untestable":
            of_figure.setdefault(re.split("[a-d]?-", row["id"])[0], []).append(row)
    rows = []
    for figure, found in reversed(of_figure.items()):
        cells = [_PARTS.get(figure, figure.replace("fig", "Fig. "))]
        for version in shown:
            own = [row["verdict"] for row in found if row["formulation"] in (version, "any")]
            cells.append(f"{own.count('yes')}/{len(own)}")
        rows.append(cells)
    return table(["", *(f"`{version}`" for version in shown)], rows)


class Measured(NamedTuple):
    """A table that can be measured: the function, and about how many minutes of one core."""

    make: Callable[[], str]
    minutes: int


TABLES = {
    "real": Measured(real, 2),
    "footage": Measured(footage, 2),
    "approach": Measured(approaches.announced, 6),
    "approach-rate": Measured(approaches.rates, 3),
    "approach-quality": Measured(approaches.qualities, 2),
    "unmeasured": Measured(unmeasured, 10),
    "ttc-synthetic": Measured(ttc_synthetic, 1),
    "ttc-real": Measured(ttc_real, 1),
    "paper-totals": Measured(paper_totals, 9),
    "paper-figures": Measured(paper_figures, 9),
}
