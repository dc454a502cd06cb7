"""`dlgmd view`: make web pages of stored results, with the film of the input."""

from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, progress, show


def _page(value: str) -> Path:
    """A folder, or a file that must end in .html."""
    is_file = options.is_file_name(Path(value))
    return options.file_ending("page.html")(value) if is_file else Path(value)


@click.command(cls=Command, short_help="Make a web page of results.")
@options.results_argument
@options.with_default(
    "-o",
    "--out",
    type=_page,
    default="dlgmd-out",
    metavar="PATH",
    help="Folder for the page, view-NAME.html, or a file ending in .html.",
)
@options.overwrite_option
@click.option(
    "--collision-frame",
    type=options.FRAME,
    multiple=True,
    help="Frame of a true collision; repeatable.",
)
@options.collisions_option
@click.option(
    "--input",
    "input_path",
    metavar="PATH",
    shell_complete=options.complete_file,
    help="Path of the input, if the input was moved after the run.",
)
@click.option(
    "--model",
    "models",
    type=options.MODEL,
    multiple=True,
    metavar="MODULE:CLASS",
    help="A custom model in the results: its module is imported to make the film. Repeatable.",
)
@click.option(
    "--zip",
    "packed",
    is_flag=True,
    help="Also pack the page and its files into PATH.zip, to send one file.",
)
@click.option("--no-film", is_flag=True, help="Leave out the film; nothing is decoded.")
def view(paths: tuple[Path, ...], **arguments: Any) -> None:
    """Make a web page of results: the film beside MP, attenuation and spikes.

    \b
    Examples:
      dlgmd view dlgmd-out/flight                        # a page of one result
      dlgmd view dlgmd-out/*/                            # pages with an index
      dlgmd view dlgmd-out/flight --collision-frame 140  # with its collision

    RESULT is a folder that 'dlgmd run', 'dlgmd compare' or 'dlgmd batch' wrote. Results of the same
    input share a page. Several inputs have a page each, in the folder NAME-pages beside an index
    that filters and sorts the inputs; move folder and index together.

    Pages need no network. The film shows the input with the active cells of layer G tinted; the
    model is run once more for it. Collisions can be labelled: the browser keeps the labels, and the
    index writes all labels into one labels.csv. Needs the extra view.
    """
    from dlgmd_cli.pages import view as task

    show(task.view(paths, progress=progress, **arguments))
