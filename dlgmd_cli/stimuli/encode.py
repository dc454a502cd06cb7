"""A scene as a video with its ground truth beside it; both appear whole or not at all."""

import csv
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import astuple, fields
from fractions import Fraction
from pathlib import Path

import cv2

from dlgmd_cli.errors import OutputError, SourceError
from dlgmd_cli.results.files import appearing, refuse_existing
from dlgmd_cli.results.tables import cell
from dlgmd_cli.sources.base import Verdict
from dlgmd_cli.sources.video import VideoReader
from dlgmd_cli.stimuli.base import (
    GreyImage,
    OptionsT,
    Scene,
    SceneOptions,
    Truth,
    invalid,
)

TRUTH_COLUMNS = tuple(field.name for field in fields(Truth))
# What MPEG-4 can count to within a second.
MAX_TICKS_PER_S = 65_535


def write_clip(
    scene: Scene[OptionsT],
    options: OptionsT,
    folder: Path,
    *,
    lossless: bool = False,
    overwrite: bool = False,
) -> tuple[Path, Path]:
    """Render a scene to ``folder/NAME.mp4`` and its ground truth to ``folder/NAME.csv``.

    Parameters
    ----------
    scene : Scene
        What to render.
    options : SceneOptions
        Options of that scene.
    folder : Path
        Where to; made if need be.
    lossless : bool
        Write ``NAME.avi`` in FFV1 instead, which keeps every grey level. MPEG-4 smooths noise.
    overwrite : bool
        Replace earlier files.

    Returns
    -------
    (Path, Path)
        The video and the truth.

    Raises
    ------
    ParameterError
        If the scene cannot be had with these options, or no video can hold it.
    OutputExistsError
        If a file stands there already and may not be replaced.
    OutputError
        If the files cannot be written.
    """
    n_frames = scene.n_frames(options)
    check_encodable(options, lossless=lossless)
    video = folder / f"{scene.name}{'.avi' if lossless else '.mp4'}"
    truth = folder / f"{scene.name}.csv"
    for path in (video, truth):
        refuse_existing(path, overwrite=overwrite)
    with appearing(video, truth) as (new_video, new_truth):
        encode(new_video, scene.frames(options), options.shape, options.fps, lossless=lossless)
        _verify(new_video, video, n_frames)
        write_truth(new_truth, scene.truth(options))
    return video, truth


def write_truth(path: Path, rows: Iterable[Truth]) -> None:
    """Write ground truth as CSV, an empty cell where nothing is defined; OSError passes through."""
    with path.open("w", newline="", encoding="ascii") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(TRUTH_COLUMNS)
        writer.writerows([cell(value) for value in astuple(row)] for row in rows)


def check_encodable(options: SceneOptions, *, lossless: bool) -> None:
    """Raise ParameterError if a video would not keep the size or the frame rate as they are."""
    height, width = options.shape
    if height % 2 or width % 2:  # OpenCV would cut off a row or a column, silently
        raise invalid(
            "--size",
            f"{width}x{height} is odd, and a video needs an even width and height",
            f"Choose {width + width % 2}x{height + height % 2}.",
        )
    rounded = round(options.fps, 3)
    if rounded != options.fps:
        raise invalid(
            "--fps",
            f"{options.fps!r} has more than three decimals, which a video file does not keep",
            f"Choose {rounded:g}.",
        )
    if not lossless and Fraction(str(rounded)).numerator > MAX_TICKS_PER_S:
        raise invalid(
            "--fps", f"MPEG-4 cannot hold {rounded:g}", "Choose fewer decimals, or --lossless."
        )


@contextmanager
def _openable(folder: Path) -> Iterator[Path]:
    """A name for `folder` that OpenCV can take: one that is not valid UTF-8 would crash it."""
    absolute = folder.absolute()  # else FFmpeg reads what stands before a colon as a protocol
    try:
        str(absolute).encode("utf-8")
    except UnicodeEncodeError:
        with tempfile.TemporaryDirectory(prefix="dlgmd-") as temporary:
            link = Path(temporary) / "out"
            link.symlink_to(absolute, target_is_directory=True)
            yield link
    else:
        yield absolute


def encode(
    path: Path,
    frames: Iterable[GreyImage],
    shape: tuple[int, int],
    fps: float,
    *,
    lossless: bool = False,
) -> None:
    """Encode frames as MPEG-4, or as FFV1, which keeps every grey level.

    What finds no room on the disk is missing in the file, without a word.

    Parameters
    ----------
    path : Path
        The video; its suffix says the container.
    frames : iterable of ndarray
        (H, W) uint8 each.
    shape : (int, int)
        H and W, both even.
    fps : float
        Frames per second.
    lossless : bool
        FFV1 instead of MPEG-4.

    Raises
    ------
    OSError
        If the file cannot be written at all.
    """
    height, width = shape
    codec = cv2.VideoWriter.fourcc(*("FFV1" if lossless else "mp4v"))
    path.touch()  # if this cannot be done, it says why; OpenCV would not
    with _openable(path.parent) as folder:
        # Grey frames go in as they are (the last argument): FFV1 is exact only so.
        writer = cv2.VideoWriter(
            str(folder / path.name), cv2.CAP_FFMPEG, codec, fps, (width, height), False
        )
        try:
            if not writer.isOpened():
                raise OSError("the encoder does not start")
            for frame in frames:
                writer.write(frame)
        finally:
            writer.release()


def count_frames(path: Path) -> int:
    """How many frames a video holds: decoded, for a full disk leaves fewer without a word."""
    with suppress(SourceError):
        reader = VideoReader(path)
        try:
            for _ in reader.pictures(lambda time_s: Verdict.SKIP):
                pass
        finally:
            reader.close()
        return reader.progress.n_decoded
    return 0


def _verify(path: Path, target: Path, n_frames: int) -> None:
    """Decode what was written; raise OutputError unless every frame is there."""
    n_written = count_frames(path)
    if n_written != n_frames:
        raise OutputError(
            str(target),
            f"only {n_written} of {n_frames} frames arrived on the disk",
            "Free some space, or choose another --out.",
        )
