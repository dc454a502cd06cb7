"""`dlgmd info`: describe videos, and suggest options for a run."""

from typing import Any

import click

from dlgmd_cli.commands import console, options


@click.command(
    cls=console.Command, short_help="Describe videos: size, frame rate, duplicate frames, damage."
)
@click.argument(
    "input_paths", metavar="INPUT...", nargs=-1, required=True, shell_complete=options.complete_file
)
@click.option(
    "--write-mask",
    type=options.file_ending("mask.png"),
    metavar="FILE.png",
    help="Write a mask for --mask: black where pixels never change, such as an on-screen display.",
)
@options.overwrite_option
@options.input_options("input_fps", "topic", "decoder")
def info(input_paths: tuple[str, ...], **arguments: Any) -> None:
    """Describe videos: size, codec, frame rate, duplicate frames, damage.

    \b
    Examples:
      dlgmd info flight.mp4                        # facts, and fitting options
      dlgmd info flight.mp4 --write-mask mask.png  # a mask for its display
      dlgmd info one.mp4 two.mp4                   # several videos

    INPUT is as in 'dlgmd run', and is read to the end. Below the facts, the command suggests
    options of 'dlgmd run', or how to prepare the file first.
    """
    from dlgmd_cli.tasks import info as task

    console.show(task.info(input_paths, progress=console.progress, **arguments))
