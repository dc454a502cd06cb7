"""The film of a page: the input with the active cells of G tinted, as H.264."""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from dlgmd_cli.errors import SourceError, argument
from dlgmd_cli.frame import BgrImage
from dlgmd_cli.machine import cancel
from dlgmd_cli.parameters.keys import SPIKES, changed
from dlgmd_cli.parameters.presets import Config, runnable
from dlgmd_cli.plots.heat import mark_centroid, tinted
from dlgmd_cli.results.result import Result
from dlgmd_cli.tasks.call import OnFrame, Request, Setup
from dlgmd_cli.tasks.layers import LayerResult, run_layers
from dlgmd_cli.tasks.stepping import responses, session_on
from dlgmd_cli.video.input_options import InputOptions
from dlgmd_cli.video.opening import processed_size
from dlgmd_cli.video.source import Video
from dlgmd_cli.video.writer import PAGE_FILM, encoded_rate, playable_fps, video_writer

# Factor by which masked parts of the image are darkened.
_DIMMED = 3
# Tolerance between stored and recomputed MP: OpenCV differs between processors in the last digits.
_MP_TOLERANCE = 1e-3
# Greatest widths of the film and of the thumbnail.
_WIDTH_PX, _THUMBNAIL_PX = 480, 192


@dataclass(frozen=True)
class PageFilm:
    """A film with one image for every row of a result.

    Attributes
    ----------
    data : bytes
        The MP4 file.
    fps : float
        Frame rate.
    size_wh : (int, int)
        Width and height in px.
    thumbnail : bytes
        The requested image as JPEG.
    is_as_stored : bool
        Whether running the model again gave the membrane potential of the result.
    """

    data: bytes
    fps: float
    size_wh: tuple[int, int]
    thumbnail: bytes
    is_as_stored: bool


def render(
    result: Result,
    peers: Sequence[Result],
    path: str,
    thumbnail_row: int,
    on_frame: OnFrame,
) -> PageFilm:
    """Run a result's model over its input again, and make a film of the input with G on top.

    Parameters
    ----------
    result : Result
        The result; its record has the options by which the input was read.
    peers : sequence of Result
        The results of the same run, `result` included: they share a frame rate.
    path : str
        Current path of the input.
    thumbnail_row : int
        The row of the result for the thumbnail.
    on_frame : callable
        Called with the number of frames done, up to twice the number of the input's frames.

    Raises
    ------
    SourceError
        If the input cannot be decoded, or its frames differ from the result's frames.
    ParameterError
        If the options in the record are not valid, or the result's model may not be imported.
    Interrupted
        If the user asked to stop.
    """
    processed = result.record["processed"]
    options = replace(
        InputOptions.from_record(result.record.get("options") or {}),
        scale=None,
        size=(processed["width"], processed["height"]),
    )
    # The film shows no alarm: the rule may be of one's own, whose code is not started here.
    shown = replace(result, params=changed(runnable(result.params), alarm=SPIKES))
    # The peers only determine the frame rate.
    n_expected = int(result.record["input"].get("frames") or len(result))
    request = Request(tuple(map(_setup, (shown, *peers))), options)
    with request.open(path) as video:
        layers = run_layers(video, request, on_frame=on_frame)
    is_as_stored = _is_same(layers.result, result, path)

    def on_second(n_done: int) -> None:
        on_frame(n_expected + n_done)

    with request.open(path) as video, tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
        size_wh, fps = _film_size(*video.source_wh), playable_fps(video.rate_fps)
        file, thumbnail = Path(folder) / "film.mp4", b""
        writer = video_writer(
            file, size_wh[::-1], fps, codec="h264", is_colour=True, x264=PAGE_FILM
        )
        with writer as write:
            pictures = _pictures(video, request, layers, size_wh, on_second)
            for row, picture in zip(range(len(result)), pictures, strict=False):
                if row == thumbnail_row:
                    thumbnail = _jpeg(picture)
                write(picture)
                cancel.check()
        data = file.read_bytes()
    return PageFilm(data, float(encoded_rate(fps)), size_wh, thumbnail, is_as_stored)


def _pictures(
    video: Video, request: Request, layers: LayerResult, size_wh: tuple[int, int], on_frame: OnFrame
) -> Iterator[BgrImage]:
    """The images of a video at a size, with G of the first model and its centroid on top."""
    hidden, result = video.hidden(size_wh), layers.result
    strongest_g = max(abs(bound) for bound in layers.ranges["g"])
    session = session_on(video, [request.setup], request.options)
    steps = responses(
        video, session, layers=lambda frame: True, picture_wh=size_wh, on_frame=on_frame
    )
    for g_x, g_y, (frame, (response,)) in zip(result.g_x, result.g_y, steps, strict=False):
        picture = frame.picture
        assert picture is not None
        if hidden is not None:
            picture[hidden] //= _DIMMED
        shown = tinted(picture, None if response.layers is None else response.layers.g, strongest_g)
        mark_centroid(shown, g_x, g_y)
        yield shown


def _is_same(again: Result, result: Result, path: str) -> bool:
    """Whether two runs gave the same MP; raises Interrupted, or SourceError for other frames."""
    if cancel.requested():
        raise cancel.Interrupted
    n_rows = len(result)
    # A live recording's video has one image per row, but its numbers do not skip dropped frames.
    is_kept = "source" in result.record["input"]
    if len(again) < n_rows or not (is_kept or np.array_equal(again.frame[:n_rows], result.frame)):
        is_live = result.record["input"].get("decoder") == "live"
        hint = "Run again."
        if is_live:
            hint = f"Record with {argument('keep_video')}, or view it with {argument('no_film')}."
        raise SourceError(path, "its frames are not those of the result", hint)
    tolerance = _MP_TOLERANCE * float(np.nanmax(result.mp, initial=0.0))
    return np.allclose(
        again.mp[:n_rows], result.mp, rtol=_MP_TOLERANCE, atol=tolerance, equal_nan=True
    )


def _setup(result: Result) -> Setup:
    record = result.record
    config = Config(
        "",
        width_px=int(record.get("width_px", Config.width_px)),
        model_fps=record.get("model_fps", Config.model_fps),
    )
    return Setup(result.params, result.params.model, config=config)


def _film_size(width: int, height: int) -> tuple[int, int]:
    """Width and height of the film in px: even, and at most 1 px larger than the input."""
    scale = min(1.0, _WIDTH_PX / max(width, 1))
    return max(2, round(width * scale / 2) * 2), max(2, round(height * scale / 2) * 2)


def _jpeg(picture: BgrImage) -> bytes:
    size_wh = processed_size(picture.shape[1], picture.shape[0], width_px=_THUMBNAIL_PX)
    small = cv2.resize(picture, size_wh, interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()
