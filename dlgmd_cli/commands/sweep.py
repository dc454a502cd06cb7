"""`dlgmd sweep`: run a model over a grid of two of its parameters."""

from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.checks import blame
from dlgmd_cli.commands.console import (
    INFINITE_DISTINGUISHABILITY,
    Command,
    end_if_interrupted,
    print_json,
    print_path,
    print_table,
    say,
    tell,
    warn,
    warn_undrawn,
)
from dlgmd_cli.commands.options import (
    FRAME,
    ONE_MODEL,
    Output,
    complete_key,
    engine_option,
    input_options,
    jobs_option,
    option_group,
    optional_input_argument,
    report_options,
)
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.parameters import Parameters, parse_overrides

if TYPE_CHECKING:
    from dlgmd_cli.results.sweep import Grid
    from dlgmd_cli.runs.setup import Setup
    from dlgmd_cli.runs.sweep import Sweep, SweepInput

_AXIS_HELP = "First parameter and its values: KEY=FROM:TO:STEP or KEY=VALUE,VALUE."

cube_options = option_group(
    "shape",
    dict,
    click.option(
        "--speed",
        type=float,
        multiple=True,
        metavar="V",
        help="Without INPUT: speed of the cube in px/frame; repeatable.  [default: 1, 2, 3 and 4]",
    ),
    click.option(
        "--cube-size",
        "--object-size",
        "cube_size",
        type=float,
        metavar="S",
        help="Without INPUT: side of the cubes in px.  [default: 40]",
    ),
    click.option(
        "--frames",
        type=int,
        metavar="N",
        help="Without INPUT: frames in each clip.  [default: until the fastest cube has left the "
        "picture, at most 75]",
    ),
)


@click.command(
    cls=Command,
    epilog="Example: dlgmd sweep --x sigma_e=0.2:2.0:0.1 --y sigma_i=0.5:6:0.25",
)
@optional_input_argument
@click.option("--x", metavar="AXIS", required=True, shell_complete=complete_key, help=_AXIS_HELP)
@click.option(
    "--y",
    metavar="AXIS",
    required=True,
    shell_complete=complete_key,
    help="Second parameter and its values.",
)
@cube_options
@click.option(
    "--false-positive-frame",
    type=FRAME,
    metavar="N",
    help="With INPUT: frame of a false alarm, to measure distinguishability.",
)
@option_group("asked", dict, *ONE_MODEL, engine_option)
@input_options
@jobs_option
@report_options
def sweep(
    input_path: str | None,
    x: str,
    y: str,
    shape: dict[str, Any],
    false_positive_frame: int | None,
    asked: dict[str, Any],
    given: dict[str, Any],
    jobs: int | None,
    output: Output,
) -> None:
    """Run a model over a grid of values of two parameters.

    Without INPUT, the model sees black cubes that cross a white picture, one clip per speed, and
    the attenuation is measured, as in the paper's Fig. 11. Unless --set or --config says otherwise,
    the other parameters are those of that figure: alpha = beta = lam = 0, a = 1.5, r = 4.

    With INPUT, a video as in 'dlgmd run', the measures are the peak membrane potential (MP), the
    sharpness (the mean MP relative to its peak), the distinguishability and the first alarm.

    Writes OUT/sweep-NAME/ with sweep.csv (one row per grid point and speed), a figure, and
    sweep.yaml. After an interruption, the same command continues where it stopped.
    """
    import numpy as np

    from dlgmd_cli.results import store
    from dlgmd_cli.runs.run import open_input
    from dlgmd_cli.runs.setup import input_options as options_of
    from dlgmd_cli.runs.sweep import FIGURE, Sweep, video_input
    from dlgmd_cli.threads import n_processors

    _refuse_others(input_path, shape, {**given, "false_positive_frame": false_positive_frame})
    setup = _setup(asked, sees_cubes=input_path is None)
    grid = _grid(x, y, type(setup.params), asked)
    with ExitStack() as opened:
        if input_path is None:
            subject = _cubes(shape, given["size"], grid, setup.params)
        else:
            options = options_of(setup, given)
            video = opened.enter_context(open_input(input_path, [setup], options))
            subject = video_input(input_path, video, options, false_positive_frame)
        folder = output.out / f"sweep-{store.fitting(subject.name)}"
        swept = Sweep(folder, subject, grid, setup)
        result, n_points = swept.result, len(swept.points)
        opened.enter_context(store.locked(folder))
        swept.resume(overwrite=output.overwrite)
        _compute(swept, folder, jobs or n_processors())
        if swept.fault is not None:
            left_out = f"{len(grid) - n_points} of {len(grid)} points"
            warn(f"{left_out} cannot be computed: {swept.fault.why}")
        for warning in swept.warnings:
            warn(f"{input_path or subject.name}: {warning}")
        figures = {}
        if output.formats:
            from dlgmd_cli.plots.style import figure_files
            from dlgmd_cli.plots.sweeps import plot_sweep

            figures = figure_files(
                {FIGURE: partial(plot_sweep, result, output.width)}, output.formats, output.dpi
            )
        warn_undrawn(folder, swept.finish(figures))
    if output.as_json:
        facts = {"result": str(folder), "complete": True, "points": n_points}
        print_json({**facts, "warnings": swept.warnings, "measures": result.facts()})
    else:
        print_table(("", "least", "at", "greatest", "at"), result.extremes())
        if np.isinf(result.columns.get("distinguishability", 0.0)).any():
            click.echo(INFINITE_DISTINGUISHABILITY)
        print_path(folder)
    end_if_interrupted(folder, n_points, complete=True)


