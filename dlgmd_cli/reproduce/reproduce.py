"""The whole reproduction: compute what the exhibits need, judge the claims, write the report."""

import os
import shlex
from collections.abc import Sequence
from pathlib import Path

from dlgmd_cli.machine.threads import n_processors
from dlgmd_cli.reproduce.claims import EMPTY, NO, UNDECIDED, YES, counts, load_claims, select
from dlgmd_cli.reproduce.clips import check_reference
from dlgmd_cli.reproduce.exhibits import EXHIBITS, plans_of
from dlgmd_cli.reproduce.finished import FOLDER, Finished
from dlgmd_cli.reproduce.plan import Plan, Started, compute, needed
from dlgmd_cli.reproduce.report import REPORT, TABLE, Report, Section, require_jinja
from dlgmd_cli.results.outcome import Written
from dlgmd_cli.results.store import claimed
from dlgmd_cli.tasks.call import Progress, no_progress

# Least load average at which times are not judged.
_IDLE = 0.5
_HEADER = ("version", "claims hold", "hold without inhibition, too", "do not hold", "undecided")


def reproduce(
    out: Path,
    *,
    only: Sequence[str] = (),
    quick: bool = False,
    reference: Path | None = None,
    dpi: int = 200,
    overwrite: bool = False,
    jobs: int | None = None,
    progress: Progress = no_progress,
) -> Written:
    """Regenerate the evidence of the paper, and judge its claims, as `dlgmd reproduce` does.

    `out` is the folder for the report; what an interrupted one has finished is kept there, and not
    computed again. `only` names figures, tables or claims, with commas between several. `quick` is
    six seeds instead of 20, and nothing at 1920x1080. `reference` is a folder of the authors'
    frames.

    Raises ParameterError if one of these is not there, MissingExtraError without Jinja2, and
    OutputError or OutputExistsError if the report cannot be written.
    """
    specs, remarks = load_claims()
    specs = select(specs, [name for text in only for name in text.split(",")])
    check_reference(reference)
    require_jinja()
    plan = Plan(quick, is_idle=_is_idle())
    plans = {name: plans_of(name, plan, reference) for name in specs}
    started = {
        name: [Started.of(EXHIBITS[name](one)) for one in each] for name, each in plans.items()
    }
    tasks = needed(one for each in started.values() for one in each)
    with claimed(out, names=(REPORT, TABLE), overwrite=overwrite):
        finished = Finished(out / FOLDER)
        with progress("reproduce", len(tasks), "clip") as on_result:
            data = compute(tasks, jobs or n_processors(), on_result, finished)
        sections = []
        for name, spec in specs.items():
            first, *others = [
                (one, exhibit.evidence(data))
                for one, exhibit in zip(plans[name], started[name], strict=True)
            ]
            sections.append(Section(spec, first[1], first[0], others))
        report = Report(sections, remarks, plan, _command(only, quick, reference))
        with progress("figures", len(specs), "figure") as on_figure:
            paths = report.write(out, dpi, on_figure)
        finished.remove()
    rows = [
        (name, *(str(count[kind]) for kind in (YES, EMPTY, NO, UNDECIDED)))
        for name, count in counts(report.found).items()
    ]
    return Written(tuple(paths[:2]), ((_HEADER, rows),))


def _is_idle() -> bool:
    """Whether the machine has had next to nothing to do in the last minute, as far as known."""
    return hasattr(os, "getloadavg") and os.getloadavg()[0] < _IDLE


def _command(only: Sequence[str], quick: bool, reference: Path | None) -> str:
    """The command that repeats a report."""
    words = ["dlgmd", "reproduce"]
    words += ["--only", ",".join(only)] if only else []
    words += ["--quick"] if quick else []
    words += ["--reference", str(reference)] if reference else []
    return shlex.join(words)
