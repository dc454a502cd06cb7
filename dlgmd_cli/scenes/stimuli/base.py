"""The base of all scenes: a name, checked options, frames, and their ground truth."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Generic, TypeVar

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.frame import GreyImage
from dlgmd_cli.parameters.checks import Spec

# The largest even side that MPEG-4 takes.
MAX_SIDE_PX = 8190
MAX_FRAMES = 100_000


def option(
    default: Any, flag: str, low: float = -math.inf, high: float = math.inf, **facts: Any
) -> Any:
    """A field of `ClipOptions`: its default, its flag, and what `Spec` takes.

    The default None leaves the choice to the scene.
    """
    spec = Spec(low=low, high=high, **facts)
    return field(default=default, metadata={"flag": flag, "spec": spec})


def invalid(flag: str, why: str, hint: str = "") -> ParameterError:
    """The error for the value of one option."""
    return ParameterError(f"Invalid value for '{flag}'", why, hint)


@dataclass(frozen=True)
class ClipOptions:
    """Options of every clip, checked on construction.

    `shape` is (height, width) in px. `n_frames` is the length; None leaves it to the scene.
    `fov_deg` is the horizontal field of view of a pinhole camera with square pixels. `seed`
    determines everything random.
    """

    shape: tuple[int, int] = option((270, 480), "--size", 16, MAX_SIDE_PX, unit="px", kind=int)
    fps: float = option(30.0, "--fps", 1, 600)
    n_frames: int | None = option(None, "--frames", 1, MAX_FRAMES, kind=int)
    fov_deg: float = option(60.0, "--fov", 1, 170, unit="degrees")
    seed: int = option(0, "--seed", 0, 2**63 - 1, kind=int)

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            flag, spec = each.metadata["flag"], each.metadata["spec"]
            is_tuple = isinstance(each.default, tuple)
            values = tuple(value) if isinstance(value, tuple | list) else (value,)
            if not is_tuple and len(values) != 1:
                raise invalid(flag, f"the scene takes one value, not {len(values)}")
            if values != (None,) or each.default is not None:
                try:
                    values = tuple(spec.check(number) for number in values)
                except ParameterError as error:
                    unit = "" if spec.unit == "–" else f" {spec.unit}"
                    raise invalid(flag, error.why, f"Choose {spec.allowed}{unit}.") from None
            object.__setattr__(self, each.name, values if is_tuple else values[0])
        if len(self.shape) != 2:
            raise invalid("--size", "it needs a height and a width")

    def to_dict(self) -> dict[str, Any]:
        """Option -> value for records; options are named by their flags without the dashes."""
        values = {each.metadata["flag"][2:]: getattr(self, each.name) for each in fields(self)}
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

    truth_type: type
    is_flight = False

    def __init__(self, name: str, description: str, defaults: OptionsT) -> None:
        self.name, self.description, self.defaults = name, description, defaults

    def configure(self, given: Mapping[str, Any]) -> OptionsT:
        """The defaults with some options replaced; `given` is keyed by flag, such as ``--speed``.

        Raises ParameterError if the scene has no such option, or cannot be rendered with these
        values.
        """
        names = {each.metadata["flag"]: each.name for each in fields(self.defaults)}
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
