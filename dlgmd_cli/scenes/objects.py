"""The scenes of `synth`: plain objects that approach, cross, grow, turn or drift."""

import math
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.frame import Frame, GreyImage
from dlgmd_cli.parameters.checks import did_you_mean
from dlgmd_cli.parameters.facts import Json
from dlgmd_cli.scenes.scene import (
    MAX_FRAMES,
    MAX_SIDE_PX,
    Angles,
    Scene,
    invalid,
    option,
)
from dlgmd_cli.scenes.shapes import Patch, bar, disc, rectangle, stripes, union

MIN_METRES, MAX_METRES = 0.001, 10_000
_N_TEST_FRAMES = 20


@dataclass(frozen=True)
class Axial(Scene):
    """An object that moves along the optical axis at constant speed.

    The size is the side of a square, or the diameter of a ball or of an upright capsule, in m. The
    distance, in m, is from the camera to the nearest point of the object at frame 0. `l_over_v` is
    half the size over the speed, in place of the speed.
    """

    object_size_m: float = option(0.5, "object_size", MIN_METRES, MAX_METRES, unit="m")
    speed_asked: float | None = option(None, "speed", MIN_METRES, MAX_METRES, unit="m/s")
    l_over_v_ms: float | None = option(None, "l_over_v", 0, 10_000, unit="ms", low_open=True)
    distance_m: float = option(7.5, "distance", MIN_METRES, MAX_METRES, unit="m")
    solid: Literal["square", "ball", "capsule"] = "square"
    # Length of a capsule over its diameter.
    LENGTH: ClassVar[float] = 3.0
    SPEED_M_S: ClassVar[float] = 3.0

    def __post_init__(self) -> None:
        if self.speed_asked is not None and self.l_over_v_ms is not None:
            raise invalid("l_over_v", f"excludes {argument('speed')}", "Give one of them.")
        super().__post_init__()

    @property
    def speed_m_s(self) -> float:
        """The speed in m/s."""
        if self.l_over_v_ms is not None:
            return self.object_size_m / 2.0 / (self.l_over_v_ms / 1000.0)
        return self.SPEED_M_S if self.speed_asked is None else self.speed_asked

    @abstractmethod
    def distance_at(self, place: int) -> float:
        """The distance in m to the nearest point of the object in one frame of the motion."""

    def patches(self, place: int) -> Iterator[Patch]:
        """The object, about the middle of the image."""
        height, width = self.shape
        middle_yx = height / 2.0, width / 2.0
        span_px = self.focal_px * self.object_size_m / self.outline_at(place)
        if self.solid == "square":
            yield rectangle(self.shape, middle_yx, (span_px, span_px))
        elif self.solid == "ball":
            yield disc(self.shape, middle_yx, span_px / 2.0)
        else:
            straight_px = (self.LENGTH - 1.0) * span_px
            parts = [rectangle(self.shape, middle_yx, (straight_px, span_px))]
            for end in (-0.5, 0.5):
                end_yx = middle_yx[0] + end * straight_px, middle_yx[1]
                parts.append(disc(self.shape, end_yx, span_px / 2.0))
            yield union(self.shape, parts)

    def angles(self, place: int) -> Angles:
        """What the object subtends, computed from the geometry; a capsule by its diameter.

        The angular size is 2 atan(s / 2d) for a square, and 2 asin(R / D) for a ball with its
        centre at D. The derivative with respect to the distance is -s / (d² + s²/4) for a square,
        and -2 R / (D sqrt(D² - R²)) for a ball.
        """
        size = self.object_size_m
        distance, outline = self.distance_at(place), self.outline_at(place)
        ball = (distance + size / 2.0) * outline
        slope = -size / (distance**2 + size**2 / 4.0 if self.solid == "square" else ball)
        return Angles(
            math.degrees(2.0 * math.atan2(size, 2.0 * outline)),
            math.degrees(slope * -self.speed_m_s),
            distance / self.speed_m_s,
        )

    def outline_at(self, place: int) -> float:
        """The distance in m to the outline: an object of size s spans f s / o in the image.

        For a square seen face on, it is the distance. For a ball, it is the length of the tangent,
        sqrt(D² - R²), computed without cancellation.
        """
        distance = self.distance_at(place)
        if self.solid == "square":
            return distance
        return math.sqrt(distance * (distance + self.object_size_m))


