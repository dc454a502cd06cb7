"""Scenes that `synth` renders: plain objects on a plain background, with their ground truth.

Edges are antialiased by exact pixel coverage.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import Field, dataclass, field, fields, replace
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.frame import FloatArray, FloatImage, Frame, GreyImage
from dlgmd_cli.parameters.checks import Spec, did_you_mean
from dlgmd_cli.parameters.facts import Json

# Longest even side of an MPEG-4 video, in px.
MAX_SIDE_PX = 8190
MAX_FRAMES = 100_000
MIN_METRES, MAX_METRES = 0.001, 10_000
_DEFAULT_FRAMES = 75
_N_TEST_FRAMES = 20

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


@dataclass(frozen=True)
class Scene(ABC):
    """A stimulus that can be rendered; its options are checked on construction.

    `name` is the name on the command line and the stem of the scene's files, and `description` a
    line for the help. The other fields are options.

    `shape` is (height, width) in px. `n_asked` is the number of frames; if None, the scene chooses
    it. `fov_deg` is the horizontal field of view of a pinhole camera with square pixels. `contrast`
    is the Weber contrast (object - background) / background. Luminances range from 0 to 1, which is
    grey level 255. `noise` is the standard deviation of the luminance noise, added to each pixel
    before rounding to grey levels; `seed` determines the noise.

    Raises ParameterError if the scene cannot be rendered with these values.
    """

    name: str
    description: str
    shape: tuple[int, int] = option((270, 480), "size", 16, MAX_SIDE_PX, unit="px", kind=int)
    fps: float = option(30.0, "fps", 1, 600)
    n_asked: int | None = option(None, "frames", 1, MAX_FRAMES, kind=int)
    fov_deg: float = option(60.0, "fov", 1, 170, unit="degrees")
    seed: int = option(0, "seed", 0, 2**63 - 1, kind=int)
    contrast: float = option(-0.75, "contrast", -1, 1000)
    background: float = option(0.8, "background", 0, 1, low_open=True)
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
        if not 0.0 <= self.object_luminance <= 1.0:
            ground = f"a background of {self.background:g}"
            why = f"{self.contrast:g} on {ground} makes the object brighter than white"
            most = f"{1 / self.background - 1:.3g}"
            hint = f"Choose -1 to {most}, or a darker {argument('background')}."
            raise invalid("contrast", why, hint)
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
        return self.background * (1.0 + self.contrast)

    @property
    def focal_px(self) -> float:
        """Focal length of the camera, in px."""
        return self.shape[1] / 2 / math.tan(math.radians(self.fov_deg) / 2)

    @abstractmethod
    def n_frames(self) -> int:
        """Number of frames; raises ParameterError if the scene cannot be rendered."""

    @abstractmethod
    def patches(self, index: int) -> Iterable["Patch"]:
        """The objects in one frame; the nearest object comes last."""

    @abstractmethod
    def truth(self) -> Iterator[Truth]:
        """The ground truth of each frame; NaN where undefined."""

    def frames(self) -> Iterator[GreyImage]:
        """The frames in order, (H, W) uint8; every call gives the same frames."""
        rng = np.random.default_rng(self.seed)
        for index in range(self.n_frames()):
            picture: FloatImage = np.full(self.shape, self.background, np.float32)
            for patch in self.patches(index):
                patch.paint(picture, self.object_luminance)
            if self.noise > 0.0:
                picture += self.noise * rng.standard_normal(self.shape, np.float32)
            yield np.rint(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8)


@dataclass(frozen=True)
class Patch:
    """A shape in an image: `coverage`, 0..1, of the pixels in `rows` and `columns`."""

    rows: slice
    columns: slice
    coverage: FloatArray

    def paint(self, picture: FloatImage, luminance: float) -> None:
        """Blend `luminance` into `picture`, (H, W), by coverage, in place."""
        below = picture[self.rows, self.columns]
        below += self.coverage * (luminance - below)


def rectangle(
    shape: tuple[int, int], center_yx: tuple[float, float], size_yx: tuple[float, float]
) -> Patch:
    """Exact coverage of an upright rectangle, possibly far larger than the image.

    Coordinates are in px with y down; pixel (0, 0) extends from 0 to 1.
    """
    rows, y = _pixel_edges(center_yx[0], size_yx[0] / 2, shape[0])
    columns, x = _pixel_edges(center_yx[1], size_yx[1] / 2, shape[1])
    inside_y = np.diff(np.clip(y, -size_yx[0] / 2, size_yx[0] / 2))
    inside_x = np.diff(np.clip(x, -size_yx[1] / 2, size_yx[1] / 2))
    return Patch(rows, columns, np.outer(inside_y, inside_x))


def disc(shape: tuple[int, int], center_yx: tuple[float, float], radius_px: float) -> Patch:
    """Coverage of a disc, exact up to rounding (1e-3 at a radius of a million px).

    The disc may be far larger than the image; coordinates are as in `rectangle`.
    """
    rows, y = _pixel_edges(center_yx[0], radius_px, shape[0])
    columns, x = _pixel_edges(center_yx[1], radius_px, shape[1])
    # Squared distances from the centre to the nearest and the farthest point of each pixel.
    near_y, near_x = (np.clip(0.0, each[:-1], each[1:]) ** 2 for each in (y, x))
    far_y, far_x = (np.maximum(-each[:-1], each[1:]) ** 2 for each in (y, x))
    square = radius_px * radius_px  # `**` would raise OverflowError
    covered = far_y[:, None] + far_x <= square
    coverage = covered.astype(np.float64)
    # Only pixels on the circle itself need the integral.
    i, j = np.nonzero(~covered & (near_y[:, None] + near_x < square))
    area = (
        _area_from_center(y[i + 1], x[j + 1], radius_px)
        - _area_from_center(y[i], x[j + 1], radius_px)
        - _area_from_center(y[i + 1], x[j], radius_px)
        + _area_from_center(y[i], x[j], radius_px)
    )
    coverage[i, j] = np.clip(area, 0.0, 1.0)
    return Patch(rows, columns, coverage)


def _pixel_edges(center: float, reach: float, n_pixels: int) -> tuple[slice, FloatArray]:
    """The pixels within center ± reach, and the positions of their edges relative to `center`."""
    low, high = (
        int(np.clip(edge, 0, n_pixels))
        for edge in (np.floor(center - reach), np.ceil(center + reach))
    )
    high = max(low, high)
    edges: FloatArray = np.arange(low, high + 1, dtype=np.float64) - center
    return slice(low, high), edges


def _area_from_center(y: FloatArray, x: FloatArray, radius: float) -> FloatArray:
    """Signed area of the part of the disc inside the rectangle from its centre to (y, x).

    The rectangle counts in full up to its intersection with the circle. Beyond that, the area under
    the circle counts.
    """
    height, width = np.minimum(np.abs(y), radius), np.minimum(np.abs(x), radius)
    cut = np.sqrt(radius * radius - width**2)
    under_circle = _area_under_circle(np.maximum(height, cut), radius)
    area = width * np.minimum(height, cut) + under_circle - _area_under_circle(cut, radius)
    return np.sign(y) * np.sign(x) * area


def _area_under_circle(t: FloatArray, radius: float) -> FloatArray:
    """Integral of sqrt(radius² - s²) over s from 0 to t."""
    square = radius * radius
    return (t * np.sqrt(square - t**2) + square * np.arcsin(t / radius)) / 2


@dataclass(frozen=True)
class Approach(Scene):
    """A "cube" or a "ball" that moves along the optical axis at constant speed.

    The size is the side of the cube or the diameter of the ball, in m. The distance, in m, is from
    the camera to the nearest point of the object at frame 0.
    """

    object_size_m: float = option(0.5, "object_size", MIN_METRES, MAX_METRES, unit="m")
    speed_m_s: float = option(3.0, "speed", MIN_METRES, MAX_METRES, unit="m/s")
    distance_m: float = option(7.5, "distance", MIN_METRES, MAX_METRES, unit="m")
    solid: Literal["cube", "ball"] = "cube"
    recedes: bool = False

    def n_frames(self) -> int:
        """Number of frames: the option, else all before contact, or 75 if the object recedes."""
        if self.recedes:
            return self.n_asked or _DEFAULT_FRAMES
        # The frame of contact itself does not count; 1e-6 is a margin for rounding.
        n_before = max(1, math.ceil(self.distance_m / self.speed_m_s * self.fps - 1e-6))
        if self.n_asked is None and n_before > MAX_FRAMES:
            why = f"contact comes only after {n_before} frames, and a clip has {MAX_FRAMES} at most"
            raise invalid(
                "speed", why, f"Raise it, or end the clip earlier with {argument('frames')}."
            )
        if self.n_asked is not None and self.n_asked > n_before:
            hint = f"Choose 1 to {n_before}, or start at a larger {argument('distance')}."
            raise invalid("frames", f"contact comes after {n_before} frames", hint)
        return self.n_asked or n_before

    def patches(self, index: int) -> Iterator[Patch]:
        """The object, about the middle of the image."""
        height, width = self.shape
        middle_yx = height / 2.0, width / 2.0
        _, outline_m = self._distances(index)
        span_px = self.focal_px * self.object_size_m / outline_m
        if self.solid == "cube":
            yield rectangle(self.shape, middle_yx, (span_px, span_px))
        else:
            yield disc(self.shape, middle_yx, span_px / 2.0)

    def truth(self) -> Iterator[Truth]:
        """The ground truth of each frame, computed from the geometry.

        The angular size is 2 atan(s / 2d) for a cube, and 2 asin(R / D) for a ball with its centre
        at D. The derivative with respect to the distance is -s / (d² + s²/4) for a cube, and
        -2 R / (D sqrt(D² - R²)) for a ball.
        """
        size = self.object_size_m
        rate = self.speed_m_s if self.recedes else -self.speed_m_s
        for index in range(self.n_frames()):
            distance, outline = self._distances(index)
            ball = (distance + size / 2.0) * outline
            slope = -size / (distance**2 + size**2 / 4.0 if self.solid == "cube" else ball)
            yield Truth(
                index,
                index / self.fps,
                math.degrees(2.0 * math.atan2(size, 2.0 * outline)),
                math.degrees(slope * rate),
                math.nan if self.recedes else distance / self.speed_m_s,
            )

    def _distances(self, index: int) -> tuple[float, float]:
        """Distances in m: d, to the nearest point, and o, to the outline.

        An object of size s spans f s / o in the image. For a cube seen face on, o = d. For a ball,
        o is the length of the tangent, sqrt(D² - R²), computed without cancellation.
        """
        covered = self.speed_m_s * index / self.fps
        distance = self.distance_m + (covered if self.recedes else -covered)
        size = self.object_size_m
        if self.solid == "cube":
            return distance, distance
        return distance, math.sqrt(distance * (distance + size))


@dataclass(frozen=True)
class Translation(Scene):
    """Squares that stay fully visible, and reach the image's middle halfway through the clip.

    Each square has its own speed, from top to bottom; negative speeds are to the left. The size is
    a ninth of the image's height by default.
    """

    object_size_px: float | None = option(
        None, "object_size", 0, MAX_SIDE_PX, unit="px", low_open=True
    )
    speeds_px: tuple[float, ...] = option(
        (1.0, 2.0, 3.0, 4.0), "speed", -MAX_SIDE_PX, MAX_SIDE_PX, unit="px/frame"
    )

    @property
    def side_px(self) -> float:
        """Side of the squares, in px."""
        return self.shape[0] / 9.0 if self.object_size_px is None else self.object_size_px

    def n_frames(self) -> int:
        """Number of frames: the option, else as many as the image has room for, 75 at most."""
        height, width = self.shape
        n_squares, side, speeds = len(self.speeds_px), self.side_px, self.speeds_px
        if n_squares == 0 or 0.0 in speeds:
            raise invalid("speed", "every square needs a speed other than 0")
        if side * n_squares > height or side > width:
            squares = f"{n_squares} squares" if n_squares > 1 else "a square"
            why = f"{squares} of {side:g} px cannot fit into an image of {width}x{height}"
            most = math.floor(min(height / n_squares, width))
            raise invalid("object_size", why, f"Choose {most} px or less.")
        fastest = max(map(abs, speeds))
        # The margin is for speeds such as 0.1 that floats cannot represent exactly.
        room = math.floor((width - side) / fastest + 1e-6) + 1
        if self.n_asked is not None and self.n_asked > room:
            why = f"a square at {fastest:g} px/frame leaves the image after {room} frames"
            hint = (
                f"Choose 1 to {room}, a lower {argument('speed')}, or a wider {argument('size')}."
            )
            raise invalid("frames", why, hint)
        return self.n_asked or min(_DEFAULT_FRAMES, room)

    def patches(self, index: int) -> Iterator[Patch]:
        """One square per speed, each in its own row."""
        height, width = self.shape
        row_height = height / len(self.speeds_px)
        from_middle = index - (self.n_frames() - 1) / 2.0
        for row, speed in enumerate(self.speeds_px):
            center_yx = (row + 0.5) * row_height, width / 2.0 + speed * from_middle
            yield rectangle(self.shape, center_yx, (self.side_px, self.side_px))

    def truth(self) -> Iterator[Truth]:
        """The ground truth of each frame; the angular size is for a square in the middle."""
        angle = 2.0 * math.atan2(self.side_px, 2.0 * self.focal_px)
        for index in range(self.n_frames()):
            yield Truth(index, index / self.fps, math.degrees(angle), 0.0, math.nan)


# The receding cube starts where the looming cube ends: the same frames in reverse order.
_END_M = Approach.speed_m_s / Approach.fps
_ALL: tuple[Scene, ...] = (
    Approach("looming-cube", "a cube that approaches the camera"),
    Approach("receding-cube", "a cube that recedes from it", distance_m=_END_M, recedes=True),
    Approach("looming-ball", "a ball that approaches the camera", solid="ball"),
    Translation("translating-cubes", "cubes that cross the image, each at its own speed"),
)
SCENES: dict[str, Scene] = {scene.name: scene for scene in _ALL}


def find_scene(name: str) -> Scene:
    """The scene called `name`; raises ParameterError if there is none.

    Examples
    --------
    >>> scene = find_scene("looming-cube").configured({"speed": 2.0, "size": (135, 240)})
    >>> next(scene.frames()).shape
    (135, 240)
    """
    if name not in SCENES:
        hint = did_you_mean(name, SCENES) + f"Choose from {', '.join(SCENES)}."
        raise ParameterError("", f"there is no scene {name[:100]!r}", hint)
    return SCENES[name]


def ball_approaches(width: int, height: int) -> Iterator[list[GreyImage]]:
    """Clips of a ball up to contact, frames (H, W) uint8, at several speeds, with a little noise.

    In small frames, or with narrow kernels, not every speed raises an alarm.
    """
    for speed_m_s in (3.0, 2.0, 4.0, 6.0):
        ball = Approach(
            "looming-ball",
            "",
            solid="ball",
            shape=(height, width),
            n_asked=_N_TEST_FRAMES,
            noise=0.004,
            speed_m_s=speed_m_s,
            distance_m=speed_m_s * (_N_TEST_FRAMES + 1) / Approach.fps,
        )
        yield list(ball.frames())


def cube_clips(
    speeds_px: Sequence[float],
    side_px: float,
    n_frames: int | None,
    size_wh: tuple[int, int],
    reach_px: int,
) -> tuple[list[Iterator[Frame]], dict[str, Json]]:
    """Black cubes that translate over white: one clip per speed, and a description of all clips.

    Rows farther than `reach_px` from the cubes are cut off. By default, all clips last as long as
    the fastest cube stays in the image, 75 frames at most.
    """
    width, height = size_wh
    common = {
        "size": (height, width),
        "frames": n_frames,
        "object_size": side_px,
        "contrast": -1.0,
        "background": 1.0,
    }
    cubes = SCENES["translating-cubes"]
    scenes = [cubes.configured({**common, "speed": (speed,)}) for speed in speeds_px]
    if n_frames is None:
        n_frames = min(scene.n_frames() for scene in scenes)
        # With an odd number, cubes with whole px/frame stay aligned to pixels.
        n_frames -= 1 - n_frames % 2
    above = max(0, int((height - side_px) / 2) - reach_px - 1)

    def frames(scene: Scene) -> Iterator[Frame]:
        for index, picture in enumerate(scene.frames()):
            yield Frame(index, index / scene.fps, picture[above : height - above])

    clips = [frames(replace(scene, n_asked=n_frames)) for scene in scenes]
    facts: dict[str, Json] = {"speeds_px": list(speeds_px), "side_px": side_px}
    return clips, {**facts, "frames": n_frames, "width": width, "height": height}
