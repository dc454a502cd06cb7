"""The camera of an input: its angles, its part of the image, and the direction of flight."""

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from dlgmd_cli.errors import ParameterError, counted
from dlgmd_cli.machine.tables import TextTable, read_table
from dlgmd_cli.models.corridor import Motion
from dlgmd_cli.models.windows import Camera
from dlgmd_cli.parameters.facts import CameraFacts, InputFacts, RunFacts
from dlgmd_cli.results.record import read_record
from dlgmd_cli.results.result import Result
from dlgmd_cli.results.store import RUN
from dlgmd_cli.video.base import parse_crop
from dlgmd_cli.video.given_times import misfit
from dlgmd_cli.video.input_options import InputOptions

# Left, top, right and bottom edges, as shares of the sides of an image.
Shares = tuple[float, float, float, float]

# The direction of flight by frame; the rest of a `Motion`, which may be missing.
HEADING_COLUMNS = ("frame", "right_deg", "up_deg")
MOTION_COLUMNS = ("speed_m_s", "roll_deg", "pitch_deg", "yaw_deg")


def read_headings(path: str) -> Callable[[int], Motion]:
    """The motion at a frame, interpolated in a table.

    A number is unknown outside the table, where the table lacks it, and between two rows if either
    lacks it.

    Raises ParameterError if the file is not a table of headings.
    """
    table = _heading_table(path)
    frames = table.numbers("frame")
    columns = [table.numbers(name) for name in (*HEADING_COLUMNS[1:], *MOTION_COLUMNS)]
    # A yaw goes on beyond 180 degrees.
    yaw = columns[-1]
    known = np.isfinite(yaw)
    yaw[known] = np.unwrap(yaw[known], period=360.0)

    def motion(frame: int) -> Motion:
        if not frames[0] <= frame <= frames[-1]:
            return Motion()
        right, up, *others = (float(np.interp(frame, frames, numbers)) for numbers in columns)
        return Motion((right, up), *others)

    return motion


def has_motion(path: str) -> bool:
    """Whether a table of headings also has speeds and attitudes; raises as `read_headings`."""
    table = _heading_table(path)
    return all(np.isfinite(table.numbers(name)).any() for name in MOTION_COLUMNS)


def _heading_table(path: str) -> TextTable:
    """A table with the columns `HEADING_COLUMNS`; raises as `read_headings` does."""
    table = read_table(Path(path), ParameterError)
    table.require(*HEADING_COLUMNS, what="directions of flight")
    frames = table.numbers("frame")
    if not len(frames):
        raise ParameterError(str(path), "has no row", "Give the directions of flight by frame.")
    before = np.array([-math.inf, *frames[:-1]])
    for row in np.flatnonzero(~(np.isfinite(frames) & (frames > before))):
        hint = "Give a higher frame in each row."
        raise table.at(int(row), "frame", "is no frame after the one before", hint)
    for name in (*HEADING_COLUMNS[1:], *MOTION_COLUMNS):
        for row in np.flatnonzero(np.isinf(table.numbers(name))):
            raise table.at(int(row), name, "is no number", "Write degrees, or m/s.")
    return table


def headings_misfit(path: str, result: Result) -> str:
    """A warning if a table of headings does not fit the video of a result, or empty.

    One row may lie after the last frame: the last frames are interpolated between it and the row
    before.
    """
    n_frames = result.record["input"]["frames"] if result.complete else math.inf
    return misfit(_heading_table(path), n_frames, result.frame, result.time_s, spare=1)


def not_headed(
    path: str, camera: Camera, picture_wh: tuple[int, int], frames: Iterable[int]
) -> str:
    """A warning with the number of frames without a direction of their own; or empty.

    A drone that stands has none, nor has an attitude alone: these are no mistake.
    """
    motion_at, shape = read_headings(path), picture_wh[::-1]
    motions = [motion_at(int(frame)) for frame in frames]
    n_without = sum(
        camera.window(shape, one.direction) is None
        and not (one.has_attitude and math.isnan(sum(one.direction)) and not one.is_moving)
        for one in motions
    )
    if not n_without:
        return ""
    return (
        f"{path}: in {n_without} of {counted(len(motions), 'frame')}, it has no direction that the "
        "camera sees: the default holds there"
    )


def camera_of(
    options: InputOptions, picture_wh: tuple[int, int], path: str = ""
) -> tuple[Camera, RunFacts]:
    """The camera of an input whose images have this size, and the camera's entry in a record.

    Angles that the options do not give are assumed. For files that `live` recorded, the record
    beside the file says which part of the camera's image the file has.
    """
    usual, known_by = Camera(), "assumed" if options.fov is None else "option"
    fov = usual.fov_deg if options.fov is None else options.fov
    tilt = usual.tilt_deg if options.camera_tilt is None else options.camera_tilt
    part = _recorded_part(Path(path)) if path else usual.crop
    if options.crop is not None:
        part = _within(part, options.crop.shares(picture_wh))
    entry: CameraFacts = {"fov": float(fov), "camera_tilt": float(tilt), "known_by": known_by}
    return Camera(float(fov), float(tilt), part), {"camera": entry}


def _recorded_part(video: Path) -> Shares:
    """The part of a camera's image that a video or images of `live` have, by the record beside.

    As shares of the sides of the image; all of it for other inputs.
    """
    known = read_record(video.parent / RUN).get("input", InputFacts())
    is_cropped = {"source", "crop", "width", "height"} <= known.keys()
    if not is_cropped or Path(known.get("path", "")).name != video.name:
        return Camera().crop
    return parse_crop(known["crop"]).shares((known["width"], known["height"]))


def _within(outer: Shares, inner: Shares) -> Shares:
    """`inner`, a part of the part `outer` of an image, as shares of the sides of the image."""
    (left, top, right, bottom), (first_x, first_y, last_x, last_y) = outer, inner
    width, height = right - left, bottom - top
    return (
        left + first_x * width,
        top + first_y * height,
        left + last_x * width,
        top + last_y * height,
    )