def _compute(swept: "Sweep", folder: Path, n_jobs: int) -> None:
    """Compute the missing points; say how many were done before, and before an early end."""
    done, n_points = swept.result.done, len(swept.points)
    if done:
        tell(f"{len(done)} of {n_points} points are already done.")
    try:
        swept.compute(n_jobs, progress=progress)
    except Exception:
        if done:
            say(
                f"{folder} holds {len(done)} of {n_points} points; the same command continues from "
                "there."
            )
        raise


def _refuse_others(input_path: str | None, cubes: dict[str, Any], of_input: dict[str, Any]) -> None:
    """Raise UsageError if an option is given that does not work with, or without, INPUT."""
    options, needed = (cubes, "without") if input_path else (of_input, "with an")
    for name, value in options.items():
        if value not in (None, ()) and name != "size":
            option = name.replace("_", "-")
            raise click.UsageError(f"--{option} works only {needed} INPUT. Leave it out.")


def _setup(asked: dict[str, Any], *, sees_cubes: bool) -> "Setup":
    """The model that the options ask for; for cubes, by default that of the paper's Fig. 11."""
    from dlgmd_cli.runs.setup import DLGMD, choose

    overrides = parse_overrides(asked["pairs"])
    origin = asked["set_name"], asked["config"]
    model = asked["model"]
    is_fig11 = sees_cubes and origin == (None, None) and model in (None, DLGMD)
    if is_fig11:
        from dlgmd_cli.lab.stimuli.cubes import FIG_11

        model, overrides = DLGMD, {**FIG_11, **overrides}
    setup = choose(*origin, model, overrides, asked["formulation"], asked["engine"])
    return replace(setup, label="fig11") if is_fig11 else setup


def _grid(x: str, y: str, kind: type[Parameters], asked: dict[str, Any]) -> "Grid":
    """The grid of both axes; errors name the option of the axis."""
    from dlgmd_cli.results.sweep import Axis, Grid

    axes = []
    for option, text in (("--x", x), ("--y", y)):
        with blame(f"Invalid value for '{option}'"):
            axes.append(Axis.parse(text, kind))
        key = axes[-1].key
        if key in parse_overrides(asked["pairs"]):
            raise click.UsageError(f"--param sets {key}, which is an axis. Leave it out.")
        if key == "formulation" and asked["formulation"] is not None:
            raise click.UsageError("--formulation is an axis of the sweep. Leave it out.")
    return Grid(*axes)


def _cubes(
    shape: dict[str, Any], size_wh: tuple[int, int] | None, grid: "Grid", params: Parameters
) -> "SweepInput":
    """The cubes that the options ask for; clips are as high as the largest kernel needs."""
    from dlgmd_cli.lab.stimuli.cubes import SIDE_PX, SIZE_WH, SPEEDS_PX, cube_input

    speeds_px, size_wh = shape["speed"] or SPEEDS_PX, size_wh or SIZE_WH
    side_px = SIDE_PX if shape["cube_size"] is None else shape["cube_size"]
    radii = [axis.values[-1] for axis in (grid.x, grid.y) if axis.key == "r"]
    reach_px = max([*radii, getattr(params, "r", size_wh[1])])
    return cube_input(speeds_px, side_px, shape["frames"], size_wh, reach_px)
