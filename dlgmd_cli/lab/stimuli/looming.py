"""A cube or a ball that approaches or recedes along the optical axis."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from dlgmd_cli.lab.stimuli.base import MAX_FRAMES, GreyImage, Scene, invalid, option
from dlgmd_cli.lab.stimuli.plain import (
    DEFAULT_FRAMES,
    FlatOptions,
    FlatTruth,
    Patch,
    disc,
    rectangle,
    render,
)

Shape = Literal["cube", "ball"]
MIN_METRES, MAX_METRES = 0.001, 10_000
_N_TEST_FRAMES = 20


@dataclass(frozen=True)
class ApproachOptions(FlatOptions):
    """Options of a scene with one object on the optical axis.

    The size is the side of the cube or the diameter of the ball. The distance is from the camera to
    the nearest point of the object at frame 0.
    """

    object_size_m: float = option(0.5, "--object-size", MIN_METRES, MAX_METRES, unit="m")
    speed_m_s: float = option(3.0, "--speed", MIN_METRES, MAX_METRES, unit="m/s")
    distance_m: float = option(7.5, "--distance", MIN_METRES, MAX_METRES, unit="m")


class Approach(Scene[ApproachOptions]):
    """A "cube" or a "ball" that moves along the optical axis at constant speed."""

    truth_type = FlatTruth

    def __init__(
        self,
        name: str,
        description: str,
        solid: Shape,
        defaults: ApproachOptions,
        *,
        recedes: bool = False,
    ) -> None:
        self.name, self.description, self.defaults = name, description, defaults
        self._solid, self._recedes = solid, recedes

    def n_frames(self, options: ApproachOptions) -> int:
        """Number of frames: as set, else all before contact, or 75 if the object recedes."""
        if self._recedes:
            return options.n_frames or DEFAULT_FRAMES
        # With a margin for rounding: the frame of contact itself does not count.
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
            lambda index: [_patch(self._solid, options, self._distance(options, index))],
        )

    def truth(self, options: ApproachOptions) -> Iterator[FlatTruth]:
        """The ground truth of each frame, computed from the geometry."""
        rate = options.speed_m_s if self._recedes else -options.speed_m_s
        for index in range(self.n_frames(options)):
            distance = self._distance(options, index)
            slope = _angle_slope(self._solid, options.object_size_m, distance)
            yield FlatTruth(
                index,
                index / options.fps,
                math.degrees(_angle(self._solid, options.object_size_m, distance)),
                math.degrees(slope * rate),
                math.nan if self._recedes else distance / options.speed_m_s,
            )

    def _distance(self, options: ApproachOptions, index: int) -> float:
        """Distance of the nearest point at frame `index`, in m."""
        covered = options.speed_m_s * index / options.fps
        return options.distance_m + (covered if self._recedes else -covered)


def _outline_distance_m(shape: Shape, size: float, distance: float) -> float:
    """Distance at which the outline is seen, in m: an object of size s spans f s / it in the image.

    For a cube seen face on, this is the distance d of the front face. For a ball with its centre at
    D = d + s/2, it is the length of the tangent sqrt(D² - R²), here computed without cancellation.
    """
    return distance if shape == "cube" else math.sqrt(distance * (distance + size))


def _angle(shape: Shape, size: float, distance: float) -> float:
    """Angular size in rad: 2 atan(s / 2d) for a cube, 2 asin(R / D) for a ball."""
    return 2.0 * math.atan2(size, 2.0 * _outline_distance_m(shape, size, distance))


def _angle_slope(shape: Shape, size: float, distance: float) -> float:
    """Derivative of the angular size with respect to the distance, in rad/m.

    It is -s / (d² + s²/4) for a cube and -2 R / (D sqrt(D² - R²)) for a ball.
    """
    if shape == "cube":
        return -size / (distance**2 + size**2 / 4.0)
    return -size / ((distance + size / 2.0) * _outline_distance_m(shape, size, distance))


def _patch(shape: Shape, options: ApproachOptions, distance: float) -> Patch:
    """Projection of the object: a square or a disc."""
    size = options.object_size_m
    span_px = options.focal_px * size / _outline_distance_m(shape, size, distance)
    height, width = options.shape
    middle = height / 2.0, width / 2.0
    if shape == "cube":
        return rectangle(options.shape, middle, (span_px, span_px))
    return disc(options.shape, middle, span_px / 2.0)


def ball_approaches(width: int, height: int) -> Iterator[list[GreyImage]]:
    """Frames, (H, W) uint8, of a ball up to contact, at several speeds, with a little noise.

    In small frames, or with narrow kernels, not every speed raises an alarm.
    """
    for speed_m_s in (3.0, 2.0, 4.0, 6.0):
        options = ApproachOptions(
            shape=(height, width),
            n_frames=_N_TEST_FRAMES,
            noise=0.004,
            speed_m_s=speed_m_s,
            distance_m=speed_m_s * (_N_TEST_FRAMES + 1) / ApproachOptions.fps,
        )
        yield list(Approach("looming-ball", "", "ball", options).frames(options))
