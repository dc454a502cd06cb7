"""`dlgmd sweep`: run a model over a grid of two of its parameters."""

from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, progress, show

_AXIS_HELP = "First parameter and its values: KEY=FROM:TO:STEP or KEY=VALUE,VALUE."


def _asked(
    pairs: tuple[str, ...],
    set_name: str | None,
    config: str | None,
    model: str | None,
) -> dict[str, Any]:
    """The arguments of `dlgmd_cli.sweep` that choose the model."""
    named = options.named_model(set_name, config, model) if set_name or config else None
    # --model alone stays a name: with cubes, the D-LGMD then has the parameters of Fig. 11.
    return {"model": named or model, "param": options.overrides(pairs)}


@click.command(cls=Command)
@options.inputs_argument
@click.option(
    "--x", metavar="AXIS", required=True, shell_complete=options.complete_key, help=_AXIS_HELP
)
@click.option(
    "--y",
    metavar="AXIS",
    required=True,
    shell_complete=options.complete_key,
    help="Second parameter and its values.",
)
@click.option(
    "--speed",
    type=float,
    multiple=True,
    metavar="V",
    help="Without INPUT: speed of the cube in px/frame; repeatable.  [default: 1, 2, 3 and 4]",
)
@click.option(
    "--cube-size",
    type=float,
    metavar="S",
    help="Without INPUT: side of the cubes in px.  [default: 40]",
)
@click.option(
    "--false-positive-frame",
    type=options.FRAME,
    help="With INPUT: frame of a false alarm, to measure distinguishability.",
)
@options.option_group("", _asked, *options.ONE_MODEL)
@options.input_option("size")
@options.jobs_option
@options.output_options
def sweep(inputs: tuple[str, ...], **arguments: Any) -> None:
    """Run a model over a grid of values of two parameters.

    \b
    Examples:
      dlgmd sweep --x sigma_e=0.2:2:0.1 --y sigma_i=0.5:6:0.25    # crossing cubes
      dlgmd sweep flight.mp4 --set 9 --x r=2,4,6 --y a=0.5:2:0.5  # a video
      dlgmd sweep a.mp4 b.mp4 c.mp4 --x r=2,4,6 --y a=1,2         # three videos

    Without INPUT, the input is black cubes that cross a white image, one clip per speed, and
    the attenuation is measured, as in the paper's Fig. 11. Without --set and --config, the other
    parameters are those of Fig. 11: alpha = beta = lam = 0, a = 1.5, r = 4.

    With INPUT, a video as in 'dlgmd run', the measures are the peak membrane potential (MP), the
    sharpness (the mean MP relative to its peak), the distinguishability and the first alarm.

    Writes OUT/sweep-NAME/ with sweep.csv (one row per grid point and speed), a figure, and
    sweep.yaml. Several inputs have a folder each, and OUT/sweeps.png shows their maps side by side.
    An interrupted sweep writes nothing.
    """
    from dlgmd_cli.tasks.sweep import sweep as task

    arguments["progress"] = progress
    several = len(inputs) > 1
    found = task.sweeps(inputs, **arguments) if several else task.sweep(*inputs, **arguments)
    show(found)
