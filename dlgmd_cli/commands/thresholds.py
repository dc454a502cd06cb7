"""The options --threshold and --speed-m-s, which set the threshold of the rule that holds."""

from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from dlgmd_cli.tasks.call import Setup

threshold_option = click.option(
    "--threshold",
    type=click.FLOAT,
    metavar="X",
    expose_value=False,
    callback=lambda ctx, _, value: ctx.meta.update(threshold=value),
    help="Threshold of the alarm rule: expansion rate in 1/s, time to contact in s, or normalised "
    "MP of a spike.  [default: that of the model]",
)
speed_option = click.option(
    "--speed-m-s",
    metavar="M/S",
    expose_value=False,
    callback=lambda ctx, _, value: ctx.meta.update(speed_m_s=value),
    help="With the rule expansion or ttc: alarm in time for a stop from this speed, as 'dlgmd live'"
    " does, with a reaction of 0.1 s, 25 degrees of tilt and 8 m/s³ of jerk.",
)


def at_threshold(setup: "Setup") -> "Setup":
    """The model with the threshold that --threshold gives, or that follows --speed-m-s of `run`."""
    from dlgmd_cli.tasks import call  # imports NumPy, which is slow

    meta = click.get_current_context().meta
    return call.at_threshold(setup, meta.get("threshold"), meta.get("speed_m_s"))
