"""The options --threshold and --speed-m-s, which set the threshold of the rule that holds."""

from dataclasses import replace
from typing import TYPE_CHECKING

import click

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters.checks import in_argument
from dlgmd_cli.parameters.keys import Parameters, changed

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


def require_speed_rule(params: Parameters) -> None:
    """Raise ParameterError if the threshold cannot follow --speed-m-s."""
    from dlgmd_cli.models.rules import rule_of  # imports NumPy, which is slow

    if click.get_current_context().meta.get("threshold") is not None:
        why = "--speed-m-s and --threshold exclude each other"
        raise ParameterError("", why, "Give one of them.")
    if not rule_of(params).follows_speed:
        why = "--speed-m-s works only with the rules expansion and ttc"
        raise ParameterError("", why, "Add --alarm expansion.")


def at_threshold(setup: "Setup") -> "Setup":
    """The model with the threshold that --threshold gives, or that follows --speed-m-s of `run`."""
    from dlgmd_cli.models import stopping
    from dlgmd_cli.models.rules import rule_of

    meta = click.get_current_context().meta
    params, threshold = setup.params, meta.get("threshold")
    if (speed := stopping.speed_of(meta.get("speed_m_s"))) is not None:
        require_speed_rule(params)
        params = stopping.following(params, stopping.brakes_of(), float(speed))
    elif threshold is not None:
        rule = rule_of(params)
        if not rule.key:
            why = f"the rule {rule.name} has no threshold that is a parameter"
            raise ParameterError("", why, "Leave out --threshold.")
        with in_argument("threshold"):
            params = changed(params, **{rule.key: threshold})
    return replace(setup, params=params)
