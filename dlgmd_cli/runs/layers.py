"""Running a model for its layers, at selected frames or at all frames."""

import math
from array import array
from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli import cancel
from dlgmd_cli.models.base import Model, Response
from dlgmd_cli.results.layers import FloatImage, LayerSheet
from dlgmd_cli.results.result import Result
from dlgmd_cli.runs.run import OnFrame, build_result, numbers_of
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.video.frames import Frame, Video
from dlgmd_cli.video.options import InputOptions
from dlgmd_cli.video.prefetch import opencv_threads, read_ahead

# Number of frames to choose, preferably with responses of at least this share of the peak.
N_CHOSEN, _RESPONDING = 5, 0.01

# Lowest and highest value of a layer.
Range = tuple[float, float]
BgrImage = npt.NDArray[np.uint8]


def run_layers(
    video: Video,
    setup: Setup,
    model: Model,
    options: InputOptions,
    frames: Collection[int],
    *,
    whole: bool,
    identity: Mapping[str, Any],
    on_frame: OnFrame,
) -> tuple[Result, LayerSheet | None, dict[str, Range]]:
    """Run `model` on `video` until all of `frames` are processed or, if `whole`, to the end.

    Returns the result, the sheet and the ranges. The result covers all processed frames; its record
    lists the `frames` of the sheet, and is `complete` unless the stop flag left out some of them.
    The sheet holds the layers of the requested frames, None if there are none. The ranges are the
    extremes of `s` and `g` over all frames if `whole`. Raises Interrupted if the stop flag ended
    the run before the first requested frame.
    """
    rows: array[float] = array("d")
    kept: list[tuple[Frame, Response]] = []
    ranges = dict.fromkeys("sg", (math.inf, -math.inf))
    repeated = bytearray()
    stops_early = False
    model.ignore(video.hidden())
    # OpenCV's threads would only compete with those of the decoder.
    with opencv_threads(1), read_ahead(video) as ahead:
        for frame in ahead:
            is_kept = frame.index in frames and not frame.is_repeat
            if not frame.is_repeat:
                if frame.after_gap:
                    model.reset()
                response = model.step(frame.grey, frame.time_s, layers=whole or is_kept)
            rows.extend((frame.index, frame.time_s, *numbers_of(response)))
            repeated.append(frame.is_repeat)
            if is_kept:
                kept.append((frame, response))
            if whole:
                _widen(ranges, response)
            on_frame(frame.index + 1)
            is_last = not whole and frame.index >= max(frames)
            stops_early = is_last or cancel.requested()
            if stops_early:
                break
    if cancel.requested() and not kept:
        raise cancel.Interrupted
    result = build_result(
        *(rows, repeated, video, video.size_wh, setup, model, options, identity),
        was_read=not stops_early,
        frames=[one.index for one, _ in kept],
        complete=not cancel.requested() or len(kept) == len(frames),
    )
    label = f"{video.info.name} · {setup.label}"
    return result, _sheet(kept, model.layer_units, label) if kept else None, ranges


def strongest_frames(result: Result, n_frames: int = N_CHOSEN) -> tuple[int, ...]:
    """Numbers of the frames with the strongest responses, spread out, in order.

    Frames are chosen by decreasing response, skipping those near a chosen one. If there is no
    response, they are spread over the whole result.
    """
    strength = np.where(result.repeated, 0.0, np.nan_to_num(result.mp))
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


def shown_frames(video: Video) -> Iterator[tuple[Frame, BgrImage]]:
    """Every frame as processed, and as a picture of full size, (H, W, 3) BGR."""
    for picture in video.pictures():
        image = picture.image
        if image.ndim == 2 or image.dtype != np.uint8:
            full = video.frame(picture, (image.shape[1], image.shape[0])).luminance
            grey = np.rint(255.0 * full).astype(np.uint8)
            yield video.frame(picture), np.repeat(grey[:, :, None], 3, axis=2)
        else:
            yield video.frame(picture), image.copy()  # the original is valid until the next one


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
