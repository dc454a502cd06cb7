"""A cube or a ball that comes straight at the camera, or goes straight away from it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from dlgmd_cli.stimuli.base import MAX_FRAMES, GreyImage, Scene, invalid, option
from dlgmd_cli.stimuli.plain import (
    DEFAULT_FRAMES,
    FlatOptions,
    FlatTruth,
    Patch,
    disc,
    rectangle,
    render,
)

MIN_METRES, MAX_METRES = 0.001, 10_000


@dataclass(frozen=True)
class ApproachOptions(FlatOptions):
    """Options of a scene with one object on the optical axis.

    Attributes
    ----------
    object_size_m : float
        Side of the cube or diameter of the ball.
    speed_m_s : float
        How fast the distance shrinks or grows, in m/s.
    distance_m : float
        From the camera to the nearest point of the object at frame 0.
    """

    object_size_m: float = option(0.5, "--object-size", MIN_METRES, MAX_METRES, unit="m")
    speed_m_s: float = option(3.0, "--speed", MIN_METRES, MAX_METRES, unit="m/s")
    distance_m: float = option(7.5, "--distance", MIN_METRES, MAX_METRES, unit="m")


class Cube:
    """A cube on the optical axis, seen face on; only its front face is in sight.

    Sizes, and distances to the nearest point, are in m.
    """

    def angle(self, size: float, distance: float) -> float:
        """Angular size in rad: 2 atan(s / 2d), across the face."""
        return 2.0 * math.atan2(size, 2.0 * distance)

    def angle_slope(self, size: float, distance: float) -> float:
        """Its derivative with respect to the distance, in rad/m: -s / (d² + s²/4)."""
        return -size / (distance**2 + size**2 / 4.0)

    def patch(self, options: ApproachOptions, distance: float) -> Patch:
        """Its projection on the picture: a square of side f s / d."""
        side = options.focal_px * options.object_size_m / distance
        return rectangle(options.shape, _middle(options), (side, side))


class Ball:
    """A ball of diameter s; its centre lies at D = d + s/2, behind its nearest point.

    It is told what a `Cube` is.
    """

    def angle(self, size: float, distance: float) -> float:
        """2 asin(R / D), with R = s / 2."""
        return 2.0 * math.atan2(size / 2.0, _tangent(size, distance))

    def angle_slope(self, size: float, distance: float) -> float:
        """-2 R / (D sqrt(D² - R²))."""
        return -size / ((distance + size / 2.0) * _tangent(size, distance))

    def patch(self, options: ApproachOptions, distance: float) -> Patch:
        """A disc of radius f R / sqrt(D² - R²): the outline is where sight touches the ball."""
        size = options.object_size_m
        radius = options.focal_px * (size / 2.0) / _tangent(size, distance)
        return disc(options.shape, _middle(options), radius)


class Approach(Scene[ApproachOptions]):
    """An object of one kind that moves along the optical axis at constant speed.

    Parameters
    ----------
    name, description : str
        See `Scene`.
    solid : Cube or Ball
        The kind of object.
    defaults : ApproachOptions
        See `Scene`.
    recedes : bool
        Whether it goes away, so that there is no contact.
    """

    truth_type = FlatTruth

    def __init__(
        self,
        name: str,
        description: str,
        solid: Cube | Ball,
        defaults: ApproachOptions,
        *,
        recedes: bool = False,
    ) -> None:
        self.name, self.description, self.defaults = name, description, defaults
        self._solid, self._recedes = solid, recedes

    def n_frames(self, options: ApproachOptions) -> int:
        """As many as asked for, else 75, or all those before contact."""
        if self._recedes:
            return options.n_frames or DEFAULT_FRAMES
        # Contact on a frame, but for rounding, is no longer before contact.
        n_before = math.ceil(options.distance_m / options.speed_m_s * options.fps - 1e-6)
        n_before = max(1, n_before)
        if options.n_frames is None and n_before > MAX_FRAMES:
            raise invalid(
                "--speed",
                f"contact comes only after {n_before} frames, and a clip has {MAX_FRAMES} at most",
                "Raise it, or end the clip earlier with --frames.",
            )
        if options.n_frames is not None and options.n_frames > n_before:
            raise invalid(
                "--frames",
                f"contact comes after {n_before} frames",
                f"Choose 1 to {n_before}, or start at a larger --distance.",
            )
        return options.n_frames or n_before

    def frames(self, options: ApproachOptions) -> Iterator[GreyImage]:
        """The frames in order, (H, W) uint8."""
        return render(
            options,
            self.n_frames(options),
            lambda index: [self._solid.patch(options, self._distance(options, index))],
        )

    def truth(self, options: ApproachOptions) -> Iterator[FlatTruth]:
        """What is so at each frame, from the geometry alone."""
        rate = options.speed_m_s if self._recedes else -options.speed_m_s
        for index in range(self.n_frames(options)):
            distance = self._distance(options, index)
            slope = self._solid.angle_slope(options.object_size_m, distance)
            yield FlatTruth(
                index,
                index / options.fps,
                math.degrees(self._solid.angle(options.object_size_m, distance)),
                math.degrees(slope * rate),
                math.nan if self._recedes else distance / options.speed_m_s,
            )

    def _distance(self, options: ApproachOptions, index: int) -> float:
        """Distance of the nearest point at frame `index`, in m."""
        covered = options.speed_m_s * index / options.fps
        return options.distance_m + (covered if self._recedes else -covered)


def _middle(options: FlatOptions) -> tuple[float, float]:
    """Where the optical axis meets the picture."""
    height, width = options.shape
    return height / 2.0, width / 2.0


def _tangent(size: float, distance: float) -> float:
    """From the camera to where sight touches the ball: sqrt(D² - R²), without cancellation."""
    return math.sqrt(distance * (distance + size))
