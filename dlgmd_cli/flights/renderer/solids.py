"""What the world is made of: convex bodies with textured planar faces, balls and capsules."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
import numpy.typing as npt

from dlgmd_cli.flights.renderer.camera import FloatArray
from dlgmd_cli.flights.renderer.texture import Texture

Motion = Callable[[float], npt.ArrayLike]


@dataclass(frozen=True)
class Face:
    """A convex planar polygon with a texture on it; seen from its front only.

    Attributes
    ----------
    corners_m : ndarray, shape (n, 3)
        Counter-clockwise as seen from the front.
    texture : Texture
        Its picture fills the rectangle at `origin_m` with the sides `right_m` and `down_m`,
        in which all corners lie.
    origin_m, right_m, down_m : ndarray, shape (3,)
        The picture's top left corner; from there along its width; and along its height.
    gain : float
        Share of the light that arrives there.
    """

    corners_m: FloatArray
    texture: Texture
    origin_m: FloatArray
    right_m: FloatArray
    down_m: FloatArray
    gain: float = 1.0

    @cached_property
    def normal(self) -> FloatArray:
        """Unit vector that points to who sees it."""
        across: FloatArray = np.cross(
            self.corners_m[1] - self.corners_m[0], self.corners_m[2] - self.corners_m[0]
        )
        return across / math.sqrt(across @ across)

    def moved(self, by_m: FloatArray) -> "Face":
        """The same face elsewhere."""
        return replace(self, corners_m=self.corners_m + by_m, origin_m=self.origin_m + by_m)


class Body(Protocol):
    """A convex thing."""

    @property
    def name(self) -> str:
        """What it belongs to, such as "chair"; several bodies can share a name."""
        ...

    @property
    def motion(self) -> Motion | None:
        """How far it has moved, in m, (3,), at a time in s; None if it never does."""
        ...

    @property
    def normals(self) -> FloatArray:
        """Directions, (n, 3), in which another body may be told apart from it."""
        ...

    def reach(self, directions: FloatArray) -> FloatArray:
        """How far it extends along unit vectors, (n, 3), from the world's origin: (n,) in m."""
        ...

    def moved(self, by_m: FloatArray) -> "Body":
        """The same body elsewhere, at rest."""
        ...


@dataclass(frozen=True)
class Solid:
    """A convex body with planar faces that look outwards, or a flat one that has only a front.

    Attributes
    ----------
    name : str
        See `Body`.
    faces : sequence of Face
        All that can be seen of it.
    motion : callable or None
        See `Body`.
    """

    name: str
    faces: Sequence[Face]
    motion: Motion | None = None

    @cached_property
    def corners_m(self) -> FloatArray:
        """The corners of all faces, (n, 3)."""
        return np.concatenate([face.corners_m for face in self.faces])

    @cached_property
    def normals(self) -> FloatArray:
        """Those of the faces."""
        return np.array([face.normal for face in self.faces])

    def reach(self, directions: FloatArray) -> FloatArray:
        """See `Body`."""
        farthest: FloatArray = (directions @ self.corners_m.T).max(axis=-1)
        return farthest

    def moved(self, by_m: FloatArray) -> "Solid":
        """See `Body`."""
        return Solid(self.name, [face.moved(by_m) for face in self.faces])


@dataclass(frozen=True)
class Round:
    """A capsule: all that is within `radius_m` of the straight line between two points.

    Where the two are the same point, it is a ball.

    Attributes
    ----------
    name, motion
        See `Body`.
    ends_m : ndarray, shape (2, 3)
        The two points.
    radius_m : float
    texture : Texture
        As it is seen from far, from the side; the height of the picture is the length of the
        capsule from tip to tip, its bottom at the first end, and its width is twice the radius.
    gain : float
        See `Face`.
    """

    name: str
    ends_m: FloatArray
    radius_m: float
    texture: Texture
    gain: float = 1.0
    motion: Motion | None = field(default=None)

    @property
    def normals(self) -> FloatArray:
        """None of its own: it is told apart by those of the other, or by the line between them."""
        return np.empty((0, 3))

    def reach(self, directions: FloatArray) -> FloatArray:
        """See `Body`."""
        farthest: FloatArray = (directions @ self.ends_m.T).max(axis=-1) + self.radius_m
        return farthest

    def moved(self, by_m: FloatArray) -> "Round":
        """See `Body`."""
        return replace(self, ends_m=self.ends_m + by_m, motion=None)


def quad(
    origin_m: npt.ArrayLike,
    right_m: npt.ArrayLike,
    down_m: npt.ArrayLike,
    texture: Texture,
    gain: float = 1.0,
) -> Face:
    """A rectangle that its texture fills; it is seen from where `right_m` points to the right.

    Parameters
    ----------
    origin_m, right_m, down_m : array_like, shape (3,)
        Top left corner, and the sides from there, as its viewer has them.
    texture, gain
        See `Face`.
    """
    origin, right, down = (np.asarray(each, float) for each in (origin_m, right_m, down_m))
    corners = np.array([origin, origin + down, origin + down + right, origin + right])
    return Face(corners, texture, origin, right, down, gain)


@dataclass(frozen=True)
class World:
    """All that there is.

    Attributes
    ----------
    room : Solid
        Convex, seen from inside: its faces look inwards. It is behind everything else.
    bodies : sequence of Body
        Convex bodies in it, none of which cuts into another.
    light : callable
        How bright it is at a time in s; 1 is ordinary.
    """

    room: Solid
    bodies: Sequence[Body] = ()
    light: Callable[[float], float] = lambda _: 1.0
