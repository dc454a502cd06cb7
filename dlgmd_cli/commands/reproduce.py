"""`dlgmd reproduce`: regenerate the paper's figures and tables, and check its claims."""

import os
import shlex
from pathlib import Path

import click

from dlgmd_cli.commands.console import Command, print_path, print_table
from dlgmd_cli.commands.options import dpi_option, folder_name, jobs_option, overwrite_option
from dlgmd_cli.commands.progress import progress

# Least load average at which times are not judged.
_IDLE = 0.5


@click.command(
    cls=Command,
    short_help="Check the paper's figures, tables and claims.",
    epilog="Example: dlgmd reproduce --quick --out paper",
)
@click.option(
    "--only",
    multiple=True,
    metavar="ID,ID",
    help="Figures, tables or claims, such as fig12,table4; repeatable.  [default: all]",
)
@click.option("--quick", is_flag=True, help="Six seeds instead of 20, no check at 1920x1080.")
@click.option(
    "--reference",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    metavar="DIR",
    help="The authors' frames (looming_ball, ball_and_capsules), to show beside ours.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default="dlgmd-paper",
    callback=folder_name,
    show_default=True,
    metavar="DIR",
    help="Folder for the report.",
)
@dpi_option
@overwrite_option
@jobs_option
def reproduce(
    only: tuple[str, ...],
    quick: bool,
    reference: Path | None,
    out: Path,
    dpi: int,
    overwrite: bool,
    jobs: int | None,
) -> None:
    """Regenerate the evidence of the paper, and say of each claim whether it holds.

    Writes OUT/report.html, one page that loads nothing from elsewhere; OUT/claims.csv, one row per
    claim, version of the model and seed; and every figure as PNG and PDF. A version is a latency
    with or without saturation, or the released code; each claim is checked under all of them, and
    without inhibition. Needs Jinja2, which comes with 'dlgmd[view]'.

    After Ctrl-C, the same command continues. The exit code is 0 whether claims hold or not.
    """
    from dlgmd_cli.machine.threads import n_processors
    from dlgmd_cli.reproduce import exhibits
    from dlgmd_cli.reproduce.claims import EMPTY, NO, UNDECIDED, YES, counts, load_claims, select
    from dlgmd_cli.reproduce.clips import check_reference
    from dlgmd_cli.reproduce.finished import FOLDER, Finished
    from dlgmd_cli.reproduce.plan import Plan, Started, compute, needed
    from dlgmd_cli.reproduce.report import REPORT, TABLE, Report, Section, require_jinja
    from dlgmd_cli.results.store import locked, refuse_existing

    specs, remarks = load_claims()
    specs = select(specs, [name for text in only for name in text.split(",")])
    check_reference(reference)
    require_jinja()
    for name in (REPORT, TABLE):
        refuse_existing(out / name, overwrite=overwrite)
    plan = Plan(quick, is_idle=_is_idle())
    plans = {name: exhibits.plans_of(name, plan, reference) for name in specs}
    started = {
        name: [Started.of(exhibits.EXHIBITS[name](one)) for one in each]
        for name, each in plans.items()
    }
    tasks = needed(one for each in started.values() for one in each)
    with locked(out):
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
    header = ("version", "claims hold", "hold without inhibition, too", "do not hold", "undecided")
    print_table(header, rows)
    for path in paths[:2]:
        print_path(path)


def _is_idle() -> bool:
    """Whether the machine has had next to nothing to do in the last minute, as far as known."""
    return hasattr(os, "getloadavg") and os.getloadavg()[0] < _IDLE


def _command(only: tuple[str, ...], quick: bool, reference: Path | None) -> str:
    words = ["dlgmd", "reproduce"]
    words += ["--only", ",".join(only)] if only else []
    words += ["--quick"] if quick else []
    words += ["--reference", str(reference)] if reference else []
    return shlex.join(words)
