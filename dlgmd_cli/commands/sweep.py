"""`dlgmd sweep`: a model over a grid of two of its parameters."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands.console import (
    Command,
    end_if_interrupted,
    print_path,
    print_table,
    say,
    warn,
)
from dlgmd_cli.commands.options import (
    ONE_MODEL,
    Output,
    engine_option,
    input_options,
    option_group,
    output_options,
    width_option,
)
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters import Parameters, parse_overrides

if TYPE_CHECKING:
    from dlgmd_cli.results.sweep import Grid, SweepResult
    from dlgmd_cli.runs.run import Setup
    from dlgmd_cli.runs.sweep import Subject
    from dlgmd_cli.video.frames import Frame

SCENE = "translating-cubes"
DEFAULT_SPEEDS_PX, DEFAULT_SIDE_PX, DEFAULT_SIZE = (1.0, 2.0, 3.0, 4.0), 40.0, (200, 150)
MAX_FRAMES = 75
# The parameters of the paper's Fig. 11, without those that it varies.
FIG_11 = {"alpha": 0.0, "beta": 0.0, "lam": 0.0, "a": 1.5, "r": 4}
_AXIS_HELP = "A parameter and its values: KEY=FROM:TO:STEP, or KEY=VALUE,VALUE."
_INFINITE = "inf: no membrane potential within 5 frames of the false positive, none to mistake."

cube_options = option_group(
    "cubes",
    dict,
    click.option(
        "--speed",
        type=float,
        multiple=True,
        metavar="V",
        help="Without INPUT: speed of a cube in px/frame; repeatable.  [default: 1, 2, 3 and 4]",
    ),
    click.option(
        "--cube-size",
        "--object-size",
        "cube_size",
        type=float,
        metavar="S",
        help=f"Without INPUT: side of the cubes in px.  [default: {DEFAULT_SIDE_PX:g}]",
    ),
    click.option(
        "--frames",
        type=int,
        metavar="N",
        help="Without INPUT: length of each clip.  [default: as many frames as the fastest cube "
        f"is in sight, {MAX_FRAMES} at most]",
    ),
)


@click.command(
    cls=Command,
    epilog="Example: dlgmd sweep --x sigma_e=0.2:2.0:0.1 --y sigma_i=0.5:6:0.25",
)
@click.argument("input_path", metavar="[INPUT]", required=False)
@click.option("--x", metavar="AXIS", required=True, help=_AXIS_HELP)
@click.option("--y", metavar="AXIS", required=True, help="As --x.")
@cube_options
@click.option(
    "--false-positive-frame",
    type=click.IntRange(min=0),
    metavar="N",
    help="With INPUT: frame near which a response is a mistake, for distinguishability.",
)
@option_group("asked", dict, *ONE_MODEL, engine_option)
@input_options
@click.option(
    "--jobs",
    type=click.IntRange(1, 512),
    metavar="N",
    help="Processes that share the points.  [default: all processors]",
)
@width_option
@output_options
def sweep(
    input_path: str | None,
    x: str,
    y: str,
    cubes: dict[str, Any],
    false_positive_frame: int | None,
    asked: dict[str, Any],
    given: dict[str, Any],
    jobs: int | None,
    width: Any,
    output: Output,
) -> None:
    """Run the model with every pair of values of two parameters.

    Without INPUT, the model sees black cubes that cross a white picture, one clip per speed, and
    attenuation is measured, as in the paper's Fig. 11. The other parameters are then
    alpha = beta = lam = 0, a = 1.5, r = 4 and the defaults, unless --set or --config names others.

    With INPUT, as in 'dlgmd run', the peak membrane potential, the sharpness (the mean of the
    potential scaled to its peak), the distinguishability and the first alarm are measured. The
    other parameters are those of set 9, unless --set or --config names others.

    Writes OUT/sweep-NAME/ with sweep.csv, one row per grid point and speed, a figure, and
    sweep.yaml. Points are kept as they are done: after an interruption, the same command continues.
    """
    from dlgmd_cli.results import store
    from dlgmd_cli.runs.sweep import Sweep, engine_for
    from dlgmd_cli.threads import n_processors

    _refuse_others(input_path, cubes, {**given, "false_positive_frame": false_positive_frame})
    setup = _setup(asked, of_cubes=input_path is None)
    grid = _grid(x, y, type(setup.params), asked)
    with _subject(input_path, setup, cubes, given, false_positive_frame) as subject:
        folder = output.out / f"sweep-{store.fitting(subject.name)}"
        engine = engine_for(setup.params, setup.engine, subject.size_wh, say)
        swept = Sweep(folder, subject, grid, setup.params, setup.label, engine)
        done, n_points = swept.result.done, len(swept.points)
        with store.locked(folder):
            swept.resume(overwrite=output.overwrite)
            if done:
                say(f"{len(done)} of {n_points} points are already done.")
            try:
                swept.compute(jobs or n_processors(), tell=say, progress=progress)
            except Exception:
                if done:
                    say(
                        f"{folder} holds {len(done)} of {n_points} points; "
                        "the same command continues from there."
                    )
                raise
            if swept.fault is not None:
                n_left_out = f"{len(grid) - n_points} of {len(grid)}"
                warn(f"{n_left_out} points cannot be computed: {swept.fault.why}")
            for warning in swept.warnings:
                warn(f"{input_path or subject.name}: {warning}")
            swept.finish(_figures(swept.result, width, output.formats))
    print_table(("", "least", "at", "greatest", "at"), swept.result.extremes())
    if swept.result.has_infinite("distinguishability"):
        print_table(("",), [(_INFINITE,)])
    print_path(folder)
    end_if_interrupted(folder, len(done), complete=True)


def _refuse_others(input_path: str | None, cubes: dict[str, Any], of_input: dict[str, Any]) -> None:
    """Raise UsageError if an option is given that has no meaning with, or without, INPUT."""
    options, needed = (cubes, "without") if input_path else (of_input, "with an")
    for name, value in options.items():
        if value not in (None, ()) and name != "size":
            option = name.replace("_", "-")
            raise click.UsageError(f"--{option} works only {needed} INPUT. Leave it out.")


def _setup(asked: dict[str, Any], *, of_cubes: bool) -> "Setup":
    """The model that the options ask for; for cubes the paper's, if none is named."""
    from dlgmd_cli.runs.run import DEFAULT_MODEL, choose

    overrides = parse_overrides(asked["pairs"])
    origin = asked["set_name"], asked["config"]
    is_paper_s = of_cubes and origin == (None, None) and asked["model"] in (None, DEFAULT_MODEL)
    if is_paper_s:
        overrides = {**FIG_11, **overrides}
    setup = choose(*origin, asked["model"], overrides, asked["formulation"], asked["engine"])
    return replace(setup, label="fig11") if is_paper_s else setup


