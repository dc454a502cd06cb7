"""The options of an input: their names, types and checks, for Python, records and commands.

This module does not import NumPy: the commands' help uses it and must be fast.
"""

import hashlib
import math
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dlgmd_cli.errors import ParameterError, argument, warn
from dlgmd_cli.machine.files import open_regular
from dlgmd_cli.parameters.checks import Spec, shown
from dlgmd_cli.parameters.facts import Value
from dlgmd_cli.parameters.presets import ANGLES
from dlgmd_cli.video.base import DECODERS, MAX_FPS, Crop, ImageOptions, parse_crop, parse_size

if TYPE_CHECKING:
    from dlgmd_cli.video.base import SourceInfo


# The numbers and words that options accept. None stands for the default.
SPECS = {
    "scale": Spec(low=0, high=1, low_open=True),
    "fps": Spec(low=0, high=100_000, low_open=True, choices=("all",)),
    "start": Spec(low=0, high=1e9),
    "end": Spec(low=0, high=1e9),
    "repeats": Spec(str, choices=("skip", "keep")),
    "input_fps": Spec(low=0, high=MAX_FPS, low_open=True),
    "bit_depth": Spec(int, low=8, high=16),
    "topic": Spec(str),
    "decoder": Spec(str, choices=DECODERS),
    "normalise": Spec(str, choices=("absolute", "sequence")),
    **ANGLES,
    "hashed": Spec(bool),
}


def parse_time(value: Any, name: str = "") -> float:
    """A time in seconds, from a number or a text: `00:01:30.250` -> 90.25."""
    if isinstance(value, str):
        clock = r"(?:(?:(\d+):)?([0-5]?\d):)?(\d+(?:\.\d*)?|\.\d+)"
        match = re.fullmatch(clock, value.strip(), re.ASCII)
        if match is None or (match[2] and float(match[3]) >= 60.0):
            why = f"{f'{name} = ' if name else ''}{shown(value)} is not a time"
            raise ParameterError("", why, "Write 12.5 or 00:01:30.250.")
        hours, minutes, seconds = (float(part or 0) for part in match.groups())
        value = hours * 3600 + minutes * 60 + seconds
    return float(SPECS["start"].check(value, name))


def _path(value: Any, name: str) -> str:
    """The absolute path of a file."""
    if not isinstance(value, str | os.PathLike):
        raise ParameterError("", f"{name} = {shown(value)} is not the name of a file")
    return os.path.abspath(value)


# Name -> check of a value, which returns the value as it is stored.
CHECKS: dict[str, Callable[[Any, str], Any]] = {
    **{name: spec.check for name, spec in SPECS.items()},
    "start": parse_time,
    "end": parse_time,
    "size": parse_size,
    "crop": parse_crop,
    "mask": _path,
    "heading": _path,
    "times": _path,
}


_TIMES_SUFFIX = ".times.csv"
# The options that name a file, whose hash is recorded, and the file in words.
_FILES = {"mask": "mask", "heading": "table of headings", "times": "table of times"}


@dataclass(frozen=True)
class InputOptions:
    """Which part of an input is read, and which normalised membrane potential is thresholded.

    None stands for the default. Most options are those of `open_video`; `fps` may also be `all`.
    `mask_sha256`, `heading_sha256` and `times_sha256` are always computed from the files; stored
    in run.yaml, they show whether the files have changed since. `hashed` is not recorded.

    Raises
    ------
    ParameterError
        If an option is not valid, or two options exclude each other.
    """

    scale: float | None = None
    size: tuple[int, int] | None = None
    fps: float | str | None = None
    start: float | None = None
    end: float | None = None
    crop: Crop | None = None
    mask: str | None = None
    mask_sha256: str | None = None
    repeats: str | None = None
    input_fps: float | None = None
    bit_depth: int | None = None
    topic: str | None = None
    decoder: str | None = None
    normalise: str | None = None
    fov: float | None = None
    camera_tilt: float | None = None
    heading: str | None = None
    heading_sha256: str | None = None
    times: str | None = None
    times_sha256: str | None = None
    hashed: bool | None = None

    def __post_init__(self) -> None:
        for name, check in CHECKS.items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, check(value, argument(name)))
        for name in _FILES:
            object.__setattr__(self, f"{name}_sha256", _digest(getattr(self, name)))
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
        for name, what in _FILES.items():
            before, now = record.get(f"{name}_sha256"), getattr(options, f"{name}_sha256")
            if origin and before and now not in (None, before):
                warn(f"{origin}: the {what} {getattr(options, name)} has changed since")
        return options

    def beside(self, path: str) -> "InputOptions":
        """The options with the table of times beside a video, ``NAME.times.csv``, if it exists."""
        video = Path(path)
        table = video.with_name((video.name if video.is_dir() else video.stem) + _TIMES_SUFFIX)
        if self.times is not None or not table.is_file():
            return self
        return replace(self, times=str(table), input_fps=None)

    @property
    def of_images(self) -> ImageOptions:
        """Options of `open_video` for what an input may not state, see `ImageOptions`."""
        return {
            "input_fps": self.input_fps,
            "times": self.times,
            "bit_depth": self.bit_depth,
            "topic": self.topic,
        }

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


# Name -> type of the options as arguments of a function.
INPUT_ARGUMENTS: dict[str, Any] = {
    **{option.name: option.type for option in fields(InputOptions) if option.name in CHECKS},
    **dict.fromkeys(("start", "end"), float | str | None),
    **dict.fromkeys(_FILES, str | os.PathLike[str] | None),
    "size": str | tuple[int, int] | None,
    "crop": str | tuple[int, int, int, int] | None,
}


def _digest(path: str | None) -> str | None:
    """The SHA-256 of a file; None if the file cannot be read: opening it reports the error."""
    if path is None:
        return None
    try:
        with open_regular(Path(path), "rb") as file:
            return hashlib.sha256(file.read()).hexdigest()
    except (OSError, ValueError):
        return None
