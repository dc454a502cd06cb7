"""How near things are: exact distances from a point to convex bodies."""

import numpy as np

from dlgmd_cli.flights.renderer.camera import FloatArray
from dlgmd_cli.flights.renderer.solids import Surfaces

# With fewer faces, nothing is inside.
_LEAST_CLOSED = 4


class Nearest:
    """Distances to some bodies.

    Parameters
    ----------
    surfaces : Surfaces
    """

    def __init__(self, surfaces: Surfaces) -> None:
        self._surfaces = surfaces
        corners = surfaces.corners_m
        self._edges = np.roll(corners, -1, axis=1) - corners
        squares = (self._edges**2).sum(axis=-1)
        # Where a corner is repeated, its edge is a point.
        self._squares = np.where(squares > 0.0, squares, 1.0)
        self._inwards = np.cross(surfaces.normals[:, None], self._edges)
        self._solids, self._starts = np.unique(surfaces.face_body, return_index=True)
        n_faces = np.diff([*self._starts, len(surfaces.face_body)])
        self._closed = n_faces >= _LEAST_CLOSED
        if len(self._solids):
            self._low = np.minimum.reduceat(corners.min(axis=1), self._starts)
            self._high = np.maximum.reduceat(corners.max(axis=1), self._starts)

    def distances(self, position_m: FloatArray, time_s: float) -> FloatArray:
        """From a point, (3,), to the nearest point of each body; 0 inside.

        Returns
        -------
        ndarray, shape (n_bodies,)
            In m.
        """
        surfaces = self._surfaces
        # A body that has moved is seen as one at rest from where the point would be then.
        points = position_m - surfaces.offsets(time_s)
        distances = np.full(len(surfaces.bodies), np.inf)
        if len(self._solids):
            distances[self._solids] = self._to_solids(points)
        if len(surfaces.radii_m):
            distances[surfaces.round_body] = self._to_rounds(points[surfaces.round_body])
        return distances

    def _to_solids(self, points: FloatArray) -> FloatArray:
        """From a point for each body to the bodies that have faces."""
        surfaces = self._surfaces
        to_corners = points[surfaces.face_body][:, None] - surfaces.corners_m
        heights = (to_corners[:, 0] * surfaces.normals).sum(axis=-1)
        above = (to_corners * self._inwards).sum(axis=-1).min(axis=1) >= 0.0
        along = (to_corners * self._edges).sum(axis=-1) / self._squares
        to_edges = to_corners - np.clip(along, 0.0, 1.0)[..., None] * self._edges
        beside = np.sqrt((to_edges**2).sum(axis=-1).min(axis=1))
        to_faces = np.where(above, np.abs(heights), beside)
        nearest = np.minimum.reduceat(to_faces, self._starts)
        highest = np.maximum.reduceat(heights, self._starts)
        own = points[self._solids]
        boxed = ((own >= self._low) & (own <= self._high)).all(axis=-1)
        inside = self._closed & (highest <= 0.0) & boxed
        return np.where(inside, 0.0, nearest)

    def _to_rounds(self, points: FloatArray) -> FloatArray:
        """From a point for each round body to its surface."""
        first, axis = self._surfaces.ends_m[:, 0], np.diff(self._surfaces.ends_m, axis=1)[:, 0]
        squares = (axis**2).sum(axis=-1)
        along = ((points - first) * axis).sum(axis=-1) / np.where(squares > 0.0, squares, 1.0)
        to_axis = points - first - np.clip(along, 0.0, 1.0)[:, None] * axis
        lengths = np.sqrt((to_axis**2).sum(axis=-1))
        return np.maximum(lengths - self._surfaces.radii_m, 0.0)
