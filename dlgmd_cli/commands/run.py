"""`dlgmd run`: run a model over one video."""

from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, progress, show
from dlgmd_cli.results.files import RUN, in_words


@click.command(cls=Command)
@options.input_argument
@options.model_options
@options.alarm_option
@options.threshold_option
@options.speed_option
@options.brake_option
@options.input_options(
    *("size", "scale", "fps", "start", "end", "crop", "mask", "repeats", "input_fps", "times"),
    *("bit_depth", "topic", "decoder", "normalise", "fov", "camera_tilt", "heading"),
)
@options.run_output_options
@options.clips_option
def run(input_path: str, **arguments: Any) -> None:
    """Run a model over a video.

    \b
    Examples:
      dlgmd run flight.mp4                       # the default preset, flight
      dlgmd run flight.mp4 --set 9 --format pdf  # the paper's set 9; PDF figures
      dlgmd run flight.mp4 --start 10 --end 20   # these ten seconds only

    INPUT is a video file, a folder of images, a quoted pattern such as 'frames/%04d.png' or
    'frames/*.png', a TIFF stack, a ROS bag (.bag, .mcap, or the folder of ROS 2), or a .npy array
    of shape (n, H, W) or (n, H, W, 3).

    Writes these files into OUT/NAME/; the figures and captions in the formats of --format.
    {files}.

    A spike is a frame whose normalised MP reaches the threshold t_mp. One rule raises the alarms.
    {rules}. The preset flight has the rule expansion. Pauses under 0.3 s do not end an alarm.
    """
    from dlgmd_cli.tasks import run as task

    show(task.run(input_path, progress=progress, **arguments))


# The help names what is declared elsewhere.
run.help = str(run.help).format(files=in_words(RUN), rules=options.RULES_TEXT)
