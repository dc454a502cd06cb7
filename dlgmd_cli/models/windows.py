"""Where the expansion is measured: a window of fixed angles, around the direction of flight."""

import math
from dataclasses import dataclass

# Left, top, right and bottom edge, in px of an image.
Bounds = tuple[float, float, float, float]
# Angles to the right and upwards from the optical axis, in degrees.
Direction = tuple[float, float]

# The assumed horizontal field of view of an unknown camera, in degrees.
USUAL_FOV_DEG = 80.0
# How far the window reaches to each side of the direction of flight, in degrees: further down than
# up, since obstacles stand on the ground.
BESIDE_DEG, ABOVE_DEG, BELOW_DEG = 10.0, 10.0, 16.0
# Least share of the window that must be inside the image.
LEAST_SHOWN = 0.4
# How far a part of the image must reach beyond the optical axis, as a share of the width.
_BEYOND_AXIS = 0.05
# Angle from the optical axis beyond which nothing is in an image, in degrees.
_STEEPEST_DEG = 89.0


@dataclass(frozen=True)
class Camera:
    """The angles of a camera on a drone: a pinhole with square pixels.

    Attributes
    ----------
    fov_deg : float
        Horizontal field of view of the whole image.
    tilt_deg : float
        Tilt of the camera on the drone, upwards positive.
    crop : (float, float, float, float)
        The part of the image that is read: left, top, right and bottom, as shares of the sides.
    """

    fov_deg: float = USUAL_FOV_DEG
    tilt_deg: float = 0.0
    crop: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)

    def focal(self, width: int) -> float:
        """Focal length, in px of an image of this width."""
        left, _, right, _ = self.crop
        return width / (right - left) / 2.0 / math.tan(math.radians(self.fov_deg) / 2.0)

    def axis(self, shape: tuple[int, ...]) -> tuple[float, float]:
        """Where the optical axis meets an image (H, W), in px; it may be outside a part."""
        (height, width), (left, top, right, bottom) = shape, self.crop
        x = (0.5 - left) * width / (right - left) - 0.5
        return x, (0.5 - top) * height / (bottom - top) - 0.5

    @property
    def ahead(self) -> Direction:
        """The assumed direction of flight if none is reported: level with the drone."""
        return 0.0, -self.tilt_deg

    def window(self, shape: tuple[int, ...], direction: Direction | None = None) -> Bounds | None:
        """The window around a direction of flight, or around `ahead`, in an image (H, W).

        None if less than `LEAST_SHOWN` of the window is inside the image, or an angle is NaN.
        """
        right_deg, up_deg = self.ahead if direction is None else direction
        (height, width), (axis_x, axis_y) = shape, self.axis(shape)
        focal = self.focal(width)
        x = [axis_x + focal * _tangent(right_deg + deg) for deg in (-BESIDE_DEG, BESIDE_DEG)]
        y = [axis_y + focal * _tangent(-up_deg + deg) for deg in (-ABOVE_DEG, BELOW_DEG)]
        shown = _inside(x, width) * _inside(y, height)
        # A window behind the camera has no size at all, and one without a direction NaN.
        if not (shown > 0.0 and shown >= LEAST_SHOWN * (x[1] - x[0]) * (y[1] - y[0])):
            return None
        return x[0], y[0], x[1], y[1]


def _tangent(from_axis_deg: float) -> float:
    """The tangent of an angle from the optical axis, at most that of `_STEEPEST_DEG`."""
    return math.tan(math.radians(min(max(from_axis_deg, -_STEEPEST_DEG), _STEEPEST_DEG)))


def _inside(span: list[float], n: int) -> float:
    """The length of a span inside n px."""
    return max(min(span[1], n - 1.0) - max(span[0], 0.0), 0.0)


def outside(camera: Camera, size_wh: tuple[int, int]) -> str:
    """Why nothing can be measured with this camera in images of this size; empty if it can."""
    if camera.window((size_wh[1], size_wh[0])) is not None:
        return ""
    return (
        f"a camera of {camera.fov_deg:g}°, mounted {camera.tilt_deg:g}° upwards, does not see "
        "where the drone flies: there is no expansion and no time to contact"
    )


def beside(camera: Camera) -> str:
    """A warning if the part, as one image of a stereo pair, lies beside the axis; or empty."""
    left, _, right, _ = camera.crop
    if left < 0.5 - _BEYOND_AXIS and right > 0.5 + _BEYOND_AXIS:
        return ""
    return (
        "the part that is read lies beside the middle of the image, around which fov and direction "
        "of flight count; if it is one image of a stereo pair, cut it out with FFmpeg"
    )
