"""`dlgmd export`: the model for other machines."""

from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, show


@click.command(cls=Command, short_help="Write the model as C for a microcontroller.")
@options.model_in_pixels_options
@options.alarm_option
@options.with_default(
    "--size", type=options.SIZE, default="96x72", help="Size of the frames in px."
)
@options.input_options("fov", "camera_tilt")
@click.option(
    "--prefix",
    default="",
    help="Beginning of the names of functions, types, macros and files; with different ones, "
    "several exports fit into one firmware.",
)
@options.folder_option(
    "-o", "--out", default=Path("dlgmd-c"), show_default=True, help="Folder for the sources."
)
@options.overwrite_option
def export(**arguments: Any) -> None:
    """Write a D-LGMD, the expansion and the alarm as C99 for a microcontroller.

    \b
    Examples:
      dlgmd export                         # frames of 96x72 px
      dlgmd export --set 9 --size 160x120  # the paper's set 9
      dlgmd export --fov 120               # a wide lens

    The C code takes grey frames of one size, one byte per cell. For each frame, it returns the
    membrane potential, the time to contact, spike, alarm, and their place in the image. The
    expansion is measured unless spikes raise the alarm (--alarm spikes). The code allocates no
    memory and needs no library but memcpy and the like. The parameters are constants in the code.

    Writes the sources, an example, and a test with Python's answers ('make test'; 'make qemu' runs
    the test on emulated Cortex-M boards). DIR/README.md explains the files and states their memory
    and operations.

    Only the model dlgmd can be exported, in all its formulations. For frames up to 128 px wide, the
    default is the preset flight-small instead of flight.
    """
    from dlgmd_cli.microcontroller import export as task

    show(task.export(**arguments))
