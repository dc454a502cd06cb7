"""The whole reproduction: compute what exhibits need, judge the claims, write the report."""

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from dlgmd_cli.machine.threads import n_processors
from dlgmd_cli.reproduce import flights, objects, stimuli, table4
from dlgmd_cli.reproduce.claims import VERDICTS, counts, load_claims, select
from dlgmd_cli.reproduce.clips import check_reference
from dlgmd_cli.reproduce.plan import (
    FOLDER,
    FULL_SIZE,
    USUAL_SIZE,
    Exhibit,
    Finished,
    Plan,
    Started,
    compute,
    needed,
)
from dlgmd_cli.reproduce.report import REPORT, TABLE, Report, Section, require_jinja
from dlgmd_cli.results.outcome import Written
from dlgmd_cli.results.store import claimed
from dlgmd_cli.tasks.call import Progress, no_progress

_EACH: tuple[Any, ...] = (
    *(stimuli.fig5, stimuli.fig6, stimuli.fig9, stimuli.fig10, stimuli.fig11, stimuli.fig12),
    *(objects.fig8, flights.fig1, flights.fig13, flights.fig14, flights.fig17, flights.lateral),
    *(table4.table4_da, table4.table4_time, table4.ablation),
)
# All exhibits by id.
EXHIBITS: dict[str, Exhibit] = {each.__name__.replace("_", "-"): each for each in _EACH}
EXHIBITS |= {f"fig{group + 11}": partial(flights.approach, group) for group in (4, 5)}
# Those that are checked at the paper's frame size, and those with frames by the authors.
AT_FULL_SIZE = {"fig1", "fig13", "fig14", "fig15", "fig16", "fig17", "table4-da"}
OF_AUTHORS = {"fig8": "ball_and_capsules", "fig10": "looming_ball", "fig12": "looming_ball"}
# Least load average at which times are not judged.
_IDLE = 0.5
_HEADER = (
    *("version", "claims hold", "hold without inhibition, too", "tie", "do not hold"),
    *("undecided", "not testable here"),
)


def reproduce(
    out: Path,
    *,
    only: Sequence[str] = (),
    quick: bool = False,
    seeds: Sequence[int] = (),
    size: tuple[int, int] | None = None,
    reference: Path | None = None,
    dpi: int = 200,
    overwrite: bool = False,
    jobs: int | None = None,
    progress: Progress = no_progress,
) -> Written:
    """Regenerate the evidence of the paper, and judge its claims, as `dlgmd reproduce` does.

    `out` is the folder for the report; what an interrupted one has finished is kept there, and not
    computed again. `only` names figures, tables or claims, with commas between several. `quick` is
    six seeds instead of 20, and nothing at 1920x1080. `seeds` are others than usual, and `size` is
    another width and height of the flights. `reference` is a folder of the authors' frames.

    Raises ParameterError if one of these is not there, MissingExtraError without Jinja2, and
    OutputError or OutputExistsError if the report cannot be written.
    """
    specs, remarks = load_claims()
    specs = select(specs, [name for text in only for name in text.split(",")])
    check_reference(reference)
    require_jinja()
    flight_size = (size[1], size[0]) if size else USUAL_SIZE
    # Nothing else has run in the last minute, as far as known.
    is_idle = hasattr(os, "getloadavg") and os.getloadavg()[0] < _IDLE
    plan = Plan(quick, None, flight_size, tuple(seeds), is_idle=is_idle)
    plans = {name: plans_of(name, plan, reference) for name in specs}
    started = {name: [Started(EXHIBITS[name](p)) for p in plans[name]] for name in plans}
    tasks = needed(exhibit for each in started.values() for exhibit in each)
    with claimed(out, names=(REPORT, TABLE), overwrite=overwrite):
        finished = Finished(out / FOLDER)
        with progress("reproduce", len(tasks), "clip") as on_result:
            data = compute(tasks, jobs or n_processors(), on_result, finished)
        sections = []
        for name, spec in specs.items():
            each = [exhibit.evidence(data) for exhibit in started[name]]
            sections.append(Section(spec, list(zip(plans[name], each, strict=True))))
        options: dict[str, Any] = {"only": ",".join(only), "quick": quick, "reference": reference}
        options["seeds"] = seeds and f"{seeds[0]}:{seeds[-1]}"
        options["size"] = size and "{}x{}".format(*size)
        report = Report(sections, remarks, plan, _command(**options))
        with progress("figures", len(specs), "figure") as on_figure:
            paths = report.write(out, dpi, on_figure)
        finished.remove()
    held = counts(report.found).items()
    rows = [(name, *(str(count[kind]) for kind in VERDICTS)) for name, count in held]
    return Written(tuple(paths[:2]), ((_HEADER, rows),))


def _command(**options: Any) -> str:
    """The command that repeats a report, from its options; empty ones are left out."""
    given = {name: value for name, value in options.items() if value}
    words = [f"--{name}{'' if value is True else f' {value}'}" for name, value in given.items()]
    return " ".join(["dlgmd reproduce", *words])


def plans_of(name: str, plan: Plan, reference: Path | None) -> list[Plan]:
    """The plan of an exhibit, then those that are shown beside it.

    `reference` is the folder of the authors' frames, if it is given.
    """
    plans = [plan]
    if name in AT_FULL_SIZE and not (plan.quick or plan.is_larger):
        plans.append(replace(plan, flight_size=FULL_SIZE, only_seeds=plan.only_seeds[:6]))
    if reference is not None and name in OF_AUTHORS and (reference / OF_AUTHORS[name]).is_dir():
        plans.append(replace(plan, reference=reference))
    return plans
