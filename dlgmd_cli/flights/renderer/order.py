"""Which of two convex bodies is behind the other, by a plane that lies between them."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from dlgmd_cli.flights.renderer.camera import FloatArray
from dlgmd_cli.flights.renderer.solids import Body

# Bodies that touch are apart.
_TOUCHING_M = 1e-6


class Order:
    """The order in which bodies are to be painted, so that each covers what is behind it.

    Of two bodies on the two sides of a plane, the one on the far side cannot hide the other. Looked
    at are the planes along the axes and, where none of them will do, along the faces of the two.
    Where bodies cut into each other, or several hide each other in a ring, the farther middle comes
    first.

    Parameters
    ----------
    bodies : sequence of Body
        Where they are now.
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        n = len(bodies)
        self._bodies = list(bodies)
        boxes = np.array([_box(body) for body in bodies]).reshape(-1, 2, 3)
        self._low, self._high = boxes[:, 0], boxes[:, 1]
        # Of a body i and another one j: for each axis, 1 or -1 if i has less or more of it than j,
        # else 0, and where the plane between them is.
        self._signs = np.zeros((n, n, 3))
        self._levels = np.zeros((n, n, 3))
        # Where no axis will do: normal and offset of a plane with i behind it.
        self._planes = np.zeros((n, n, 4))
        self._is_apart = np.zeros((n, n), bool)
        for i in range(n):
            self._part(i, np.arange(i + 1, n))

    @property
    def is_exact(self) -> bool:
        """Whether every two bodies have a plane between them."""
        upper = np.triu_indices(len(self._bodies), 1)
        return bool(self._is_apart[upper].all())

    def move(self, index: int, body: Body) -> None:
        """Put `body` in the place of the one with that index."""
        self._bodies[index] = body
        self._low[index], self._high[index] = _box(body)
        others = np.arange(len(self._bodies))
        self._part(index, others[others != index])

    def back_to_front(
        self, eye_m: FloatArray, extents: Mapping[int, tuple[float, float, float, float]]
    ) -> list[int]:
        """Some bodies, farthest first, as seen from a point.

        Parameters
        ----------
        eye_m : ndarray, shape (3,)
        extents : mapping of int to (float, float, float, float)
            Which, and where each is in the picture: left, top, right and bottom. What does not
            overlap there may come in any order.
        """
        indices = np.array(list(extents), int)
        middles = (self._low[indices] + self._high[indices]) / 2.0
        distances = np.sqrt(((middles - eye_m) ** 2).sum(axis=1))
        pairs = np.ix_(indices, indices)
        # On which side of the planes the eye is: positive means that the first body is behind.
        sides = self._signs[pairs] * (eye_m - self._levels[pairs])
        planes = self._planes[pairs]
        by_face = planes[..., :3] @ eye_m - planes[..., 3]
        is_behind = (sides > 0.0).any(axis=2) | (by_face > 0.0)
        is_cut = ~self._is_apart[pairs]
        is_behind |= is_cut & (distances[:, None] > distances[None, :])
        # Of two that are both behind the other, by different planes, neither hides the other.
        left, top, right, bottom = np.array(list(extents.values())).reshape(-1, 4).T
        overlaps = (left[:, None] < right) & (top[:, None] < bottom)
        hides = is_behind & ~is_behind.T & overlaps & overlaps.T
        return [int(indices[place]) for place in _sorted(hides, distances)]

    def _part(self, index: int, others: npt.NDArray[np.intp]) -> None:
        """Find the planes between a body and others."""
        low, high = self._low[index], self._high[index]
        is_less = high <= self._low[others] + _TOUCHING_M
        is_more = low >= self._high[others] - _TOUCHING_M
        signs = is_less.astype(float) - is_more
        levels = np.where(is_less, high + self._low[others], low + self._high[others]) / 2.0
        self._signs[index, others], self._signs[others, index] = signs, -signs
        self._levels[index, others] = self._levels[others, index] = levels
        self._planes[index, others] = self._planes[others, index] = 0.0
        is_apart = (signs != 0.0).any(axis=1)
        for place in np.flatnonzero(~is_apart):
            other = others[place]
            plane = between(self._bodies[index], self._bodies[other])
            if plane is not None:
                self._planes[index, other] = plane
                self._planes[other, index] = np.negative(plane)
                is_apart[place] = True
        self._is_apart[index, others] = self._is_apart[others, index] = is_apart


def between(body: Body, other: Body) -> tuple[float, float, float, float] | None:
    """A plane with `body` behind it and `other` in front: normal and offset; None without one."""
    (low, high), (low2, high2) = _box(body), _box(other)
    line = (low2 + high2 - low - high) / 2.0
    length = float(np.linalg.norm(line))
    candidates = [body.normals, -body.normals, other.normals, -other.normals]
    if length > 0.0 and not (len(body.normals) and len(other.normals)):
        candidates.append(line[None] / length)
    normals = np.concatenate(candidates)
    if not len(normals):
        return None
    ends, begins = body.reach(normals), -other.reach(-normals)
    best = int(np.argmax(begins - ends))
    if begins[best] - ends[best] < -_TOUCHING_M:
        return None
    x, y, z = normals[best]
    return float(x), float(y), float(z), float(ends[best] + begins[best]) / 2.0


def _box(body: Body) -> tuple[FloatArray, FloatArray]:
    """The least and the greatest coordinates of a body."""
    axes = np.eye(3)
    return -body.reach(-axes), body.reach(axes)


def _sorted(behind: npt.NDArray[np.bool_], distances: FloatArray) -> list[int]:
    """Places in an order where j comes after every i with `behind[i, j]`."""
    n_behind = behind.sum(axis=0)
    is_left = np.ones(len(distances), bool)
    order = []
    while is_left.any():
        free = is_left & (n_behind == 0)
        picks = np.flatnonzero(free if free.any() else is_left)
        pick = int(picks[np.argmax(distances[picks])])
        order.append(pick)
        is_left[pick] = False
        n_behind = n_behind - behind[pick]
    return order
