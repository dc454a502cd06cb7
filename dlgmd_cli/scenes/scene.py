"""A scene that `synth` renders: its options, its frames, and its ground truth."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import Field, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np

from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.frame import FloatImage, GreyImage
from dlgmd_cli.parameters.checks import Spec
from dlgmd_cli.scenes.shapes import Patch
from dlgmd_cli.video.base import Unreadable
from dlgmd_cli.video.images import read_image

# Longest even side of an MPEG-4 video, in px.
MAX_SIDE_PX = 8190
MAX_FRAMES = 100_000
DEFAULT_FRAMES = 75

SceneT = TypeVar("SceneT", bound="Scene")


def option(
    default: Any, name: str, low: float = -math.inf, high: float = math.inf, **facts: Any
) -> Any:
    """A field of a `Scene`: default, name of the argument, and the arguments of `Spec`.

    With the default None, the scene chooses the value.
    """
    spec = Spec(low=low, high=high, **facts)
    return field(default=default, metadata={"name": name, "spec": spec})


def invalid(name: str, why: str, hint: str = "") -> ParameterError:
    """The error for the value of one option."""
    return ParameterError("", why, hint, name)


class Truth(NamedTuple):
    """The ground truth of one frame of a scene."""

    frame: int
    time_s: float
    angular_size_deg: float
    angular_velocity_deg_s: float
    time_to_contact_s: float


class Angles(NamedTuple):
    """The angular size in degrees, its change in degrees/s, and the time to contact in s."""

    size_deg: float
    velocity_deg_s: float = 0.0
    contact_s: float = math.nan


@dataclass(frozen=True)
class Scene(ABC):
    """A stimulus that can be rendered; its options are checked on construction.

    `name` is the name on the command line and the stem of the scene's files, and `description` a
    line for the help. The other fields are options, except `backwards`: the same frames in reverse.

    `shape` is (height, width) in px. `n_asked` is the number of frames; if None, the scene chooses
    it. After the motion, the object is still for `hold_s`. `fov_deg` is the horizontal field of
    view of a pinhole camera with square pixels. `contrast` is the Weber contrast (object -
    background) / background; with `light`, the two luminances are exchanged. Luminances range from
    0 to 1, which is grey level 255. `background_image` is the name of an image that fills the
    frame; its mean is the background of the contrast. `noise` is the standard deviation of the
    luminance noise, added to each pixel before rounding to grey levels; `seed` determines the
    noise.

    Raises ParameterError if the scene cannot be rendered with these values.
    """

    name: str
    description: str
    backwards: bool = False
    shape: tuple[int, int] = option((270, 480), "size", 16, MAX_SIDE_PX, unit="px", kind=int)
    fps: float = option(30.0, "fps", 1, 600)
    n_asked: int | None = option(None, "frames", 1, MAX_FRAMES, kind=int)
    hold_s: float = option(0.0, "hold", 0, 1000, unit="s")
    fov_deg: float = option(60.0, "fov", 1, 170, unit="degrees")
    seed: int = option(0, "seed", 0, 2**63 - 1, kind=int)
    contrast: float = option(-0.75, "contrast", -1, 1000)
    light: bool = option(False, "light", kind=bool)
    background: float = option(0.8, "background", 0, 1, low_open=True)
    background_image: str | None = option(None, "background_image", kind=str)
    noise: float = option(0.0, "noise", 0, 1)

    def __post_init__(self) -> None:
        for name, each in self.options().items():
            value, spec = getattr(self, each.name), each.metadata["spec"]
            is_tuple = isinstance(each.default, tuple)
            values = tuple(value) if isinstance(value, tuple | list) else (value,)
            if not is_tuple and len(values) != 1:
                raise invalid(name, f"the scene takes one value, not {len(values)}")
            if values != (None,) or each.default is not None:
                try:
                    values = tuple(spec.check(number) for number in values)
                except ParameterError as error:
                    unit = "" if spec.unit == "–" else f" {spec.unit}"
                    raise invalid(name, error.why, f"Choose {spec.allowed}{unit}.") from None
            object.__setattr__(self, each.name, values if is_tuple else values[0])
        if len(self.shape) != 2:
            raise invalid("size", "it needs a height and a width")
        if self.light and self.background_image:
            why = f"excludes {argument('background_image')}"
            raise invalid("light", why, f"Give a positive {argument('contrast')}.")
        ground = self._background * (1.0 + self.contrast)
        if not 0.0 <= ground <= 1.0:
            why = f"{self.contrast:g} on a background of {self._background:g} makes the object"
            most = f"{1 / self._background - 1:.3g}"
            hint = f"Choose -1 to {most}, or a darker {argument('background')}."
            raise invalid("contrast", f"{why} brighter than white", hint)
        self.n_frames()

    @classmethod
    def options(cls) -> dict[str, Field[Any]]:
        """Name of the argument -> field."""
        return {each.metadata["name"]: each for each in fields(cls) if each.metadata}

    def configured(self: SceneT, given: Mapping[str, Any]) -> SceneT:
        """The scene with some options replaced, by name, such as ``{"speed": 2.0}``.

        Raises ParameterError if the scene lacks an option, or cannot be rendered with these
        values.
        """
        options = self.options()
        for name in given:
            if name not in options:
                hint = f"It takes {', '.join(map(argument, options))}."
                raise ParameterError(argument(name), f"{self.name} has no such option", hint)
        return replace(self, **{options[name].name: value for name, value in given.items()})

    @property
    def object_luminance(self) -> float:
        """Luminance of the object in 0..1."""
        return self._background if self.light else self._background * (1.0 + self.contrast)

    @cached_property
    def ground(self) -> FloatImage:
        """Luminance of the background in 0..1, shape (H, W)."""
        if self.background_image is not None:
            return _filling(self.background_image, self.shape)
        luminance = self.background * (1.0 + self.contrast) if self.light else self.background
        return np.full(self.shape, luminance, np.float32)

    @property
    def _background(self) -> float:
        """The luminance that the contrast is relative to."""
        return self.background if self.background_image is None else float(self.ground.mean())

    @property
    def focal_px(self) -> float:
        """Focal length of the camera, in px."""
        return self.shape[1] / 2 / math.tan(math.radians(self.fov_deg) / 2)

    @property
    def n_held(self) -> int:
        """Number of frames in which the object is still, after the motion."""
        return round(self.hold_s * self.fps)

    @property
    def n_moving_asked(self) -> int:
        """The number of frames of a motion that may last as long as the user wants."""
        return DEFAULT_FRAMES if self.n_asked is None else max(1, self.n_asked - self.n_held)

    def n_frames(self) -> int:
        """Number of frames; raises ParameterError if the scene cannot be rendered."""
        return min(self.n_moving() + self.n_held, self.n_asked or MAX_FRAMES)

    def place(self, index: int) -> int:
        """Which frame of the motion is frame `index`; the last one while the object is still."""
        if self.backwards:
            index = self.n_moving() + self.n_held - 1 - index
        return min(index, self.n_moving() - 1)

    @abstractmethod
    def n_moving(self) -> int:
        """Number of frames of the motion; raises ParameterError if there are too few or many."""

    @abstractmethod
    def patches(self, place: int) -> Iterable[Patch]:
        """The objects in one frame of the motion; the nearest object comes last."""

    @abstractmethod
    def angles(self, place: int) -> Angles:
        """What the object subtends in one frame of the motion; NaN where undefined."""

    def truth(self) -> Iterator[Truth]:
        """The ground truth of each frame; NaN where undefined."""
        n_moving, n_every = self.n_moving(), self.n_moving() + self.n_held
        for index in range(self.n_frames()):
            forward = n_every - 1 - index if self.backwards else index
            size, velocity, contact_s = self.angles(self.place(index))
            if forward >= n_moving:  # the object is still
                velocity, contact_s = 0.0, math.nan
            elif self.backwards:
                velocity, contact_s = -velocity, math.nan
            yield Truth(index, index / self.fps, size, velocity, contact_s)

    def frames(self) -> Iterator[GreyImage]:
        """The frames in order, (H, W) uint8; every call gives the same frames."""
        rng = np.random.default_rng(self.seed)
        for index in range(self.n_frames()):
            picture = self.ground.copy()
            for patch in self.patches(self.place(index)):
                patch.paint(picture, self.object_luminance)
            if self.noise > 0.0:
                picture += self.noise * rng.standard_normal(self.shape, np.float32)
            yield np.rint(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8)


def _filling(name: str, shape: tuple[int, int]) -> FloatImage:
    """The luminance of an image, cut to the proportions of the frame and resized, (H, W)."""
    try:
        image = read_image(Path(name))
    except Unreadable as error:
        raise invalid("background_image", f"{name}: {error}") from None
    levels = np.asarray(image, np.float32) / np.iinfo(image.dtype).max
    grey = levels if levels.ndim == 2 else cv2.cvtColor(levels, cv2.COLOR_BGR2GRAY)
    (height, width), (h, w) = grey.shape, shape
    scale = min(height / h, width / w)
    n_rows, n_columns = max(1, round(scale * h)), max(1, round(scale * w))
    top, left = (height - n_rows) // 2, (width - n_columns) // 2
    cut = grey[top : top + n_rows, left : left + n_columns]
    how = cv2.INTER_AREA if scale > 1.0 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(cut, (w, h), interpolation=how), np.float32)
