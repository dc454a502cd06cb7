"""Where the expansion is measured: windows of fixed angles, around the direction of flight.

A drone that flies forward pitches nose down and flies to a point above the middle of the image of a
level camera.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

# First row, end row; first column, end column. Ends are excluded.
Window = tuple[int, int, int, int]
# Angles to the right and upwards from the optical axis, in degrees.
Direction = tuple[float, float]

# The assumed horizontal field of view of an unknown camera, in degrees.
USUAL_FOV_DEG = 80.0
# Least focal length of a reduced image, in cells: 120 columns at 80°. No image is enlarged.
LEAST_FOCAL = 60.0 / math.tan(math.radians(USUAL_FOV_DEG) / 2.0)
# Angle of the flight direction above the axis of a level camera, in degrees.
AHEAD_DEG = 5.0
# Least share of a window that must be inside the image.
LEAST_SHOWN = 0.6


class Part(NamedTuple):
    """A part of the view, in degrees: width, height, and its centre above the flight direction.

    `weight` is the weight of the part's rate in the mean over all parts.
    """

    width_deg: float
    height_deg: float
    above_deg: float
    weight: float


# A square, and a narrower window placed higher, which leaves out the floor and shows less beside a
# narrow obstacle. If both expand, an obstacle is ahead.
SQUARE, NARROW = Part(27.0, 27.0, -5.0, 0.4), Part(16.0, 27.0, 1.5, 0.6)
PARTS = (SQUARE, NARROW)


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
        """Focal length, in cells of an image of this width."""
        left, _, right, _ = self.crop
        return width / (right - left) / 2.0 / math.tan(math.radians(self.fov_deg) / 2.0)

    def factor(self, width: int, most: int) -> int:
        """The reduction of an image, at most `most`, that keeps a focal length of `LEAST_FOCAL`."""
        return max(1, min(most, math.floor(self.focal(width) / LEAST_FOCAL + 1e-6)))

    @property
    def ahead(self) -> Direction:
        """The assumed direction of flight if none is reported."""
        return 0.0, AHEAD_DEG - self.tilt_deg

    def windows(
        self, shape: tuple[int, ...], direction: Direction | None = None
    ) -> list[Window] | None:
        """The square and the narrow window in an image (H, W), without its border cells.

        Both are around the direction of flight, or around `ahead`. None if less than `LEAST_SHOWN`
        of a window is inside the image.
        """
        right, up = self.ahead if direction is None else direction
        found = [self._window(shape, part, right, up + part.above_deg) for part in PARTS]
        return None if None in found else [window for window in found if window is not None]

    def _window(
        self, shape: tuple[int, ...], part: Part, right_deg: float, up_deg: float
    ) -> Window | None:
        (height, width), (left, top, right, bottom) = shape, self.crop
        whole_width, whole_height = width / (right - left), height / (bottom - top)
        focal = self.focal(width)
        x = _span(focal, (0.5 - left) * whole_width, right_deg, part.width_deg)
        y = _span(focal, (0.5 - top) * whole_height, -up_deg, part.height_deg)
        (first_x, last_x), (first_y, last_y) = _inside(x, width), _inside(y, height)
        n_cells = (x[1] - x[0]) * (y[1] - y[0])
        n_shown = max(last_x - first_x, 0) * max(last_y - first_y, 0)
        # A window behind the camera has no cells at all.
        if not n_shown or n_shown < LEAST_SHOWN * n_cells:
            return None
        return first_y, last_y, first_x, last_x


def _span(focal: float, middle: float, from_axis_deg: float, angle_deg: float) -> tuple[int, int]:
    """The range of cells along a side that an angle around a direction covers."""
    edges = []
    for edge_deg in (from_axis_deg - angle_deg / 2.0, from_axis_deg + angle_deg / 2.0):
        within = math.radians(min(max(edge_deg, -_STEEPEST_DEG), _STEEPEST_DEG))
        edges.append(math.floor(middle + focal * math.tan(within) + 0.5))
    return edges[0], edges[1]


# Angle from the optical axis beyond which nothing is in an image, in degrees.
_STEEPEST_DEG = 89.0


def _inside(span: tuple[int, int], n: int) -> tuple[int, int]:
    """The part of a span inside n cells without the first and the last cell."""
    return max(span[0], 1), min(span[1], n - 1)


def outside(camera: Camera, size_wh: tuple[int, int]) -> str:
    """Why nothing can be measured with this camera in images of this size; empty if it can."""
    if camera.windows((size_wh[1], size_wh[0])) is not None:
        return ""
    return (
        f"a camera of {camera.fov_deg:g}°, mounted {camera.tilt_deg:g}° upwards, does not see "
        "where the drone flies: there is no expansion and no time to contact"
    )
