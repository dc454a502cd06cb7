"""Running a model for its layers, at selected frames or at all frames."""

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dlgmd_cli import cancel
from dlgmd_cli.frame import Frame
from dlgmd_cli.models.base import Model, Response
from dlgmd_cli.results.layers import FloatImage, LayerSheet
from dlgmd_cli.results.result import Result
from dlgmd_cli.results.rows import RowList
from dlgmd_cli.runs.run import (
    OnFrame,
    build_result,
    input_record,
    responses,
    silent,
    stepper_on,
)
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.video.options import InputOptions
from dlgmd_cli.video.source import Video

# Number of frames to choose, preferably with responses of at least this share of the peak.
N_CHOSEN, _RESPONDING = 5, 0.01
# So many frames after a part that shows nothing, a model responds to the picture that comes back.
_COMING_BACK = 5

# Lowest and highest value of a layer.
Range = tuple[float, float]


class LayerRun(NamedTuple):
    """A run of a model that kept layers.

    `result` has all processed frames; its record lists the `frames` of the sheet, and is `complete`
    unless the stop flag left out some of them. `sheet` has the layers of the requested frames; None
    if there are none. `ranges` holds the extremes of `s` and `g` over all frames, if the whole
    input was run.
    """

    result: Result
    sheet: LayerSheet | None
    ranges: dict[str, Range]
    model: Model


def run_layers(
    video: Video,
    setup: Setup,
    options: InputOptions,
    frames: Collection[int] = (),
    *,
    whole: bool = True,
    on_frame: OnFrame = silent,
) -> LayerRun:
    """Run a model until all of `frames` are processed or, if `whole`, to the end of the input.

    Raises Interrupted if the stop flag ended the run before the first requested frame.
    """
    stepper, rows = stepper_on(video, setup, options), RowList()
    kept: list[tuple[Frame, Response]] = []
    ranges = dict.fromkeys("sg", (math.inf, -math.inf))
    last = -1 if whole else max(frames)
    is_read = True

    def is_kept(frame: Frame) -> bool:
        return frame.index in frames and not frame.is_repeat

    steps = responses(video, [stepper], layers=lambda one: whole or is_kept(one), on_frame=on_frame)
    for frame, (response,) in steps:
        rows.append(frame, response)
        if is_kept(frame):
            kept.append((frame, response))
        if whole:
            _widen(ranges, response)
        elif frame.index >= last:
            is_read = False
            on_frame(frame.index + 1)
            break
    stopped = cancel.requested()
    if stopped and not kept:
        raise cancel.Interrupted
    size_wh = stepper.size_wh or video.size_wh
    facts = input_record(video, size_wh, rows.rows(), is_read=is_read and not stopped)
    result = build_result(
        *(setup, stepper, rows.rows(), options, facts),
        complete=not stopped or len(kept) == len(frames),
        frames=[one.index for one, _ in kept],
    )
    result.warnings.extend(video.progress.warnings)
    label = f"{video.info.name} · {setup.label}"
    sheet = _sheet(kept, stepper.model.layer_units, label) if kept else None
    return LayerRun(result, sheet, ranges, stepper.model)


def strongest_frames(
    result: Result,
    n_frames: int = N_CHOSEN,
    *,
    contact: int | None = None,
    blind_s: Sequence[tuple[float, float]] = (),
) -> tuple[int, ...]:
    """Numbers of the frames with the strongest responses, spread out, in order.

    Frames are chosen by decreasing response, skipping those near a chosen one. Frames after the
    `contact`, and those within or just after the times `blind_s`, in which nothing can be seen, are
    left out, unless there are no others. If there is no response, the frames are spread over all.
    """
    shown = np.ones(len(result), np.bool_)
    for begin_s, end_s in blind_s:
        blind = np.flatnonzero((result.time_s >= begin_s) & (result.time_s <= end_s))
        shown[blind.min(initial=len(result)) : blind.max(initial=-1) + 1 + _COMING_BACK] = False
    if contact is not None:
        shown &= result.frame <= contact
    if shown.any() and not shown.all():
        result = replace(result, rows=result.rows[shown])
    strength = np.where(result.is_repeat, 0.0, np.nan_to_num(result.mp))
    n_strong = np.count_nonzero(strength >= _RESPONDING * strength.max())
    n_candidates = min(max(int(n_strong), n_frames), np.count_nonzero(strength))
    rows = np.sort(np.argsort(-strength, kind="stable")[:n_candidates])
    if not rows.size:
        even = np.linspace(0, len(result) - 1, min(n_frames, len(result)))
        rows = np.unique(even.round().astype(int))
    gap = max(1, len(rows) // (2 * n_frames))
    chosen: list[int] = []
    for place in np.argsort(-strength[rows], kind="stable"):
        if len(chosen) < n_frames and all(abs(place - other) >= gap for other in chosen):
            chosen.append(int(place))
    return tuple(int(result.frame[rows[place]]) for place in sorted(chosen))


def absent(missing: list[int], video: Video, end_s: float | None) -> str:
    """Why requested frames are missing; empty if none is."""
    last_s, fps, n_frames = video.progress.last_time_s, video.info.fps, video.progress.n_decoded
    is_read = end_s is None or last_s + 1.5 / fps < end_s
    beyond = [frame for frame in missing if is_read and frame >= n_frames]
    dropped = [frame for frame in missing if frame not in beyond]
    lines = []
    if beyond:
        lines.append(f"{_named(beyond)} not in it; its last one is frame {n_frames - 1}")
    if dropped:
        lines.append(f"{_named(dropped)} left out by --start, --end or --fps, or repeated")
    return "; ".join(lines)


def _named(frames: list[int]) -> str:
    """`frame 3 is` or `frames 3, 5 are`."""
    numbers = ", ".join(str(frame) for frame in frames)
    return f"frame {numbers} is" if len(frames) == 1 else f"frames {numbers} are"


def _widen(ranges: dict[str, Range], response: Response) -> None:
    """Extend the ranges by the layers of one frame."""
    for name, (lowest, highest) in ranges.items():
        layer = getattr(response.layers, name)
        if layer is not None:
            ranges[name] = min(lowest, float(layer.min())), max(highest, float(layer.max()))


def _sheet(
    kept: list[tuple[Frame, Response]], units: tuple[str, str, str], label: str
) -> LayerSheet:
    """The sheet of the kept frames, at least one."""
    undefined = np.full(kept[0][0].grey.shape, np.nan, dtype=np.float32)

    def stack(name: str) -> FloatImage:
        layers = [getattr(response.layers, name) for _, response in kept]
        return np.stack([undefined if layer is None else layer for layer in layers])

    frames = [frame for frame, _ in kept]
    return LayerSheet(
        np.array([frame.index for frame in frames]),
        np.array([frame.time_s for frame in frames]),
        np.stack([frame.luminance for frame in frames]),
        *(stack("p"), stack("s"), stack("g"), units, label),
    )