@dataclass(frozen=True)
class Approach(Axial):
    """An object that approaches up to contact, or until it has the final angular size."""

    final_angle_deg: float | None = option(
        None, "final_angle", 0, 179, unit="degrees", low_open=True
    )

    @property
    def end_m(self) -> float:
        """The distance at which the motion ends; 0 for contact."""
        if self.final_angle_deg is None:
            return 0.0
        half, size = math.radians(self.final_angle_deg) / 2.0, self.object_size_m
        if self.solid == "square":
            return max(0.0, size / 2.0 / math.tan(half))
        return size / 2.0 / math.sin(half) - size / 2.0

    def n_moving(self) -> int:
        """Number of frames before contact, or up to the final angle."""
        steps = (self.distance_m - self.end_m) / self.speed_m_s * self.fps
        if steps <= 0.0:
            why = f"the object covers {self.final_angle_deg:g} degrees in the first frame already"
            raise invalid("final_angle", why, f"Choose more, or a larger {argument('distance')}.")
        # The frame of contact itself does not count; 1e-6 is a margin for rounding.
        n_most = max(1, math.ceil(steps - 1e-6)) + (self.final_angle_deg is not None)
        if self.n_asked is None and n_most > MAX_FRAMES:
            why = f"contact comes only after {n_most} frames, and a clip has {MAX_FRAMES} at most"
            raise invalid(
                "speed", why, f"Raise it, or end the clip earlier with {argument('frames')}."
            )
        if self.n_asked is not None and self.n_asked > n_most + self.n_held:
            what = "contact" if self.final_angle_deg is None else "the end"
            hint = f"Choose 1 to {n_most + self.n_held}, or start at a larger "
            why = f"{what} comes after {n_most + self.n_held} frames"
            raise invalid("frames", why, f"{hint}{argument('distance')}.")
        return n_most

    def distance_at(self, place: int) -> float:
        """The distance in m: less from frame to frame, down to that of the final angle."""
        return max(self.distance_m - self.speed_m_s * place / self.fps, self.end_m)


@dataclass(frozen=True)
class Recession(Axial):
    """An object that recedes for as many frames as asked for, 75 by default."""

    def n_moving(self) -> int:
        """Number of frames: 75 unless asked for."""
        return self.n_moving_asked

    def distance_at(self, place: int) -> float:
        """The distance in m, more from frame to frame."""
        return self.distance_m + self.speed_m_s * place / self.fps

    def angles(self, place: int) -> Angles:
        """What the object subtends; it becomes smaller, and there is no contact."""
        size, velocity, _ = super().angles(place)
        return Angles(size, -velocity)


