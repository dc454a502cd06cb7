"""The options of an input: which part of it is read, and how."""

import hashlib
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import ParameterError, argument, warn
from dlgmd_cli.machine.files import open_regular
from dlgmd_cli.parameters.checks import shown
from dlgmd_cli.parameters.presets import DEFAULT_WIDTH_PX
from dlgmd_cli.video.base import (
    DEFAULT_DECODER,
    INPUT_SPECS,
    Crop,
    ImageOptions,
    parse_crop,
    parse_size,
)
from dlgmd_cli.video.opening import Openable, open_video
from dlgmd_cli.video.source import SourceInfo, Video


@dataclass(frozen=True)
class InputOptions:
    """Which part of an input is read, and which normalised membrane potential is thresholded.

    None stands for the default. Most options are those of `open_video`; `fps` may also be `all`,
    and `normalise` is `absolute` or `sequence`. `crop` may be given as text, and `mask` is stored
    as an absolute path. `mask_sha256` is always computed from the file: stored in run.yaml, it
    shows whether the mask has changed since. `fov` and `camera_tilt` are the camera's angles in
    degrees, and `heading` is a table of directions of flight, stored as the mask is. `measured_as`
    is only set by records of earlier versions: it names the one that the expansion is measured as.
    `hashed` says whether records have the SHA-256 of the input; it is not recorded itself.

    Raises
    ------
    ParameterError
        If an option is not valid, or two options exclude each other.
    """

    scale: float | None = None
    size: tuple[int, int] | None = None
    fps: float | str | None = None
    repeats: str | None = None
    input_fps: float | None = None
    bit_depth: int | None = None
    decoder: str | None = None
    start: float | None = None
    end: float | None = None
    crop: Crop | None = None
    mask: str | None = None
    mask_sha256: str | None = field(default=None, repr=False)
    normalise: str | None = None
    topic: str | None = None
    fov: float | None = None
    camera_tilt: float | None = None
    heading: str | None = None
    measured_as: str | None = field(default=None, repr=False)
    hashed: bool | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.size, tuple | None):
            object.__setattr__(self, "size", parse_size(self.size))
        if not isinstance(self.crop, Crop | None):
            object.__setattr__(self, "crop", parse_crop(self.crop))
        if isinstance(self.mask, str | os.PathLike):
            object.__setattr__(self, "mask", os.path.abspath(self.mask))
        if isinstance(self.heading, str | os.PathLike):
            object.__setattr__(self, "heading", os.path.abspath(self.heading))
        object.__setattr__(self, "mask_sha256", _digest(self.mask))
        for name, spec in INPUT_SPECS.items():
            if getattr(self, name) is not None:
                checked = spec.check(getattr(self, name), argument(name))
                object.__setattr__(self, name, checked)
        if not isinstance(self.mask, str | None):
            raise ParameterError(
                "", f"{argument('mask')} = {shown(self.mask)} is not an image's file"
            )
        if self.scale is not None and self.size is not None:
            why = f"{argument('scale')} and {argument('size')} exclude each other"
            raise ParameterError("", why, "Give one of them.")
        if self.start is not None and self.end is not None and self.end <= self.start:
            start = f"{argument('start')} {self.start:g}"
            raise ParameterError("", f"{argument('end')} {self.end:g} is not after {start}")

    @classmethod
    def from_record(cls, record: Mapping[str, Any], origin: str = "") -> "InputOptions":
        """The options in a record; a ParameterError names `origin`. Warns of a changed mask."""
        known = {option.name for option in fields(cls)}
        for key in record:
            if key not in known:
                raise ParameterError(origin, f"unknown option {shown(key)} under 'options'")
        try:
            options = cls(**record)
        except ParameterError as error:
            raise ParameterError(origin, f"options: {error.why}", error.hint) from None
        before = record.get("mask_sha256")
        if origin and before and options.mask_sha256 not in (None, before):
            warn(f"{origin}: the mask {options.mask} has changed since")
        return options

    @property
    def of_images(self) -> ImageOptions:
        """The options of `open_video` without which images are not what they are."""
        return {"input_fps": self.input_fps, "bit_depth": self.bit_depth, "topic": self.topic}

    def n_expected(self, info: SourceInfo) -> int | None:
        """Expected number of frames up to the requested end; None if the input states none."""
        if info.n_frames is None or self.end is None:
            return info.n_frames
        return min(info.n_frames, math.ceil(self.end * info.fps))

    def to_record(self) -> dict[str, Any]:
        """The options that are set, as a record stores them."""
        values = {key: value for key, value in vars(self).items() if value is not None}
        values.pop("measured_as", None)  # the record says so by not naming a camera
        values.pop("hashed", None)
        if self.size is not None:
            values["size"] = "{}x{}".format(*self.size)
        if self.crop is not None:
            values["crop"] = str(self.crop)
        return values

    def open(
        self, path: Openable, *, width_px: int = DEFAULT_WIDTH_PX, model_fps: float | None = None
    ) -> Video:
        """Open an input with these options; raises what `open_video` raises.

        `width_px` and `model_fps` apply where no option sets the size or the rate. Without
        `model_fps` every frame is processed by default, duplicates included.
        """
        return open_video(
            path,
            scale=self.scale,
            size_wh=self.size,
            width_px=width_px,
            start_s=self.start or 0.0,
            end_s=math.inf if self.end is None else self.end,
            max_fps=math.inf if self.fps == "all" else self.fps,  # type: ignore[arg-type]
            model_fps=model_fps,
            repeats=self.repeats or ("skip" if model_fps else "keep"),
            decoder=self.decoder or DEFAULT_DECODER,
            crop=self.crop,
            mask=self.mask,
            **self.of_images,
        )


def _digest(mask: Any) -> str | None:
    """The SHA-256 of a file; None if it cannot be read, which `open_video` reports."""
    try:
        with open_regular(Path(mask), "rb") as file:
            return hashlib.sha256(file.read()).hexdigest()
    except (OSError, TypeError, ValueError):
        return None
