"""A camera: its pose, and the projection of points into its image.

World: x and y are horizontal and z points up, in m. Body: x forward, y left, z up. Image: x
points right and y down, in px; pixel (0, 0) extends from 0 to 1.
"""

import math
from dataclasses import dataclass

import numpy as np

from dlgmd_cli.frame import FloatArray

# From body axes (forward, left, up) to camera axes (right, down, forward).
_CAMERA_FROM_BODY = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def rotation(roll_deg: float, pitch_deg: float, yaw_deg: float) -> FloatArray:
    """The body's axes in the world, as the columns of a matrix: Rz(yaw) Ry(-pitch) Rx(roll).

    Positive angles are right side down, nose up, and counter-clockwise as seen from above. At yaw 0
    the nose points along x.
    """
    roll, pitch, yaw = np.radians([roll_deg, pitch_deg, yaw_deg])
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_y @ about_x


def angles_of(rotation: FloatArray) -> tuple[float, float, float]:
    """Roll, pitch and yaw in degrees, the inverse of `rotation`; yaw is within ±180."""
    pitch = math.asin(min(max(rotation[2, 0], -1.0), 1.0))
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)


@dataclass(frozen=True)
class Pose:
    """Position of the camera, (3,), and its attitude, see `rotation`; it looks along body x."""

    position_m: FloatArray
    rotation: FloatArray

    @property
    def camera_from_world(self) -> FloatArray:
        """The camera's axes (right, down, forward) in the world, as rows."""
        return _CAMERA_FROM_BODY @ self.rotation.T


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with square pixels; its axis meets the image in the middle.

    `shape` is the height and width in px, `fov_deg` the horizontal field of view, and `tilt_deg`
    the angle at which the camera is mounted on the drone, upwards positive.
    """

    shape: tuple[int, int]
    fov_deg: float
    tilt_deg: float = 0.0

    def mounted(self, drone: Pose) -> Pose:
        """Position and attitude of the camera on a drone."""
        if self.tilt_deg == 0.0:
            return drone
        return Pose(drone.position_m, drone.rotation @ rotation(0.0, self.tilt_deg, 0.0))

    @property
    def focal_px(self) -> float:
        """Focal length, in px."""
        return self.shape[1] / 2.0 / math.tan(math.radians(self.fov_deg) / 2.0)

    @property
    def middle_xy(self) -> FloatArray:
        """Principal point: where the optical axis meets the image, in px."""
        return np.array([self.shape[1] / 2.0, self.shape[0] / 2.0])

    @property
    def rays_from_xy(self) -> FloatArray:
        """Matrix from (x, y, 1), in px, to the viewing ray in camera axes."""
        (x, y), focal = self.middle_xy, self.focal_px
        return np.array(
            [[1.0 / focal, 0.0, -x / focal], [0.0, 1.0 / focal, -y / focal], [0, 0, 1.0]]
        )

    def view(self, points_m: FloatArray, pose: Pose) -> FloatArray:
        """World points, (..., 3), in camera axes: right, down and forward, in m."""
        return (points_m - pose.position_m) @ pose.camera_from_world.T

    def flatten(self, seen_m: FloatArray) -> FloatArray:
        """Project points in camera axes, (..., 3), in front of the camera, to px, (..., 2)."""
        return self.middle_xy + self.focal_px * seen_m[..., :2] / seen_m[..., 2:]
