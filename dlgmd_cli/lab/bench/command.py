"""`dlgmd bench`: the computing times of the paper's Table IV, measured on this machine."""

from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, progress, show


@click.command(cls=Command)
@options.optional_input_argument
@click.option(
    "--radius",
    "radii",
    type=options.numeric(int, 1, 32),
    multiple=True,
    metavar="R",
    help="Radius of the kernels in px; repeatable.  [default: 6, 4, 3, 2]",
)
@click.option(
    "--scale",
    "scales",
    type=options.numeric(low_open=True, high=1),
    multiple=True,
    metavar="S",
    help="Scale of the processed frames; repeatable.  [default: 1, 0.5, 0.25, 0.1, 0.02]",
)
@options.with_default(
    "--frames",
    type=options.numeric(int, 12, 100_000),
    default=120,
    help="Number of frames to process.",
)
@options.with_default(
    "--repeat",
    "repeats",
    type=options.numeric(int, 1, 1000),
    default=3,
    help="How often each measurement is repeated; medians are shown.",
)
@options.engine_option
@options.input_option("decoder")
@click.option(
    "--csv",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Also write the table to a CSV file.",
)
@options.overwrite_option
@options.json_option
def bench(input_path: str | None, as_json: bool, **arguments: Any) -> None:
    """Measure how long the model takes, as in the paper's Table IV.

    \b
    Examples:
      dlgmd bench                                  # on a rendered 1080p flight
      dlgmd bench flight.mp4 --radius 6 --scale 1  # on your own video
      dlgmd bench --engine numba --csv bench.csv   # another engine; a file

    Runs set 7 with each radius at each scale over INPUT, or over a rendered 1080p flight. Shows the
    time per frame of the core (the model alone), of decoding (with conversion to grey and scaling),
    and of the whole pipeline, in which both run in parallel.
    """
    from dlgmd_cli.tasks import bench as task

    show(task.bench(input_path, progress=progress, **arguments), as_json=as_json)