@dataclass(frozen=True)
class Flat(Scene):
    """A scene in the plane of the image, in px; with `vertical`, rows and columns are exchanged.

    The size is a `SHARE` of the height by default.
    """

    SHARE: ClassVar[float] = 1.0 / 9.0
    object_size_px: float | None = option(
        None, "object_size", 0, MAX_SIDE_PX, unit="px", low_open=True
    )
    vertical: bool = option(False, "vertical", kind=bool)

    @property
    def plane(self) -> tuple[int, int]:
        """Height and width in px as if the motion were along the width."""
        height, width = self.shape
        return (width, height) if self.vertical else (height, width)

    @property
    def side_px(self) -> float:
        """The size in px."""
        return self.SHARE * self.plane[0] if self.object_size_px is None else self.object_size_px

    def n_moving(self) -> int:
        """Number of frames: 75 unless asked for."""
        return self.n_moving_asked

    def patches(self, place: int) -> Iterator[Patch]:
        """The objects in one frame of the motion."""
        for patch in self.drawn(place):
            yield patch.turned if self.vertical else patch

    @abstractmethod
    def drawn(self, place: int) -> Iterator[Patch]:
        """The objects in the `plane`."""

    def angle_deg(self, size_px: float) -> float:
        """The angular size of so many px in the middle of the image."""
        return math.degrees(2.0 * math.atan2(size_px, 2.0 * self.focal_px))

    def angles(self, place: int) -> Angles:
        """What the size subtends in the middle of the image."""
        return Angles(self.angle_deg(self.side_px))

    def n_within(self, room: int, why: str, hint: str) -> int:
        """The number of frames of a motion that the image has room for, 75 unless asked for."""
        if self.n_asked is not None and self.n_asked > room + self.n_held:
            raise invalid("frames", why, f"Choose 1 to {room + self.n_held}, {hint}.")
        return min(room, self.n_moving_asked)


@dataclass(frozen=True)
class Translation(Flat):
    """Squares, or bars, that stay fully visible, and reach the middle halfway through the clip.

    Each has its own speed, from top to bottom; negative speeds are to the left. The size is a ninth
    of the height by default. A bar is as high as its share of the image.
    """

    speeds_px: tuple[float, ...] = option(
        (1.0, 2.0, 3.0, 4.0), "speed", -MAX_SIDE_PX, MAX_SIDE_PX, unit="px/frame"
    )
    is_bar: bool = False

    def n_moving(self) -> int:
        """Number of frames: as many as the image has room for, 75 at most unless asked for."""
        height, width = self.plane
        n_squares, side, speeds = len(self.speeds_px), self.side_px, self.speeds_px
        noun = "bar" if self.is_bar else "square"
        if n_squares == 0 or 0.0 in speeds:
            raise invalid("speed", f"every {noun} needs a speed other than 0")
        if side > width or (side * n_squares > height and not self.is_bar):
            objects = f"{n_squares} {noun}s" if n_squares > 1 else f"a {noun}"
            why = f"{objects} of {side:g} px cannot fit into an image of {width}x{height}"
            most = math.floor(width if self.is_bar else min(height / n_squares, width))
            raise invalid("object_size", why, f"Choose {most} px or less.")
        fastest = max(map(abs, speeds))
        # The margin is for speeds such as 0.1 that floats cannot represent exactly.
        room = math.floor((width - side) / fastest + 1e-6) + 1
        return self.n_within(
            room,
            f"a {noun} at {fastest:g} px/frame leaves the image after {room} frames",
            f"a lower {argument('speed')}, or a wider {argument('size')}",
        )

    def drawn(self, place: int) -> Iterator[Patch]:
        """One square or bar per speed, each in its own row."""
        height, width = self.plane
        row_height = height / len(self.speeds_px)
        from_middle = place - (self.n_moving() - 1) / 2.0
        size_yx = row_height if self.is_bar else self.side_px, self.side_px
        for row, speed in enumerate(self.speeds_px):
            center_yx = (row + 0.5) * row_height, width / 2.0 + speed * from_middle
            yield rectangle(self.plane, center_yx, size_yx)


@dataclass(frozen=True)
class Deformation(Flat):
    """A rectangle with one fixed edge, on the border, whose opposite edge moves over the image.

    The size is that of the fixed edge, nine tenths of the height by default.
    """

    SHARE: ClassVar[float] = 0.9
    speed_px: float = option(4.0, "speed", 0, MAX_SIDE_PX, unit="px/frame", low_open=True)

    def n_moving(self) -> int:
        """Number of frames until the rectangle is as long as the image, 75 at most by default."""
        room = math.floor(self.plane[1] / self.speed_px + 1e-6)
        if not room:
            raise invalid("speed", f"the image is {self.plane[1]} px long", "Choose less.")
        why = f"the rectangle is as long as the image after {room} frames"
        return self.n_within(room, why, f"or a lower {argument('speed')}")

    def _length_px(self, place: int) -> float:
        return self.speed_px * (place + 1)

    def drawn(self, place: int) -> Iterator[Patch]:
        """The rectangle, from the left border on."""
        length = self._length_px(place)
        yield rectangle(self.plane, (self.plane[0] / 2.0, length / 2.0), (self.side_px, length))

    def angles(self, place: int) -> Angles:
        """What the length subtends, as if it were in the middle of the image."""
        length, focal = self._length_px(place), self.focal_px
        slope = focal / (focal**2 + length**2 / 4.0)
        return Angles(self.angle_deg(length), math.degrees(slope * self.speed_px * self.fps))


