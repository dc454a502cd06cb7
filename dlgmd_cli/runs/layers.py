"""One input through one model for the sake of its layers, at chosen frames or at all of them."""

import math
from array import array
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dlgmd_cli import cancel
from dlgmd_cli.models.base import Model, Response
from dlgmd_cli.results.layers import FloatImage, LayerSheet
from dlgmd_cli.results.result import Result
from dlgmd_cli.runs.run import OnFrame, Setup, input_record
from dlgmd_cli.video.frames import Frame, InputOptions, Video
from dlgmd_cli.video.prefetch import opencv_threads, read_ahead


@dataclass(frozen=True)
class LayerPass:
    """What a pass gathers; a stop loses none of it.

    Attributes
    ----------
    result : Result
        The numbers of every frame that was processed. The record's `frames` are those of the
        sheet; `complete` says whether all of them were reached.
    sheet : LayerSheet or None
        The frames wanted, as far as they came; None if none did.
    ranges : dict of str to (float, float)
        For `s` and `g`, the extremes over all frames measured; infinite if there are none.
    label : str
        The input and the model, as figures call them.
    """

    result: Result
    sheet: LayerSheet | None
    ranges: dict[str, tuple[float, float]]
    label: str


def run_layers(
    video: Video,
    setup: Setup,
    model: Model,
    options: InputOptions,
    frames: Iterable[int],
    *,
    whole: bool,
    identity: Mapping[str, Any],
    on_frame: OnFrame,
) -> LayerPass:
    """Feed `video` to `model` until all frames wanted came, or to its end.

    Parameters
    ----------
    video : Video
        Where the frames come from. All before the last one wanted are processed, for the model
        lives on its history.
    setup, options, identity
        For the record, as `run.run_models` takes them.
    model : Model
        The one of `setup`.
    frames : iterable of int
        Numbers of the frames whose layers are kept.
    whole : bool
        Go on to the end, and measure the layers of every frame.
    on_frame : callable
        Called after each frame with the number of frames of the input that are done.

    Raises
    ------
    Interrupted
        If the stop flag ended it before there was anything to keep.
    """
    wanted = frozenset(frames)
    rows: array[float] = array("d")
    kept: list[tuple[Frame, Response]] = []
    ranges = dict.fromkeys("sg", (math.inf, -math.inf))

    def visit(frame: Frame, response: Response) -> bool:
        if frame.index in wanted:
            kept.append((frame, response))
        if whole:
            _widen(ranges, response)
        sums = (response.p_sum, response.s_sum, response.attenuation_db, response.mp)
        rows.extend((frame.index, frame.time_s, *sums))
        on_frame(frame.index + 1)
        return whole or frame.index < max(wanted)

    watch(video, model, visit, wanted=None if whole else wanted)
    stopped = cancel.requested()
    if stopped and not (rows if whole and not wanted else kept):
        raise cancel.Interrupted
    columns = np.array(rows).reshape(-1, 6).T.copy()
    frame, time_s, p_sum, s_sum, attenuation_db, mp = columns
    has_all = len(kept) == len(wanted)
    stops_early = stopped or (has_all and not whole)
    n_read = (int(frame[-1]) + 1, float(time_s[-1])) if stops_early else None
    record = {
        **input_record(video, video.size_wh, len(frame), identity, n_read),
        **setup.named,
        "model": setup.params.model,
        "engine": model.engine_name,
        **setup.params.to_dict(),
        "options": options.to_record(),
        "frames": [one.index for one, _ in kept],
        "warnings": list(video.progress.warnings),
        "complete": not stopped or (bool(wanted) and has_all),
    }
    result = Result(
        frame.astype(np.int64), time_s, mp, p_sum, s_sum, attenuation_db, setup.params, record
    )
    label = f"{video.info.name} · {setup.label}"
    sheet = _sheet(kept, model.layer_units, label) if kept else None
    return LayerPass(result, sheet, ranges, label)


def watch(
    video: Video,
    model: Model,
    visit: Callable[[Frame, Response], bool],
    wanted: Collection[int] | None = None,
) -> None:
    """Show every frame and the model's response to `visit`, while that is true and nobody stops it.

    Responses hold layers at the frames `wanted`; at all of them unless given.
    """
    model.reset()
    # The decoder has threads of its own; OpenCV's would only be in its way.
    with opencv_threads(1), read_ahead(video) as frames:
        for frame in frames:
            has_layers = wanted is None or frame.index in wanted
            response = model.step(frame.grey, frame.time_s, layers=has_layers)
            if not visit(frame, response) or cancel.requested():
                return


def absent(gathered: LayerPass, video: Video, wanted: Iterable[int], end_s: float | None) -> str:
    """Why frames that were asked for are not there; empty if all are."""
    missing = sorted(set(wanted) - set(gathered.result.record["frames"]))
    last_s, fps, n_frames = video.progress.last_time_s, video.info.fps, video.progress.n_decoded
    is_read = end_s is None or last_s + 1.5 / fps < end_s
    beyond = [frame for frame in missing if is_read and frame >= n_frames]
    dropped = [frame for frame in missing if frame not in beyond]
    lines = []
    if beyond:
        lines.append(f"{_named(beyond)} not in it; its last one is frame {n_frames - 1}")
    if dropped:
        lines.append(f"{_named(dropped)} left out by --start, --end or --fps")
    return "; ".join(lines)


def _named(frames: list[int]) -> str:
    """`frame 3 is` or `frames 3, 5 are`."""
    numbers = ", ".join(str(frame) for frame in frames)
    return f"frame {numbers} is" if len(frames) == 1 else f"frames {numbers} are"


def _widen(ranges: dict[str, tuple[float, float]], response: Response) -> None:
    """Take in the extremes of one frame's layers."""
    for name, (lowest, highest) in ranges.items():
        layer = getattr(response.layers, name)
        if layer is not None:
            ranges[name] = min(lowest, float(layer.min())), max(highest, float(layer.max()))


def _sheet(
    kept: list[tuple[Frame, Response]], units: tuple[str, str, str], label: str
) -> LayerSheet:
    """The sheet of the frames kept, at least one."""
    undefined = np.full(kept[0][0].grey.shape, np.nan, dtype=np.float32)

    def stack(name: str) -> FloatImage:
        layers = [getattr(response.layers, name) for _, response in kept]
        return np.stack([undefined if layer is None else layer for layer in layers])

    return LayerSheet(
        np.array([frame.index for frame, _ in kept], dtype=np.int64),
        np.array([frame.time_s for frame, _ in kept], dtype=np.float64),
        np.stack([frame.luminance for frame, _ in kept]),
        stack("p"),
        stack("s"),
        stack("g"),
        units,
        label,
    )
