"""Where the expansion is measured: windows in the camera's angles, around the direction of flight.

A drone that flies forward pitches nose down, so that it flies to a point above the middle of the
image of a level camera.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

# Rows from, up to; columns from, up to.
Window = tuple[int, int, int, int]
# To the right and upwards from the optical axis, in degrees.
Direction = tuple[float, float]

# The horizontal angle of a camera of which nothing is known, in degrees.
USUAL_FOV_DEG = 80.0
# Least focal length of an image that is measured, if it has one, in cells: that of 120 columns.
LEAST_FOCAL = 60.0 / math.tan(math.radians(USUAL_FOV_DEG) / 2.0)
# How far above the axis of a level camera a drone flies, in degrees.
AHEAD_DEG = 5.0
# Least share of a window that has to be in the image.
LEAST_SHOWN = 0.6


class Part(NamedTuple):
    """A part of the view: its width and height, and its middle above the direction of flight.

    `weight` is that of its rate in the mean of all.
    """

    width_deg: float
    height_deg: float
    above_deg: float
    weight: float


# A square, and a narrower window above it, which leaves out the floor and sees less beside a
# narrow obstacle. Where each expands, an obstacle is ahead.
SQUARE, NARROW = Part(27.0, 27.0, -5.0, 0.4), Part(16.0, 27.0, 1.5, 0.6)
PARTS = (SQUARE, NARROW)


@dataclass(frozen=True)
class Camera:
    """The angles of a camera on a drone: a pinhole with square pixels.

    Attributes
    ----------
    fov_deg : float
        Horizontal field of view of its whole image.
    tilt_deg : float
        Angle at which it is mounted, upwards positive.
    crop : (float, float, float, float)
        The part of its image that is read: left, top, right and bottom, as shares of its sides.
    """

    fov_deg: float = USUAL_FOV_DEG
    tilt_deg: float = 0.0
    crop: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)

    def focal(self, width: int) -> float:
        """Focal length, in cells of an image of this width."""
        left, _, right, _ = self.crop
        return width / (right - left) / 2.0 / math.tan(math.radians(self.fov_deg) / 2.0)

    def factor(self, width: int, most: int) -> int:
        """By how much an image of this width is reduced, so that an angle has cells enough."""
        return max(1, min(most, math.floor(self.focal(width) / LEAST_FOCAL + 1e-6)))

    @property
    def ahead(self) -> Direction:
        """The direction of flight where none is reported."""
        return 0.0, AHEAD_DEG - self.tilt_deg

    def windows(
        self, shape: tuple[int, ...], direction: Direction | None = None
    ) -> list[Window] | None:
        """The square and the narrow window in an image (H, W), without its border cells.

        They are around a direction of flight, or `ahead`. None if less than `LEAST_SHOWN` of
        one is in the image.
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
    """The cells of a side that an angle about a direction covers; more than a turn away, none."""
    edges = []
    for edge_deg in (from_axis_deg - angle_deg / 2.0, from_axis_deg + angle_deg / 2.0):
        within = math.radians(min(max(edge_deg, -_STEEPEST_DEG), _STEEPEST_DEG))
        edges.append(math.floor(middle + focal * math.tan(within) + 0.5))
    return edges[0], edges[1]


# Beyond it nothing is in an image.
_STEEPEST_DEG = 89.0


def _inside(span: tuple[int, int], n: int) -> tuple[int, int]:
    """The part of a span that is in n cells, without the first and the last one."""
    return max(span[0], 1), min(span[1], n - 1)


def outside(camera: Camera, size_wh: tuple[int, int]) -> str:
    """Why nothing can be measured with this camera in images of this size; empty if it can."""
    if camera.windows((size_wh[1], size_wh[0])) is not None:
        return ""
    return (
        f"a camera of {camera.fov_deg:g}°, mounted {camera.tilt_deg:g}° upwards, does not see "
        "where the drone flies: there is no expansion and no time to contact"
    )
