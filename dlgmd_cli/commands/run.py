"""`dlgmd run`: run a model over one video."""

from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.commands.show import show

if TYPE_CHECKING:
    from dlgmd_cli.tasks.setup import Setup


@click.command(
    cls=Command,
    epilog="Example: dlgmd run flight.mp4 --set 9 --scale 0.5 --start 00:00:10 --format pdf",
)
@options.input_argument
@options.model_options
@options.input_options
@options.output_options
@options.json_option
@options.clips_option
@click.option("--hash", "hashed", is_flag=True, help="Record the SHA-256 of the input, too.")
def run(
    input_path: str,
    setup: "Setup",
    given: dict[str, Any],
    output: dict[str, Any],
    as_json: bool,
    **asked: Any,
) -> None:
    """Run a model over a video.

    INPUT is a video file, a folder of pictures, a quoted pattern such as 'frames/%04d.png' or
    'frames/*.png', a ROS bag (.bag, .mcap, or the folder of ROS 2), or a .npy array of shape
    (n, H, W) or (n, H, W, 3).

    Writes OUT/NAME/ with mp.csv (the membrane potential, MP), attenuation.csv, spikes.csv (spikes
    and alarms of each frame), a figure of each, alarms.csv (when each alarm begins and ends, and
    the side it comes from), and run.yaml, which repeats the run with --config.

    A spike is a frame whose normalised MP reaches the threshold t_mp. n_sp spikes in a row (default
    2; 1 in the preset flight) raise an alarm, and pauses under 0.3 s do not end it.
    """
    from dlgmd_cli.tasks import run as task

    asked |= {**output, **given}
    show(task.run(input_path, model=setup, progress=progress, **asked), as_json=as_json)
