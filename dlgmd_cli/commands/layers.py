"""`dlgmd layers`: show a model's layers as a contact sheet, as arrays, or as a film."""

import re
from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, progress, refuse_given, show
from dlgmd_cli.parameters.checks import listed


def _frame_numbers(value: str) -> tuple[int, ...]:
    """`65, 1-3` -> (65, 1, 2, 3)."""
    parts = listed(value)
    for part in parts:
        if re.fullmatch(r"\d{1,9}", part, re.ASCII) is None:
            raise click.BadParameter(f"{part[:40]!r} is not a frame number. Write 1,50,65.")
    return tuple(map(int, parts))


@click.command(cls=Command, short_help="Show the layers P, S and G of a model.")
@options.input_argument
@click.option(
    "--frames",
    type=_frame_numbers,
    metavar="N,N,…",
    help="Frames to show, counted from 0.  [default, without --video: spread from the first alarm "
    "to the collision, or to the strongest response]",
)
@click.option("--npz", is_flag=True, help="Also write the layers of --frames as NumPy arrays.")
@click.option(
    "--video",
    "film",
    type=options.file_ending("film.mp4"),
    metavar="FILE",
    help="Write an .mp4 of the input, S, G and the membrane potential.",
)
@click.option(
    "--overlay",
    is_flag=True,
    help="With --video: show the input at full size, with the active cells of G tinted, MP as a "
    "bar and alarms as a banner.",
)
@options.model_options
@options.input_options("start", "end", "input_fps", "times", "fov")
@options.output_options
def layers(
    input_path: str, frames: tuple[int, ...] | None, film: Path | None, **arguments: Any
) -> None:
    """Show the layers of a model: photoreceptors P, summation S and grouping G.

    \b
    Examples:
      dlgmd layers flight.mp4                         # from alarm to collision
      dlgmd layers flight.mp4 --set 9 --frames 50,75  # these frames, with set 9
      dlgmd layers flight.mp4 --video layers.mp4      # a film of all frames

    INPUT is as in 'dlgmd run'. Without --frames, frames from the first alarm (n_sp spikes in a row)
    to the collision are shown, or to the strongest response where none is known; without an alarm,
    those with the strongest responses. Black and frozen frames are left out; --end leaves out the
    frames after a collision. A run.yaml given with --config brings the options of its run, such as
    the crop.

    Writes OUT/NAME/ with a figure of heat maps and layers.yaml; --npz adds layers.npz. --video
    writes a film of the input, S and G above the membrane potential. With --video, the heat maps
    are left out unless --frames is given.
    """
    if arguments["overlay"] and film is None:
        raise click.UsageError("--overlay works only with --video. Add --video film.mp4.")
    if not frames and film is not None and arguments["npz"]:
        raise click.UsageError("--npz writes the layers of --frames. Give --frames 1,50,65.")
    if not frames and film is not None:
        useless = {"out", *(("formats",) if arguments["formats"] else ())}
        refuse_given(useless, "works only with --frames, beside --video")
    from dlgmd_cli.tasks import layers as task

    show(task.layers(input_path, frames=frames, film=film, progress=progress, **arguments))
