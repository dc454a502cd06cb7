"""A camera: its pose, the projection of points into its image, and its sensor.

World: x and y are horizontal and z points up, in m. Body: x forward, y left, z up. Image: x
points right and y down, in px; pixel (0, 0) extends from 0 to 1.
"""

import math
from dataclasses import dataclass
from functools import cache
from statistics import NormalDist

import numpy as np

from dlgmd_cli.frame import FloatArray, FloatImage, GreyImage

# From body axes (forward, left, up) to camera axes (right, down, forward).
_CAMERA_FROM_BODY = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
# Quantisation of light and noise: 16 bits.
_N_STEPS = 65_536


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

    `shape` is the height and width in px, `fov_deg` the horizontal field of view.
    """

    shape: tuple[int, int]
    fov_deg: float

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


class Sensor:
    """Converts light to frames.

    Parameters
    ----------
    camera : Camera
        Defines the size, and the angles for the vignette.
    vignette : float
        Share of the light lost in the corners. Elsewhere, the loss is proportional to 1 - cos⁴ of
        the angle to the optical axis.
    shot_noise, read_noise : float
        Standard deviations, as shares of full light. Read noise is the same in every pixel; the
        variance of shot noise is proportional to the light, and `shot_noise` is for full light.
    gamma : float
        Grey levels are 255 light^(1 / gamma).
    seed : int
        Seed of the noise.
    """

    def __init__(
        self,
        camera: Camera,
        *,
        vignette: float = 0.0,
        shot_noise: float = 0.0,
        read_noise: float = 0.0,
        gamma: float = 2.2,
        seed: int = 0,
    ) -> None:
        self._transmission = _transmission(camera, vignette)
        self._shot, self._read, self._seed = shot_noise, read_noise, seed
        steps = np.linspace(0.0, 1.0, _N_STEPS)
        self._levels = np.rint(255.0 * steps ** (1.0 / gamma)).astype(np.uint8)

    def develop(self, light: FloatImage, index: int) -> GreyImage:
        """Frame number `index`, (H, W) uint8, from light, (H, W), where white is 1.

        The noise depends only on the seed and on `index`. `light` is overwritten.
        """
        light *= self._transmission
        if self._shot or self._read:
            # Rounding can make the light slightly negative.
            deviation = np.maximum(light, 0.0) * np.float32(self._shot**2)
            deviation += np.float32(self._read**2)
            np.sqrt(deviation, out=deviation)
            # Quantiles drawn at random are three times as fast as NumPy's normal generator; their
            # range is ±4.3 standard deviations.
            bits = np.random.SFC64([self._seed, index]).random_raw(-(-light.size // 4))
            drawn = bits.view(np.uint16)[: light.size]
            deviation *= _quantiles().take(drawn).reshape(light.shape)
            light += deviation
        np.clip(light, 0.0, 1.0, out=light)
        light *= _N_STEPS - 1
        light += np.float32(0.5)
        return self._levels.take(light.astype(np.uint16))


@cache
def _quantiles() -> FloatImage:
    """Midpoint quantiles of the normal distribution for `_N_STEPS` equal parts."""
    quantile = NormalDist().inv_cdf
    return np.array([quantile((i + 0.5) / _N_STEPS) for i in range(_N_STEPS)], np.float32)


def _transmission(camera: Camera, vignette: float) -> FloatImage:
    """Transmission of the lens, (H, W)."""
    height, width = camera.shape
    x = (np.arange(width) + 0.5 - width / 2.0) / camera.focal_px
    y = (np.arange(height) + 0.5 - height / 2.0) / camera.focal_px
    cosine4 = 1.0 / (1.0 + np.add.outer(y**2, x**2)) ** 2
    darkest = 1.0 / (1.0 + math.hypot(width / 2.0, height / 2.0) ** 2 / camera.focal_px**2) ** 2
    lost = vignette * (1.0 - cosine4) / (1.0 - darkest)
    return (1.0 - lost).astype(np.float32)
