"""Distances and angular sizes of bodies, and the first contact of a flight."""

import math
from collections.abc import Collection, Sequence

import numpy as np

from dlgmd_cli.lab.flights.path import REACH_M, Path
from dlgmd_cli.lab.flights.renderer.camera import FloatArray
from dlgmd_cli.lab.flights.renderer.solids import Body, Face, Surfaces, World

# A solid with fewer faces is not closed.
_LEAST_CLOSED = 4
# Longest and shortest time step in the search for contact.
_LONGEST_S, _SHORTEST_S = 0.02, 0.002
# Upper bound on the gain in speed of the drone and the bodies during a step.
_MARGIN_M_S = 0.5
_N_HALVINGS = 40
# Tolerance of contact: a rebounding drone is within reach for an instant only.
_ROUNDING_M = 1e-6
# Below this sine of the angle between two directions, its rate is taken as 0.
_SAME_DIRECTION = 1e-12


class Nearest:
    """Exact distances from a point to convex bodies, and to walls as infinite planes."""

    def __init__(self, bodies: Sequence[Body], walls: Sequence[Face] = ()) -> None:
        self.surfaces = Surfaces(bodies)
        corners = self.surfaces.corners_m
        self._edges = np.roll(corners, -1, axis=1) - corners
        squares = (self._edges**2).sum(axis=-1)
        # Where a corner is repeated, its edge is a point.
        self._squares = np.where(squares > 0.0, squares, 1.0)
        self._inwards = np.cross(self.surfaces.normals[:, None], self._edges)
        self._solids, self._starts = np.unique(self.surfaces.face_body, return_index=True)
        n_faces = np.diff([*self._starts, len(corners)])
        self._closed = n_faces >= _LEAST_CLOSED
        if len(self._solids):
            self._low = np.minimum.reduceat(corners.min(axis=1), self._starts)
            self._high = np.maximum.reduceat(corners.max(axis=1), self._starts)
        self._wall_normals = np.array([wall.normal for wall in walls]).reshape(-1, 3)
        self._wall_levels = np.array([wall.normal @ wall.corners_m[0] for wall in walls])

    def distances(self, position_m: FloatArray, time_s: float) -> FloatArray:
        """Distances from a point, (3,), to each body, and then to each wall, in m.

        They are 0 inside a body, and negative behind a wall.
        """
        surfaces = self.surfaces
        # Instead of moving the bodies, move the point the other way.
        points = position_m - surfaces.offsets(time_s)
        distances = np.full(len(surfaces.bodies), np.inf)
        if len(self._solids):
            distances[self._solids] = self._to_solids(points)
        if surfaces.capsules:
            distances[surfaces.capsule_body] = self._to_rounds(points[surfaces.capsule_body])
        return np.concatenate([distances, self._wall_normals @ position_m - self._wall_levels])

    def _to_solids(self, points: FloatArray) -> FloatArray:
        """Distances to the solids from points, one for each body."""
        surfaces = self.surfaces
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
        """Distances to the capsules from points, one for each capsule."""
        first, axis = self.surfaces.ends_m[:, 0], np.diff(self.surfaces.ends_m, axis=1)[:, 0]
        squares = (axis**2).sum(axis=-1)
        along = ((points - first) * axis).sum(axis=-1) / np.where(squares > 0.0, squares, 1.0)
        to_axis = points - first - np.clip(along, 0.0, 1.0)[:, None] * axis
        lengths = np.sqrt((to_axis**2).sum(axis=-1))
        return np.maximum(lengths - self.surfaces.radii_m, 0.0)


def surroundings(world: World, names: Collection[str] | None = None) -> Nearest:
    """Distances to everything in a world, or only to the bodies and the room with certain names."""
    bodies = [body for body in world.bodies if names is None or body.name in names]
    return Nearest(bodies, world.room.faces if names is None or world.room.name in names else ())


