"""`dlgmd reproduce`: regenerate the paper's figures and tables, and check its claims."""

import shlex
from pathlib import Path

import click

from dlgmd_cli.commands.console import Command, print_path, print_table
from dlgmd_cli.commands.options import dpi_option, jobs_option, overwrite_option
from dlgmd_cli.commands.progress import progress


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
@click.option("--quick", is_flag=True, help="Every claim, but one seed for each flight.")
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
    claim and formulation; and every figure as PNG and PDF. Each claim is checked under all three
    formulations of the model. Needs Jinja2, which comes with 'dlgmd[view]'.

    The exit code is 0 whether claims hold or not.
    """
    from dlgmd_cli.lab.reproduce.claims import (
        NO,
        UNDECIDED,
        YES,
        counts,
        findings,
        load_claims,
        select,
    )
    from dlgmd_cli.lab.reproduce.clips import check_reference
    from dlgmd_cli.lab.reproduce.compute import EXHIBITS, compute, jobs_for
    from dlgmd_cli.lab.reproduce.plan import ANY, Plan
    from dlgmd_cli.lab.reproduce.report import REPORT, TABLE, require_jinja, write_report
    from dlgmd_cli.results.store import locked, refuse_existing
    from dlgmd_cli.threads import n_processors

    specs, inconsistencies = load_claims()
    specs = select(specs, [name for text in only for name in text.split(",")])
    check_reference(reference)
    require_jinja()
    for name in (REPORT, TABLE):
        refuse_existing(out / name, overwrite=overwrite)
    plan = Plan(quick, reference)
    todo = jobs_for(specs, plan)
    with locked(out):
        with progress("reproduce", len(todo), "clip") as on_job:
            data = compute(todo, jobs or n_processors(), on_job)
        found = {
            name: findings(spec, EXHIBITS[name].values(plan, data)) for name, spec in specs.items()
        }
        with progress("figures", len(specs), "figure") as on_figure:
            command = _command(only, quick, reference)
            paths = write_report(
                *(out, specs, found, inconsistencies, plan, data, command, on_figure), dpi
            )
    every = [one for some in found.values() for one in some]
    rows = [
        ("not about the D-LGMD" if name == ANY else name,
         *(str(count[kind]) for kind in (YES, NO, UNDECIDED)))
        for name, count in counts(every).items()
    ]  # fmt: skip
    print_table(("formulation", "claims hold", "do not hold", "undecided"), rows)
    for path in paths[:2]:
        print_path(path)


def _command(only: tuple[str, ...], quick: bool, reference: Path | None) -> str:
    """The command line that repeats this report."""
    words = ["dlgmd", "reproduce"]
    words += ["--only", ",".join(only)] if only else []
    words += ["--quick"] if quick else []
    words += ["--reference", str(reference)] if reference else []
    return shlex.join(words)
