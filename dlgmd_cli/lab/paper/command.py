"""`dlgmd reproduce`: regenerate the paper's figures and tables, and check its claims."""

from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, progress, show
from dlgmd_cli.errors import ParameterError


def _seeds(text: str) -> tuple[int, ...]:
    """`100:119` -> (100, …, 119)."""
    first, _, last = text.partition(":")
    if not (first.isdecimal() and last.isdecimal() and int(first) <= int(last) < int(first) + 1000):
        raise ParameterError("", f"{text[:40]!r} is not FIRST:LAST", "Write 100:119.")
    return tuple(range(int(first), int(last) + 1))


@click.command(cls=Command, short_help="Check the paper's figures, tables and claims.")
@click.option(
    "--only",
    multiple=True,
    metavar="ID,ID",
    help="Figures, tables or claims, such as fig12,table4; repeatable.  [default: all]",
)
@click.option("--quick", is_flag=True, help="Six seeds instead of 20, no check at 1920x1080.")
@click.option(
    "--seeds",
    type=options.Parsed("FIRST:LAST", _seeds),
    help="Seeds of the flights, such as 100:119.  [default: 0:19, or 0:5 with --quick]",
)
@click.option(
    "--size",
    type=options.SIZE,
    help="Frame size of the flights; larger ones are not run without inhibition.  "
    "[default: 480x270, and 1920x1080 beside it]",
)
@click.option(
    "--reference",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    metavar="DIR",
    help="The authors' frames (looming_ball, ball_and_capsules), to show beside ours.",
)
@options.folder_option(
    "--out", default="dlgmd-paper", show_default=True, help="Folder for the report."
)
@options.dpi_option
@options.overwrite_option
@options.jobs_option
def paper(out: Path, **arguments: Any) -> None:
    """Check the paper: make its figures and tables again, and test each claim.

    \b
    Examples:
      dlgmd reproduce --quick                 # six seeds, without 1920x1080
      dlgmd reproduce --out paper             # everything
      dlgmd reproduce --only fig12,table4     # a figure and a table

    Writes OUT/report.html, one page that loads nothing from elsewhere; OUT/claims.csv, one row per
    claim, version of the model and seed; and every figure as PNG and PDF. A version is a reading
    of the text or of one of the authors' two codes; each claim is checked under all of them, and
    without inhibition. Needs Jinja2, which comes with 'dlgmd[view]'.

    After Ctrl-C, the same command continues. The exit code is 0 whether claims hold or not.
    """
    from dlgmd_cli.lab.paper import reproduce as task

    arguments["seeds"] = arguments["seeds"] or ()
    show(task.reproduce(out, progress=progress, **arguments))