def first_contact(
    path: Path, world: World, target_names: Collection[str] | None = None
) -> float | None:
    """Time, in s, when something first comes within `REACH_M` of the camera, or None.

    Whatever is that close at the start, such as the floor under the drone, counts only after it
    has been farther away. For the names see `surroundings`.
    """
    nearest = surroundings(world, target_names)

    def distances(time_s: float) -> FloatArray:
        return nearest.distances(path.state(time_s).position_m, time_s)

    blows = [stretch.start_s for stretch in path.stretches[1:]]
    time, was = 0.0, distances(0.0)
    clear = was > REACH_M
    while time < path.duration_s and len(was):
        velocities = nearest.surfaces.velocities(time)
        fastest = float(np.sqrt((velocities**2).sum(axis=-1)).max(initial=0.0))
        speed = float(np.linalg.norm(path.state(time).velocity_m_s)) + fastest + _MARGIN_M_S
        gap = float((was[clear] - REACH_M).min(initial=math.inf))
        step = min(max(gap / speed, _SHORTEST_S), _LONGEST_S)
        later = min(time + step, path.duration_s, *(blow for blow in blows if blow > time))
        now = distances(later)
        touched = clear & (now <= REACH_M + _ROUNDING_M)
        if touched.any():
            for _ in range(_N_HALVINGS):
                middle = 0.5 * (time + later)
                if (distances(middle)[touched] <= REACH_M).any():
                    later = middle
                else:
                    time = middle
            return later
        clear |= now > REACH_M
        time, was = later, now
    return None


class AngularExtent:
    """The angle that a group of bodies spans, as seen from a point.

    The greatest angle is between two corners, or two end balls of capsules. For balls, half of the
    angle that each ball spans is added to the angle between the directions to their centres.

    Attributes
    ----------
    points_m, radii_m : ndarray, shape (n, 3) and (n,)
        Corners of solids, with radius 0, and centres of the end balls of capsules.
    body : ndarray, shape (n,)
        Index of each point's body.
    """

    def __init__(self, surfaces: Surfaces) -> None:
        n_corners = surfaces.corners_m.shape[1]
        of_corner = np.repeat(surfaces.face_body, n_corners)[:, None]
        # Corners that faces share count once.
        tagged = np.hstack([of_corner, surfaces.corners_m.reshape(-1, 3)])
        corners = np.unique(tagged, axis=0)
        self.points_m = np.concatenate([corners[:, 1:], surfaces.ends_m.reshape(-1, 3)])
        self.body = np.concatenate([corners[:, 0], np.repeat(surfaces.capsule_body, 2)]).astype(int)
        self.radii_m = np.concatenate([np.zeros(len(corners)), np.repeat(surfaces.radii_m, 2)])

    def angle(
        self,
        position_m: FloatArray,
        velocity_m_s: FloatArray,
        offsets_m: FloatArray,
        velocities_m_s: FloatArray,
    ) -> tuple[float, float]:
        """The angle, in degrees, seen from a moving point, and its rate in degrees/s.

        Offsets and velocities of the bodies are (n_bodies, 3). The angle is 180 and its rate 0 if
        the bodies surround the point, or if it is inside a capsule.
        """
        towards = self.points_m + offsets_m[self.body] - position_m
        speeds = velocities_m_s[self.body] - velocity_m_s
        distances = np.sqrt((towards**2).sum(axis=-1))
        if (distances <= self.radii_m).any():
            return 180.0, 0.0
        units = towards / distances[:, None]
        halves = np.arcsin(self.radii_m / distances)
        spans = np.arccos(np.clip(units @ units.T, -1.0, 1.0)) + halves[:, None] + halves
        pair = np.array(np.unravel_index(int(spans.argmax()), spans.shape))
        apart, rate = _between(units[pair], speeds[pair] / distances[pair, None])
        angle = apart + float(halves[pair].sum())
        if angle >= math.pi:
            return 180.0, 0.0
        outwards = (speeds[pair] * units[pair]).sum(axis=-1)
        rate -= float((outwards * np.tan(halves[pair]) / distances[pair]).sum())
        return math.degrees(angle), math.degrees(rate)


def _between(units: FloatArray, speeds: FloatArray) -> tuple[float, float]:
    """Angle between two unit vectors, (2, 3), and its rate; `speeds` are divided by distance."""
    cosine = float(units[0] @ units[1])
    sine = float(np.linalg.norm(np.cross(units[0], units[1])))
    angle = math.atan2(sine, cosine)
    if sine < _SAME_DIRECTION:
        return angle, 0.0
    turns = speeds - (speeds * units).sum(axis=-1)[:, None] * units
    return angle, 0.0 - float(turns[0] @ units[1] + units[0] @ turns[1]) / sine