@dataclass(frozen=True)
class Grating(Flat):
    """Upright stripes that drift; the size is the width of a stripe, half of the period."""

    speed_px: float = option(4.0, "speed", -MAX_SIDE_PX, MAX_SIDE_PX, unit="px/frame")

    def drawn(self, place: int) -> Iterator[Patch]:
        """All stripes."""
        yield stripes(self.plane, self.speed_px * place, self.side_px)


@dataclass(frozen=True)
class Rotation(Flat):
    """A bar that turns about the middle of the image, clockwise for speeds above 0.

    Its length is nine tenths of the height, and the size is its width.
    """

    speed_deg: float = option(3.0, "speed", -180, 180, unit="degrees/frame")

    def drawn(self, place: int) -> Iterator[Patch]:
        """The bar, along the width in the first frame."""
        height, width = self.plane
        turn = math.radians(-self.speed_deg if self.vertical else self.speed_deg) * place
        size_yx = self.side_px, 0.9 * self.shape[0]
        yield bar(self.plane, (height / 2.0, width / 2.0), size_yx, turn)


# The receding cube starts where the looming cube ends.
_END_M = Axial.SPEED_M_S / Axial.fps
_ALL: tuple[Scene, ...] = (
    Approach("looming", "a square that approaches the camera"),
    Approach("receding", "the same backwards", backwards=True),
    Approach("ball", "a ball that approaches the camera", solid="ball"),
    Approach("capsule", "an upright capsule that approaches the camera", solid="capsule"),
    Approach("looming-cube", "the same as looming"),
    Approach("looming-ball", "the same as ball", solid="ball"),
    Recession("receding-cube", "a square that recedes from the camera", distance_m=_END_M),
    Translation("translating", "a bar that crosses the image", is_bar=True, speeds_px=(4.0,)),
    Translation("translating-cubes", "squares that cross the image, each at its own speed"),
    Deformation("elongating", "a rectangle that grows from one border to the other"),
    Deformation("shortening", "the same backwards", backwards=True),
    Grating("grating", "stripes that drift"),
    Rotation("rotating", "a bar that turns about the middle"),
)
SCENES: dict[str, Scene] = {scene.name: scene for scene in _ALL}


def find_scene(name: str) -> Scene:
    """The scene called `name`; raises ParameterError if there is none.

    Examples
    --------
    >>> scene = find_scene("looming").configured({"speed": 2.0, "size": (135, 240)})
    >>> next(scene.frames()).shape
    (135, 240)
    """
    if name not in SCENES:
        hint = did_you_mean(name, SCENES) + f"Choose from {', '.join(SCENES)}, benchmark."
        raise ParameterError("", f"there is no scene {name[:100]!r}", hint)
    return SCENES[name]


def ball_approaches(width: int, height: int) -> Iterator[list[GreyImage]]:
    """Clips of a ball up to contact, frames (H, W) uint8, at several speeds, with a little noise.

    In small frames, or with narrow kernels, not every speed raises an alarm.
    """
    for speed_m_s in (3.0, 2.0, 4.0, 6.0):
        ball = Approach(
            "ball",
            "",
            solid="ball",
            shape=(height, width),
            n_asked=_N_TEST_FRAMES,
            noise=0.004,
            speed_asked=speed_m_s,
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