def _grid(x: str, y: str, kind: type[Parameters], asked: dict[str, Any]) -> "Grid":
    """Both axes; errors name whichever is at fault."""
    from dlgmd_cli.results.sweep import Axis, Grid

    axes = []
    for option, text in (("--x", x), ("--y", y)):
        try:
            axes.append(Axis.parse(text, kind))
        except ParameterError as error:
            raise ParameterError(f"Invalid value for '{option}'", error.why, error.mend) from None
        key = axes[-1].key
        if key in parse_overrides(asked["pairs"]):
            raise click.UsageError(f"--param sets {key}, which is an axis. Leave it out.")
        if key == "formulation" and asked["formulation"] is not None:
            raise click.UsageError("--formulation sets what is an axis. Leave it out.")
    return Grid(*axes)


@contextmanager
def _subject(
    input_path: str | None,
    setup: "Setup",
    cubes: dict[str, Any],
    given: dict[str, Any],
    false_positive_frame: int | None,
) -> "Iterator[Subject]":
    """What the models look at."""
    if input_path is None:
        yield _cubes(cubes, given["size"] or DEFAULT_SIZE)
        return
    from dlgmd_cli.runs import run as runs
    from dlgmd_cli.runs.sweep import video_subject

    options = runs.input_options(setup, given)
    with options.open(input_path) as video:
        yield video_subject(input_path, video, options, false_positive_frame)


def _cubes(asked: dict[str, Any], size_wh: tuple[int, int]) -> "Subject":
    """Black cubes over white, each alone in its clip."""
    from dlgmd_cli.runs.sweep import Subject
    from dlgmd_cli.stimuli.translating import Translation, TranslationOptions
    from dlgmd_cli.video.frames import Frame

    scene, (width, height) = Translation(SCENE, "", TranslationOptions()), size_wh
    speeds_px = tuple(dict.fromkeys(asked["speed"])) or DEFAULT_SPEEDS_PX
    side_px = DEFAULT_SIDE_PX if asked["cube_size"] is None else asked["cube_size"]
    flags: dict[str, Any] = {
        "--size": (height, width),
        "--object-size": side_px,
        "--contrast": -1.0,
        "--background": 1.0,
        "--frames": asked["frames"],
    }
    each = [scene.configure({**flags, "--speed": (speed,)}) for speed in speeds_px]
    n_frames = asked["frames"]
    if n_frames is None:
        n_frames = min(MAX_FRAMES, *map(scene.n_frames, each))
        # With an odd number, cubes at whole px/frame are at whole pixels.
        n_frames -= 1 - n_frames % 2
    each = [replace(options, n_frames=n_frames) for options in each]

    def clips(reach_px: int | None) -> "Iterator[Iterable[Frame]]":
        margin = height if reach_px is None else reach_px + 1
        first = max(0, int((height - side_px) / 2) - margin)
        rows = slice(first, height - first)
        for options in each:
            pictures = enumerate(scene.frames(options))
            yield (Frame(index, index / options.fps, one[rows]) for index, one in pictures)

    def too_short(n_given: int, label: str, n_needed: int) -> ParameterError:
        frames = f"{n_given} frame{'s' * (n_given > 1)}"
        why = f"{frames} of each cube, but {label} needs at least {n_needed}"
        return ParameterError("--frames", why, "Give more frames, slower cubes, or a wider --size.")

    record = {"side_px": side_px, "frames": n_frames, "width": width, "height": height}
    return Subject(
        name=SCENE,
        size_wh=size_wh,
        clips=clips,
        speeds_px=speeds_px,
        settings={"cubes": {"speeds_px": list(speeds_px), **record}},
        too_short=too_short,
    )


def _figures(result: "SweepResult", width: Any, formats: tuple[str, ...]) -> dict[str, Any]:
    """What writes the figure in each format, by its name."""
    if not formats:
        return {}
    from dlgmd_cli.plots.style import figure_files
    from dlgmd_cli.plots.sweeps import plot_sweep
    from dlgmd_cli.runs.sweep import FIGURE

    return figure_files({FIGURE: partial(plot_sweep, result, width)}, formats)
