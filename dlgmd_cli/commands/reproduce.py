"""`dlgmd reproduce`: regenerate the paper's figures and tables, and check its claims."""

from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands.console import Command
from dlgmd_cli.commands.options import dpi_option, folder_name, jobs_option, overwrite_option
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.commands.show import show


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
def reproduce(out: Path, **asked: Any) -> None:
    """Regenerate the evidence of the paper, and say of each claim whether it holds.

    Writes OUT/report.html, one page that loads nothing from elsewhere; OUT/claims.csv, one row per
    claim, version of the model and seed; and every figure as PNG and PDF. A version is a latency
    with or without saturation, or the released code; each claim is checked under all of them, and
    without inhibition. Needs Jinja2, which comes with 'dlgmd[view]'.

    After Ctrl-C, the same command continues. The exit code is 0 whether claims hold or not.
    """
    from dlgmd_cli.reproduce import reproduce as task

    show(task.reproduce(out, progress=progress, **asked))
