"""`dlgmd lab paper`: make the paper's figures and tables again, and check its claims."""

from pathlib import Path

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, progress, show


@click.command(cls=Command, short_help="Check the paper's figures, tables and claims.")
@click.option(
    "--only",
    multiple=True,
    metavar="ID,ID",
    help="Figures, tables or claims, such as fig12,table4; repeatable.  [default: all]",
)
@click.option("--quick", is_flag=True, help="Three seeds, and no Table IV at 1920x1080.")
@click.option(
    "--reference",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    metavar="DIR",
    help="The authors' frames (looming_ball, ball_and_capsules), which decide Figs. 8, 10 and 12.",
)
@options.folder_option(
    "--out", default="dlgmd-paper", show_default=True, help="Folder for the report."
)
@options.overwrite_option
@options.jobs_option
def paper(
    out: Path,
    only: tuple[str, ...],
    quick: bool,
    reference: Path | None,
    overwrite: bool,
    jobs: int | None,
) -> None:
    """Check the paper: make its figures and tables again, and test each claim.

    \b
    Examples:
      dlgmd lab paper --quick                 # three seeds, ten minutes
      dlgmd lab paper --out paper             # everything
      dlgmd lab paper --only fig12,table4     # a figure and a table

    Writes OUT/report.html, one page that loads nothing from elsewhere; OUT/claims.md, the claims by
    verdict; OUT/claims.csv, one row per claim, version of the model and seed; and every figure as
    PNG and PDF. A version is a reading of the text or of one of the authors' two codes; each claim
    is checked under all of them, and without inhibition. The flights need MuJoCo, the report
    Jinja2; the extra '.[lab]' has both.

    OUT/responses keeps what the models gave, so that an interrupted run goes on where it was.

    The exit code is 0 whether claims hold or not.
    """
    from dlgmd_cli.lab.paper import paper as task

    show(
        task.paper(
            out,
            only=only,
            quick=quick,
            reference=reference,
            overwrite=overwrite,
            jobs=jobs,
            progress=progress,
        )
    )
