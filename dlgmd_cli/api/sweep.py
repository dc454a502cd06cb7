"""A model over a grid of two of its parameters."""

import logging
import os
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

from dlgmd_cli.checks import blame
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.lab.stimuli.cubes import FIG_11, SIDE_PX, SIZE_WH, SPEEDS_PX, cube_input
from dlgmd_cli.parameters import Parameters
from dlgmd_cli.results import store
from dlgmd_cli.results.sweep import Axis, Grid, SweepResult
from dlgmd_cli.runs.run import Progress, given_options, no_progress, open_input
from dlgmd_cli.runs.setup import DLGMD, ModelName, Setup, choose, input_options
from dlgmd_cli.runs.sweep import FIGURE, Sweep, SweepInput, video_input
from dlgmd_cli.threads import n_processors
from dlgmd_cli.video.opening import Openable

_log = logging.getLogger(__name__)

AxisText = str | tuple[str, Iterable[Any]]


def sweep(
    video: Openable | None = None,
    *,
    x: AxisText,
    y: AxisText,
    speed: Iterable[float] = (),
    cube_size: float | None = None,
    frames: int | None = None,
    false_positive_frame: int | None = None,
    set: str | int | None = None,
    config: str | os.PathLike[str] | None = None,
    model: ModelName | None = None,
    formulation: str | None = None,
    param: Mapping[str, Any] | None = None,
    engine: str | None = None,
    jobs: int | None = None,
    out: str | os.PathLike[str] | None = None,
    formats: Iterable[str] = (),
    dpi: int = 200,
    width: Literal["one", "two"] = "one",
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> SweepResult:
    """Run a model over a grid of values of two parameters, as `dlgmd sweep` does.

    Parameters
    ----------
    video : str, path, or iterable of ndarray, optional
        The input, as in `run`, of which responses are measured. Without it, black cubes cross a
        white picture, one clip per speed, and the attenuation is measured ([Zhao2023] Fig. 11).
    x, y : str, or (str, iterable)
        A parameter and its values: ``"sigma_e=0.2:2:0.1"``, ``"r=2,4,6"`` or ``("r", [2, 4, 6])``.
    speed, cube_size, frames : optional
        Of the cubes: speeds in px/frame (1, 2, 3 and 4), side in px (40), frames per clip.
    false_positive_frame : int, optional
        Frame of a false alarm in `video`, to measure the distinguishability.
    set, config, model, formulation, param, engine
        The model, as in `run`; for cubes, the default is that of Fig. 11.
    jobs, progress
        As in `batch`.
    out : str or path, optional
        Write into ``out/sweep-NAME``, as `dlgmd sweep` does with `formats`, `dpi`, `width` and
        `overwrite`; the same call continues an interrupted sweep.
    options
        Options of the input, as in `run`; of cubes, only `size`.

    Returns
    -------
    SweepResult
        `columns` has each measure, shape (clips, values of y, values of x); `table` is a structured
        array with the columns of sweep.csv; `plot` draws.

    Raises
    ------
    ParameterError
        If an axis, a parameter or an option is not valid.
    SourceError, OutputError, OutputExistsError, MissingExtraError, WorkerError
        As in `run` and `batch`.

    Examples
    --------
    >>> found = sweep(x="sigma_e=0.2:2:0.2", y="sigma_i=1:6:1")  # doctest: +SKIP
    >>> found.columns["attenuation_db"].shape  # doctest: +SKIP
    (4, 6, 10)
    """
    cubes = {"speed": tuple(speed), "cube_size": cube_size, "frames": frames}
    _refuse_others(video, cubes, {**options, "false_positive_frame": false_positive_frame})
    setup = _setup(set, config, model, param, formulation, engine, sees_cubes=video is None)
    grid = _grid(x, y, type(setup.params), param or {}, formulation)
    with ExitStack() as opened:
        if video is None:
            size_wh = input_options(setup, options).size
            subject = _cubes(cubes, size_wh, grid, setup.params)
        else:
            shared = input_options(setup, given_options(video, options))
            source = opened.enter_context(open_input(video, [setup], shared))
            subject = video_input(source.info.given, source, shared, false_positive_frame)
        place = Path(opened.enter_context(TemporaryDirectory()) if out is None else out)
        folder = place / f"sweep-{store.fitting(subject.name)}"
        swept = Sweep(folder, subject, grid, setup)
        opened.enter_context(store.locked(folder))
        swept.resume(overwrite=overwrite)
        _compute(swept, jobs or n_processors(), progress)
        if out is not None:
            figures = {}
            if formats := tuple(dict.fromkeys(formats)):
                from dlgmd_cli.plots.style import figure_files

                draw = partial(swept.result.plot, width)
                figures = figure_files({FIGURE: draw}, formats, dpi)
            store.log_undrawn(folder, swept.finish(figures))
    return swept.result


def _refuse_others(
    video: Openable | None, of_cubes: dict[str, Any], of_video: dict[str, Any]
) -> None:
    """Raise if an option is given that does not work with, or without, a video."""
    options, needed = (of_video, "with an") if video is None else (of_cubes, "without")
    for name, value in options.items():
        if value not in (None, ()) and name != "size":
            why = f"--{name.replace('_', '-')} works only {needed} INPUT"
            raise ParameterError("", why, "Leave it out.")


def _setup(
    set: str | int | None,
    config: str | os.PathLike[str] | None,
    model: ModelName | None,
    param: Mapping[str, Any] | None,
    formulation: str | None,
    engine: str | None,
    *,
    sees_cubes: bool,
) -> Setup:
    """The model that is asked for; for cubes, by default that of the paper's Fig. 11."""
    is_fig11 = sees_cubes and set is None and config is None and model in (None, DLGMD)
    if is_fig11:
        model, param = DLGMD, {**FIG_11, **(param or {})}
    setup = choose(set, config, model, param, formulation, engine)
    return replace(setup, label="fig11") if is_fig11 else setup


def _grid(
    x: AxisText,
    y: AxisText,
    kind: type[Parameters],
    param: Mapping[str, Any],
    formulation: str | None,
) -> Grid:
    """The grid of both axes; errors name the option of the axis."""
    axes = []
    for option, axis in (("--x", x), ("--y", y)):
        text = axis if isinstance(axis, str) else f"{axis[0]}={','.join(map(str, axis[1]))}"
        with blame(f"Invalid value for '{option}'"):
            axes.append(Axis.parse(text, kind))
        key = axes[-1].key
        if key in param:
            raise ParameterError("", f"--param sets {key}, which is an axis", "Leave it out.")
        if key == "formulation" and formulation is not None:
            raise ParameterError("", "--formulation is an axis of the sweep", "Leave it out.")
    return Grid(*axes)


def _cubes(
    asked: dict[str, Any], size_wh: tuple[int, int] | None, grid: Grid, params: Parameters
) -> SweepInput:
    """The cubes that are asked for; clips are as high as the largest kernel needs."""
    speeds_px, size_wh = asked["speed"] or SPEEDS_PX, size_wh or SIZE_WH
    side_px = SIDE_PX if asked["cube_size"] is None else asked["cube_size"]
    radii = [axis.values[-1] for axis in (grid.x, grid.y) if axis.key == "r"]
    reach_px = max([*radii, getattr(params, "r", size_wh[1])])
    return cube_input(speeds_px, side_px, asked["frames"], size_wh, reach_px)


def _compute(swept: Sweep, n_jobs: int, progress: Progress) -> None:
    """Compute the missing points; log how many were done before, and warnings at the end."""
    done, n_points, n_grid = swept.result.done, len(swept.points), len(swept.grid)
    if done:
        _log.info("%d of %d points are already done.", len(done), n_points)
    try:
        swept.compute(n_jobs, progress=progress)
    except Exception:
        if done:
            _log.info(
                "%s holds %d of %d points; the same command continues from there.",
                *(swept.folder, len(done), n_points),
            )
        raise
    if swept.fault is not None:
        left_out = f"{n_grid - n_points} of {n_grid} points"
        _log.warning("%s cannot be computed: %s", left_out, swept.fault.why)
    for warning in swept.result.warnings:
        _log.warning("%s: %s", swept.subject.path or swept.subject.name, warning)
