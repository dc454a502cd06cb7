"""The options of an input, each declared once: for Python, records, files and the command line.

Nothing here needs NumPy, since the help of the commands is made of it.
"""

import hashlib
import math
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dlgmd_cli.errors import ParameterError, argument, warn
from dlgmd_cli.machine.files import open_regular
from dlgmd_cli.parameters.checks import Spec, shown
from dlgmd_cli.parameters.facts import Value
from dlgmd_cli.parameters.presets import ANGLES, DEFAULT_MODEL_FPS, DEFAULT_WIDTH_PX
from dlgmd_cli.video.base import DECODERS, Crop, ImageOptions, parse_crop, parse_size

if TYPE_CHECKING:
    from dlgmd_cli.video.base import SourceInfo


@dataclass(frozen=True)
class Text:
    """A value that has a text form, which `parse` reads: a size, or a rectangle."""

    kind: type
    parse: Callable[[str], Any]

    def check(self, value: Any, name: str = "") -> Any:
        """The value itself, or the one that a text states."""
        return value if isinstance(value, self.kind) else self.parse(value)


@dataclass(frozen=True)
class File:
    """The name of a file, kept as an absolute path."""

    what: str

    def check(self, value: Any, name: str = "") -> str:
        """The absolute path; raises ParameterError if the value is no path."""
        if not isinstance(value, str | os.PathLike):
            raise ParameterError("", f"{name} = {shown(value)} is not {self.what}")
        return os.path.abspath(value)


class Time(Spec):
    """A time in seconds, which a text may also state as HH:MM:SS.mmm."""

    def parse(self, text: str, name: str = "", *, bounded: bool = True) -> float:
        """`00:01:30.250` -> 90.25."""
        clock = r"(?:(?:(\d+):)?([0-5]?\d):)?(\d+(?:\.\d*)?|\.\d+)"
        match = re.fullmatch(clock, text.strip(), re.ASCII)
        if match is None or (match[2] and float(match[3]) >= 60.0):
            raise ParameterError("", f"{text!r} is not a time", "Write 12.5 or 00:01:30.250.")
        hours, minutes, seconds = (float(part or 0) for part in match.groups())
        time_s: float = self.check(hours * 3600 + minutes * 60 + seconds, name)
        return time_s


@dataclass(frozen=True)
class Declared:
    """How users give an option, as metadata of its field.

    `metavar` stands for the value in the help, whose section is `section`. Options that are not `common` are
    those of some commands only, and `live` has those that are `live`. `flags` are its names on the
    command line, that of the field unless given.
    """

    kind: Spec | Text | File
    help: str
    metavar: str | None = None
    section: str = "Input"
    common: bool = True
    live: bool = False
    flags: str = ""


def _option(kind: Spec | Text | File, text: str, metavar: str | None = None, **more: Any) -> Any:
    """The field of an option; None stands for its default."""
    return field(default=None, metadata={"option": Declared(kind, text, metavar, **more)})


def _angle(name: str, text: str) -> Any:
    """The field of an angle of the camera."""
    return _option(ANGLES[name], text, "DEG", section="Camera", live=True)


_RATE, _TIME = Spec(low=0, high=100_000, low_open=True), Time(low=0, high=1e9)


