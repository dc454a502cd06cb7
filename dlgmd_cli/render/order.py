"""Which of two convex bodies is behind the other, by a plane that lies between them."""

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from dlgmd_cli.render.camera import FloatArray
from dlgmd_cli.render.solids import Body

# Bodies that touch are apart.
_TOUCHING_M = 1e-6


class Order:
    """The order in which bodies are to be painted, so that each covers what is behind it.

    Exact wherever a plane along an axis, or along a face of one of two bodies, has them on its two
    sides. Where none has, or where several bodies hide each other in a ring, the farther middle
    comes first.

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
        # Of a body i and a later one j: normal and offset of a plane with i behind it.
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

    def back_to_front(self, eye_m: FloatArray, chosen: Iterable[int]) -> list[int]:
        """The bodies with the indices `chosen`, farthest first, as seen from a point."""
        indices = np.array(list(chosen), int)
        middles = (self._low[indices] + self._high[indices]) / 2.0
        distances = np.linalg.norm(middles - eye_m, axis=1)
        pairs = np.ix_(indices, indices)
        planes = self._planes[pairs]
        # With the eye in front of the plane, the body behind it is the farther one.
        by_plane = planes[..., :3] @ eye_m > planes[..., 3]
        by_middle = distances[:, None] > distances[None, :]
        is_first_behind = np.where(self._is_apart[pairs], by_plane, by_middle)
        i, j = np.triu_indices(len(indices), 1)
        behind = np.zeros(is_first_behind.shape, bool)
        behind[i, j] = is_first_behind[i, j]
        behind[j, i] = ~is_first_behind[i, j]
        return [int(indices[place]) for place in _sorted(behind, distances)]

    def _part(self, index: int, others: npt.NDArray[np.intp]) -> None:
        """Find the planes between a body and others: upright or level ones where that will do."""
        gaps = np.concatenate(
            [self._low[others] - self._high[index], self._low[index] - self._high[others]], axis=1
        )
        axes = gaps.argmax(axis=1)
        for other, axis, gap in zip(others, axes, gaps.max(axis=1, initial=-1.0), strict=True):
            i, j = (index, other) if index < other else (other, index)
            if gap < -_TOUCHING_M:
                plane = between(self._bodies[i], self._bodies[j])
                self._is_apart[i, j] = plane is not None
                self._planes[i, j] = plane or 0.0
                continue
            # On the lower side of the plane is the first of the two or the second.
            is_first_lower = (axis < 3) == (index < other)
            axis, sign = axis % 3, 1.0 if is_first_lower else -1.0
            lower, upper = (i, j) if is_first_lower else (j, i)
            middle = (self._high[lower, axis] + self._low[upper, axis]) / 2.0
            self._planes[i, j] = 0.0
            self._planes[i, j, axis] = sign
            self._planes[i, j, 3] = sign * middle
            self._is_apart[i, j] = True


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
