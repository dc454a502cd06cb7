"""The base of all scenes: a name, checked options, frames, and their ground truth."""

import math
import numbers
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError

GreyImage = npt.NDArray[np.uint8]

# The largest even side that MPEG-4 takes.
MAX_SIDE_PX = 8190
MAX_FRAMES = 100_000


@dataclass(frozen=True)
class Limits:
    """The flag of an option, and its allowed values."""

    flag: str
    low: float
    high: float
    unit: str = ""
    low_open: bool = False
    whole: bool = False
    is_switch: bool = False

    def checked(self, value: Any) -> Any:
        """Return `value` as an int or a float; raises ParameterError if it is not allowed."""
        if self.is_switch:
            if isinstance(value, bool):
                return value
            raise invalid(self.flag, f"{str(value)[:40]} is neither true nor false")
        if isinstance(value, bool) or not isinstance(value, numbers.Real):
            raise invalid(self.flag, f"{str(value)[:40]} is not a number")
        if self.whole and not isinstance(value, numbers.Integral):
            raise invalid(self.flag, f"{str(value)[:40]} is not a whole number")
        number: Any = value
        if not self.low <= number <= self.high or (self.low_open and number == self.low):
            low = f"{'above ' if self.low_open else ''}{self.low:g}"
            raise invalid(
                self.flag,
                f"{str(value)[:40]} is out of range",
                f"Choose {low} to {self.high:g}{self.unit and ' ' + self.unit}.",
            )
        return int(number) if self.whole else float(number)


def option(default: Any, flag: str, low: float, high: float, **limits: Any) -> Any:
    """A numeric field of `ClipOptions`: its default, flag and range."""
    return field(default=default, metadata={"limits": Limits(flag, low, high, **limits)})


def switch(default: bool | None, flag: str) -> Any:
    """A boolean field of `ClipOptions`; None leaves the choice to the scene."""
    return field(default=default, metadata={"limits": Limits(flag, 0, 1, is_switch=True)})


def invalid(flag: str, why: str, mend: str = "") -> ParameterError:
    """The error for the value of one option."""
    return ParameterError(f"Invalid value for '{flag}'", why, mend)


@dataclass(frozen=True)
class ClipOptions:
    """Options of every clip, checked on construction.

    `shape` is (height, width) in px. `n_frames` is the length; None leaves it to the scene.
    `fov_deg` is the horizontal field of view of a pinhole camera with square pixels. `seed`
    determines everything random.
    """

    shape: tuple[int, int] = option((270, 480), "--size", 16, MAX_SIDE_PX, unit="px", whole=True)
    fps: float = option(30.0, "--fps", 1, 600)
    n_frames: int | None = option(None, "--frames", 1, MAX_FRAMES, whole=True)
    fov_deg: float = option(60.0, "--fov", 1, 170, unit="degrees")
    seed: int = option(0, "--seed", 0, 2**63 - 1, whole=True)

    def __post_init__(self) -> None:
        for each in fields(self):
            value, limits = getattr(self, each.name), each.metadata["limits"]
            if isinstance(each.default, tuple):
                values = value if isinstance(value, tuple | list) else (value,)
                object.__setattr__(self, each.name, tuple(limits.checked(v) for v in values))
                continue
            if isinstance(value, tuple):
                if len(value) != 1:
                    raise invalid(limits.flag, f"the scene takes one value, not {len(value)}")
                value = value[0]
            if value is not None or each.default is not None:
                object.__setattr__(self, each.name, limits.checked(value))
        if len(self.shape) != 2:
            raise invalid("--size", "it needs a height and a width")

    def to_dict(self) -> dict[str, Any]:
        """Option -> value for records; options are named by their flags without the dashes."""
        values = {
            each.metadata["limits"].flag[2:]: getattr(self, each.name) for each in fields(self)
        }
        height, width = self.shape
        return {**values, "size": f"{width}x{height}"}

    @property
    def focal_px(self) -> float:
        """Focal length of the camera, in px."""
        return self.shape[1] / 2 / math.tan(math.radians(self.fov_deg) / 2)


OptionsT = TypeVar("OptionsT", bound=ClipOptions)


class Scene(ABC, Generic[OptionsT]):
    """A stimulus that can be rendered.

    Attributes
    ----------
    name, description : str
        Name on the command line, also the stem of its files; and a line for `--list`.
    defaults : ClipOptions
        The options with their defaults.
    truth_type : type
        The dataclass of a frame's ground truth; its fields are the columns of the CSV.
    is_flight : bool
        Flights have a `record`, and a video that most players support. The videos of other scenes
        are the same on every machine.
    """

    name: str
    description: str
    defaults: OptionsT
    truth_type: type
    is_flight = False

    def configure(self, given: Mapping[str, Any]) -> OptionsT:
        """The defaults with some options replaced; `given` is keyed by flag, such as ``--speed``.

        Raises ParameterError if the scene has no such option, or cannot be rendered with these
        values.
        """
        names = {each.metadata["limits"].flag: each.name for each in fields(self.defaults)}
        for flag in given:
            if flag not in names:
                raise ParameterError(
                    flag, f"{self.name} has no such option", f"It takes {', '.join(names)}."
                )
        options = replace(self.defaults, **{names[flag]: value for flag, value in given.items()})
        self.n_frames(options)
        return options

    @abstractmethod
    def n_frames(self, options: OptionsT) -> int:
        """Number of frames; raises ParameterError if the scene cannot be rendered like that."""

    @abstractmethod
    def frames(self, options: OptionsT) -> Iterator[GreyImage]:
        """The frames in order, (H, W) uint8; every call gives the same."""

    @abstractmethod
    def truth(self, options: OptionsT) -> Iterator[Any]:
        """The ground truth of each frame, a `truth_type`; NaN where undefined."""

    def record(self, options: OptionsT) -> dict[str, Any]:
        """Properties of the whole clip, as YAML data."""
        return {}