@dataclass(frozen=True)
class InputOptions:
    """Which part of an input is read, and which normalised membrane potential is thresholded.

    None stands for the default. Most options are those of `open_video`; `fps` may also be `all`.
    `mask_sha256` and `heading_sha256` are always computed from the files: stored in run.yaml, they
    show whether these have changed since. `hashed` is not recorded itself.

    Raises
    ------
    ParameterError
        If an option is not valid, or two options exclude each other.
    """

    scale: float | None = _option(
        Spec(low=0, high=1, low_open=True),
        "Scale frames by S, at most 1, before the model gets them.  [default: down to the width "
        f"that the model is made for, {DEFAULT_WIDTH_PX} px for the paper's sets]",
        "S",
        live=True,
    )
    size: tuple[int, int] | None = _option(
        Text(tuple, parse_size),
        "Scale frames to this size in px instead.",
        "WxH",
        live=True,
    )
    fps: float | str | None = _option(
        Spec(low=0, high=100_000, low_open=True, choices=("all",)),
        "Process at most F frames a second, by taking every k-th. Times stay true.  [default: the "
        f"model's model_fps, {DEFAULT_MODEL_FPS:g}, for videos; all for images. With several "
        "models, the highest model_fps is used for all.]",
        "F|all",
        live=True,
    )
    start: float | None = _option(_TIME, "Start here: seconds, or HH:MM:SS.mmm.", "TIME")
    end: float | None = _option(_TIME, "Stop before this time: seconds, or HH:MM:SS.mmm.", "TIME")
    crop: Crop | None = _option(  # noqa: RUF009, it cannot be changed
        Text(Crop, parse_crop),
        "Use only this part of the image; X and Y are its upper left corner in px.",
        "WxH+X+Y",
        live=True,
    )
    mask: str | None = _option(
        File("an image's file"),
        "Ignore what is black in this image. --crop cuts one of the input's size; any other is "
        "scaled to the crop, or to the input.",
        "FILE",
        live=True,
    )
    mask_sha256: str | None = None
    repeats: str | None = _option(
        Spec(str, choices=("skip", "keep")),
        "Whether duplicate frames are skipped.  [default: skip]",
        live=True,
    )
    input_fps: float | None = _option(
        _RATE,
        "Frame rate of images, or of a video that does not state one.  [default: 30]",
        "F",
    )
    bit_depth: int | None = _option(
        Spec(int, low=8, high=16),
        "Bits of the samples of images, arrays and bags of 16 bits, such as 12.  [default: 16]",
        "N",
    )
    topic: str | None = _option(
        Spec(str),
        "Topic of the images in a ROS bag or MCAP file; needed if there are several.",
        "NAME",
    )
    decoder: str | None = _option(
        Spec(str, choices=DECODERS),
        "Library that decodes videos; pyav needs dlgmd[fast]. Images are read by OpenCV, "
        "interlaced video by PyAV.  [default: opencv]",
    )
    normalise: str | None = _option(
        Spec(str, choices=("absolute", "sequence")),
        "Which normalised membrane potential (MP) the spikes follow: absolute (mp_abs), on a fixed "
        "scale; or sequence (mp_seq), the per-video min–max of the paper's figures, known only at "
        "the end.  [default: absolute]",
        section="Model",
    )
    fov: float | None = _angle(
        "fov",
        "Horizontal field of view of the camera's whole image, in degrees, 1 to 170.  [default: "
        "80; of a rendered flight, that of its record]",
    )
    camera_tilt: float | None = _angle(
        "camera_tilt",
        "Angle at which the camera is mounted on the drone, in degrees, upwards positive, -45 to "
        "45.  [default: 0; of a rendered flight, that of its record]",
    )
    heading: str | None = _option(
        File("a table's file"),
        "Table of where the drone flies to: frame,right_deg,up_deg, in degrees from the optical "
        "axis; between its frames, the directions are interpolated.  [default: 5 degrees above the "
        "axis of a level camera]",
        "FILE",
        section="Camera",
        common=False,
    )
    heading_sha256: str | None = None
    hashed: bool | None = _option(
        Spec(bool),
        "Whether the record has the SHA-256 of the input.  [default: of local files up to 2 GB, "
        "but not of arrays and raw video]",
        section="Output",
        common=False,
        flags="--hash/--no-hash",
    )

    def __post_init__(self) -> None:
        for name, option in DECLARED.items():
            if getattr(self, name) is not None:
                checked = option.kind.check(getattr(self, name), argument(name))
                object.__setattr__(self, name, checked)
        object.__setattr__(self, "mask_sha256", _digest(self.mask))
        object.__setattr__(self, "heading_sha256", _digest(self.heading))
        if self.scale is not None and self.size is not None:
            why = f"{argument('scale')} and {argument('size')} exclude each other"
            raise ParameterError("", why, "Give one of them.")
        if self.start is not None and self.end is not None and self.end <= self.start:
            start = f"{argument('start')} {self.start:g}"
            raise ParameterError("", f"{argument('end')} {self.end:g} is not after {start}")

    @classmethod
    def from_record(cls, record: Mapping[str, Any], origin: str = "") -> "InputOptions":
        """The options in a record; a ParameterError names `origin`. Warns of a changed file."""
        known = {option.name for option in fields(cls)}
        for key in record:
            if key not in known:
                raise ParameterError(origin, f"unknown option {shown(key)} under 'options'")
        try:
            options = cls(**record)
        except ParameterError as error:
            raise ParameterError(origin, f"options: {error.why}", error.hint) from None
        for name, what in {"mask": "mask", "heading": "table of headings"}.items():
            before, now = record.get(f"{name}_sha256"), getattr(options, f"{name}_sha256")
            if origin and before and now not in (None, before):
                warn(f"{origin}: the {what} {getattr(options, name)} has changed since")
        return options

    @property
    def of_images(self) -> ImageOptions:
        """The options of `open_video` without which images are not what they are."""
        return {"input_fps": self.input_fps, "bit_depth": self.bit_depth, "topic": self.topic}

    def n_expected(self, info: "SourceInfo") -> int | None:
        """Expected number of frames up to the requested end; None if the input states none."""
        if info.n_frames is None or self.end is None:
            return info.n_frames
        return min(info.n_frames, math.ceil(self.end * info.fps))

    def to_record(self) -> dict[str, Value]:
        """The options that are set, as a record stores them."""
        values = {key: value for key, value in vars(self).items() if value is not None}
        values.pop("hashed", None)
        if self.size is not None:
            values["size"] = "{}x{}".format(*self.size)
        if self.crop is not None:
            values["crop"] = str(self.crop)
        return values


# The options by the names of their fields.
DECLARED: dict[str, Declared] = {
    one.name: one.metadata["option"] for one in fields(InputOptions) if one.metadata
}


def _digest(path: str | None) -> str | None:
    """The SHA-256 of a file; None if it cannot be read, which is reported where it is."""
    if path is None:
        return None
    try:
        with open_regular(Path(path), "rb") as file:
            return hashlib.sha256(file.read()).hexdigest()
    except (OSError, ValueError):
        return None
