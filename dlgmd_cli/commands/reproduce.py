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
@click.option("--quick", is_flag=True, help="Flights at 480x270, with two seeds each.")
@click.option(
    "--reference",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    metavar="DIR",
    help="The authors' frames (looming_ball, ball_and_capsules) for Figs. 8, 10 and 12.",
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
    claim and version of the model; and every figure as PNG and PDF. A version is a latency with
    or without saturation, or the released code; each claim is checked under all of them, and
    without inhibition. Needs Jinja2, which comes with 'dlgmd[view]'.

    The exit code is 0 whether claims hold or not.
    """
    from dlgmd_cli.lab.reproduce import flights, stimuli
    from dlgmd_cli.lab.reproduce.claims import (
        EMPTY,
        NO,
        UNDECIDED,
        YES,
        counts,
        load_claims,
        select,
    )
    from dlgmd_cli.lab.reproduce.clips import check_reference
    from dlgmd_cli.lab.reproduce.plan import Plan, compute, needed, shown_by
    from dlgmd_cli.lab.reproduce.report import REPORT, TABLE, Report, Section, require_jinja
    from dlgmd_cli.results.store import locked, refuse_existing
    from dlgmd_cli.threads import n_processors

    specs, remarks = load_claims()
    specs = select(specs, [name for text in only for name in text.split(",")])
    check_reference(reference)
    require_jinja()
    for name in (REPORT, TABLE):
        refuse_existing(out / name, overwrite=overwrite)
    plan, known = Plan(quick, reference, _is_idle()), stimuli.EXHIBITS | flights.EXHIBITS
    started = {name: known[name](plan) for name in specs}
    tasks = needed(started.values())
    with locked(out):
        with progress("reproduce", len(tasks), "clip") as on_result:
            data = compute(tasks, jobs or n_processors(), on_result)
        sections = [Section(spec, shown_by(started[name], data)) for name, spec in specs.items()]
        report = Report(sections, remarks, plan, _command(only, quick, reference))
        with progress("figures", len(specs), "figure") as on_figure:
            paths = report.write(out, dpi, on_figure)
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
