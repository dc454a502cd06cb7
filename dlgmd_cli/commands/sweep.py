"""`dlgmd sweep`: a model over a grid of two of its parameters."""

from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands._console import (
    EXIT_INTERRUPTED,
    Command,
    explain_infinity,
    print_path,
    print_table,
    say,
    warn,
)
from dlgmd_cli.commands._input import input_options
from dlgmd_cli.commands._interrupts import Interrupts
from dlgmd_cli.commands._model import MODEL_OPTIONS, ModelChoice, engine_option
from dlgmd_cli.commands._subjects import Asked, cube_options
from dlgmd_cli.commands._sweeping import Plan
from dlgmd_cli.commands._types import OptionGroup, Output, output_options, width_option
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters import MODELS
from dlgmd_cli.runs.axis import Axis, Grid, expand

if TYPE_CHECKING:
    from dlgmd_cli.parameters import Config, Parameters
    from dlgmd_cli.plots.style import Width
    from dlgmd_cli.results.journal import Journal
    from dlgmd_cli.results.sweeps import SweepResult


class AxisText(click.ParamType):
    """KEY=FROM:TO:STEP or KEY=VALUE,VALUE, whatever the key."""

    name = "AXIS"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The text, if it can be an axis."""
        try:
            expand(value)
        except ParameterError as error:
            self.fail(str(error), param, ctx)
        return str(value)


_AXIS_HELP = "A parameter and its values: KEY=FROM:TO:STEP, or KEY=VALUE,VALUE."


@click.command(
    cls=Command,
    epilog="Example: dlgmd sweep --x sigma_e=0.2:2.0:0.1 --y sigma_i=0.5:6:0.25",
)
@click.argument("input_path", metavar="[INPUT]", required=False)
@click.option("--x", "x_text", type=AxisText(), metavar="AXIS", required=True, help=_AXIS_HELP)
@click.option("--y", "y_text", type=AxisText(), metavar="AXIS", required=True, help="As --x.")
@cube_options
@click.option(
    "--false-positive-frame",
    type=click.IntRange(min=0),
    metavar="N",
    help="Frame about which a response is a mistake, for distinguishability.",
)
@OptionGroup("asked_model", dict, *MODEL_OPTIONS)
@engine_option
@input_options
@click.option(
    "--jobs",
    type=click.IntRange(1, 512),
    metavar="N",
    help="Processes that share the work; values do not depend on it.  [default: all processors]",
)
@width_option
@output_options
def sweep(
    input_path: str | None,
    x_text: str,
    y_text: str,
    cubes: dict[str, Any],
    false_positive_frame: int | None,
    asked_model: dict[str, Any],
    engine: str | None,
    given: dict[str, Any],
    jobs: int | None,
    width: "Width",
    output: Output,
) -> None:
    """Run the model with every pair of values of two parameters.

    Without INPUT, over black cubes that cross a white picture, one clip a speed: attenuation, as
    in the paper's Fig. 11. The other parameters are then alpha = beta = lam = 0, a = 1.5, r = 4
    and the defaults, unless --set or --config names others; --param changes single ones.

    With INPUT, as in 'dlgmd run': peak membrane potential, sharpness (the mean of the potential
    scaled to its peak), distinguishability and the first collision. The other parameters are those
    of set 9, unless --set or --config names others.

    Writes OUT/sweep-NAME/ with sweep.csv, a row a point and speed, a figure, and sweep.yaml. Points
    are kept as they are done: after an interrupt, the same command goes on.
    """
    asked = Asked(input_path, cubes, given, false_positive_frame)
    choice = ModelChoice(**asked_model, base=None if input_path else _fig_11())
    grid = _grid(x_text, y_text, choice, asked_model)
    from dlgmd_cli.runs.sweep import grid_parameters

    points, fault = grid_parameters(grid, choice.params)
    with (
        Interrupts() as interrupts,
        asked.open(choice.recorded_options, choice.origin) as (subject, options),
    ):
        plan = Plan.make(choice, engine, grid, points, subject, options)
        with plan.journal(output) as journal:
            if journal.points:
                say(f"{len(journal.points)} of {len(points)} points were there already.")
            try:
                complete = plan.compute(journal, jobs)
            except Exception:
                if journal.points:
                    say(_kept(journal, points))
                raise
            interrupts.hold()
            if not complete:
                say("Interrupted; writing what was computed.")
            if fault is not None:
                n_left_out = len(grid) - len(points)
                warn(f"{n_left_out} of {len(grid)} points cannot be computed: {fault.why}")
            for warning in journal.facts.get("warnings", []):
                warn(f"{input_path}: {warning}")
            result = plan.result(journal)
            plan.write(journal, result, complete, output.formats if complete else (), width)
            _show(result)
            print_path(journal.folder)
    if not complete:
        say(_kept(journal, points))
    if not complete or interrupts.count:
        raise click.exceptions.Exit(EXIT_INTERRUPTED)


def _fig_11() -> "Config":
    """The parameters of the paper's Fig. 11, less those that it shows."""
    from dlgmd_cli.parameters import Config

    return Config("fig11", values={"alpha": 0.0, "beta": 0.0, "lam": 0.0, "a": 1.5, "r": 4})


def _grid(x_text: str, y_text: str, choice: ModelChoice, asked: dict[str, Any]) -> Grid:
    """Both axes, blaming whichever is at fault."""
    from dlgmd_cli.parameters import parse_overrides

    axes = []
    for option, text in (("--x", x_text), ("--y", y_text)):
        try:
            axes.append(Axis.parse(text, MODELS[choice.model].parameters))
        except ParameterError as error:
            raise ParameterError(f"Invalid value for '{option}'", error.why, error.mend) from None
    for axis in axes:
        if axis.key in parse_overrides(asked["pairs"]):
            raise click.UsageError(f"--param sets {axis.key}, which is an axis. Leave it out.")
        if axis.key == "formulation" and asked["formulation"] is not None:
            raise click.UsageError("--formulation sets what is an axis. Leave it out.")
    return Grid(*axes)


def _kept(journal: "Journal", points: "dict[int, Parameters]") -> str:
    """What an end before the end leaves."""
    return (
        f"{journal.folder} keeps {len(journal.points)} of {len(points)} points; "
        "the same command goes on from there."
    )


def _show(result: "SweepResult") -> None:
    """The extremes of what was measured, on stdout."""
    from dlgmd_cli.results.sweeps import extremes

    print_table(("", "least", "at", "greatest", "at"), extremes(result))
    if result.has_infinite("distinguishability"):
        explain_infinity()
