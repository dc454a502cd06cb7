"""How large a target looks, and how fast that changes."""

import math

import numpy as np

from dlgmd_cli.flights.renderer.camera import FloatArray
from dlgmd_cli.flights.renderer.solids import Surfaces

# Directions nearer to each other than this have no angle that changes smoothly.
_SAME_DIRECTION = 1e-12


class Extent:
    """The angle that some bodies span together, as seen from a point.

    It is spanned by two of their corners, or of the balls that their round parts end in: the
    angle between the directions to the two, and half the angle that each spans itself.

    Parameters
    ----------
    surfaces : Surfaces
    """

    def __init__(self, surfaces: Surfaces) -> None:
        points, bodies = [], []
        corners = surfaces.corners_m.reshape(-1, 3)
        of_corner = np.repeat(surfaces.face_body, surfaces.corners_m.shape[1])
        for body in np.unique(of_corner):
            own = np.unique(corners[of_corner == body], axis=0)
            points.append(own)
            bodies.append(np.full(len(own), body))
        n_corners = sum(len(own) for own in points)
        self.points_m = np.concatenate([*points, surfaces.ends_m.reshape(-1, 3)])
        self.body = np.concatenate([*bodies, np.repeat(surfaces.round_body, 2)]).astype(np.intp)
        self.radii_m = np.concatenate([np.zeros(n_corners), np.repeat(surfaces.radii_m, 2)])

    def angle(
        self,
        position_m: FloatArray,
        velocity_m_s: FloatArray,
        offsets_m: FloatArray,
        velocities_m_s: FloatArray,
    ) -> tuple[float, float]:
        """The greatest angle between two directions from a point to the bodies.

        Parameters
        ----------
        position_m, velocity_m_s : ndarray, shape (3,)
            Of the point.
        offsets_m, velocities_m_s : ndarray, shape (n_bodies, 3)
            How far the bodies have moved and how fast they do.

        Returns
        -------
        angle_deg, rate_deg_s : float
            180 and 0 where the bodies surround the point, or it is in a round one.
        """
        towards = self.points_m + offsets_m[self.body] - position_m
        speeds = velocities_m_s[self.body] - velocity_m_s
        distances = np.sqrt((towards**2).sum(axis=-1))
        if (distances <= self.radii_m).any():
            return 180.0, 0.0
        units = towards / distances[:, None]
        halves = np.arcsin(self.radii_m / distances)
        between = np.arccos(np.clip(units @ units.T, -1.0, 1.0))
        spans = between + halves[:, None] + halves
        i, j = np.unravel_index(int(spans.argmax()), spans.shape)
        apart, apart_rate = _between(units, speeds / distances[:, None], int(i), int(j))
        angle = apart + float(halves[i] + halves[j])
        if angle >= math.pi:
            return 180.0, 0.0
        outwards = (speeds * units).sum(axis=-1)
        shrinking = outwards * np.tan(halves) / distances
        rate = apart_rate - float(shrinking[i] + shrinking[j])
        return math.degrees(angle), math.degrees(rate)


def _between(units: FloatArray, speeds: FloatArray, i: int, j: int) -> tuple[float, float]:
    """Angle between two of some directions, and its rate; `speeds` are per distance."""
    cosine = float(units[i] @ units[j])
    sine = float(np.linalg.norm(np.cross(units[i], units[j])))
    angle = math.atan2(sine, cosine)
    if sine < _SAME_DIRECTION:
        return angle, 0.0
    turns = speeds - (speeds * units).sum(axis=-1)[:, None] * units
    return angle, 0.0 - float(turns[i] @ units[j] + units[i] @ turns[j]) / sine
