"""What a world is made of: convex solids with textured planar faces, balls and capsules."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from dlgmd_cli.flights.renderer.camera import FloatArray
from dlgmd_cli.flights.renderer.texture import Texture

IntArray = npt.NDArray[np.intp]
# How far a body has moved, (3,) in m, at a time in s.
Motion = Callable[[float], npt.ArrayLike]

# Half the time over which a body's velocity is taken from its motion.
_HALF_S = 1e-4


@dataclass(frozen=True)
class Face:
    """A convex planar polygon with a texture on it, visible only from its front.

    Attributes
    ----------
    corners_m : ndarray, shape (n, 3)
        Counter-clockwise as seen from the front.
    texture : Texture
        Its image fills the rectangle at `origin_m` with the sides `right_m` and `down_m`,
        in which all corners lie.
    origin_m, right_m, down_m : ndarray, shape (3,)
        The image's top left corner, and from there the sides along its width and its height.
    gain : float
        Share of the light that arrives at the face.
    """

    corners_m: FloatArray
    texture: Texture
    origin_m: FloatArray
    right_m: FloatArray
    down_m: FloatArray
    gain: float = 1.0

    @cached_property
    def normal(self) -> FloatArray:
        """Unit vector out of the front."""
        across: FloatArray = np.cross(
            self.corners_m[1] - self.corners_m[0], self.corners_m[2] - self.corners_m[0]
        )
        return across / math.sqrt(across @ across)

    def moved(self, by_m: FloatArray) -> "Face":
        """The same face elsewhere."""
        return replace(self, corners_m=self.corners_m + by_m, origin_m=self.origin_m + by_m)


def quad(
    origin_m: npt.ArrayLike,
    right_m: npt.ArrayLike,
    down_m: npt.ArrayLike,
    texture: Texture,
    gain: float = 1.0,
) -> Face:
    """A rectangular face that its texture fills; the corner and the sides are those of `Face`."""
    origin, right, down = (np.asarray(each, float) for each in (origin_m, right_m, down_m))
    corners = np.array([origin, origin + down, origin + down + right, origin + right])
    return Face(corners, texture, origin, right, down, gain)


@dataclass(frozen=True)
class Solid:
    """A convex body with planar faces that look outwards, or a flat one that has only a front.

    Several bodies can share a name, such as "chair"; `motion` is None if it never moves.
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
        """The normals of the faces, (n, 3)."""
        return np.array([face.normal for face in self.faces])

    def reach(self, directions: FloatArray) -> FloatArray:
        """How far it extends along unit vectors, (n, 3), from the world's origin: (n,) in m."""
        farthest: FloatArray = (directions @ self.corners_m.T).max(axis=-1)
        return farthest

    def moved(self, by_m: FloatArray) -> "Solid":
        """The same solid elsewhere, at rest."""
        return Solid(self.name, [face.moved(by_m) for face in self.faces])


@dataclass(frozen=True)
class Round:
    """A capsule: all points within `radius_m` of the line between two points, `ends_m`, (2, 3).

    If both are the same point, it is a ball. The texture is the capsule as seen from far away, from
    the side: as high as it is long from tip to tip, with its bottom at the first end, and twice the
    radius wide.
    """

    name: str
    ends_m: FloatArray
    radius_m: float
    texture: Texture
    gain: float = 1.0
    motion: Motion | None = None

    @property
    def normals(self) -> FloatArray:
        """It has no faces, so none: (0, 3)."""
        return np.empty((0, 3))

    def reach(self, directions: FloatArray) -> FloatArray:
        """See `Solid.reach`."""
        farthest: FloatArray = (directions @ self.ends_m.T).max(axis=-1) + self.radius_m
        return farthest

    def moved(self, by_m: FloatArray) -> "Round":
        """The same capsule elsewhere, at rest."""
        return replace(self, ends_m=self.ends_m + by_m, motion=None)


Body = Solid | Round


@dataclass(frozen=True)
class World:
    """A room, whose faces look inwards, and convex bodies in it, none of which cuts into another.

    `light` is how bright it is at a time in s; 1 is ordinary.
    """

    room: Solid
    bodies: Sequence[Body] = ()
    light: Callable[[float], float] = lambda _: 1.0


class Surfaces:
    """The surfaces of some bodies as arrays, where they are before any motion.

    Attributes
    ----------
    faces : list of Face
        The faces of all solids; those of one solid follow each other.
    face_body, round_body : ndarray, shape (n_faces,) and (n_rounds,)
        Index of the body that a face or a round body is.
    corners_m : ndarray, shape (n_faces, n_corners, 3)
        A face with fewer corners than others repeats its last one.
    normals : ndarray, shape (n_faces, 3)
    rounds : list of Round
    ends_m, radii_m : ndarray, shape (n_rounds, 2, 3) and (n_rounds,)
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        self.bodies = tuple(bodies)
        solids = [(i, body) for i, body in enumerate(bodies) if isinstance(body, Solid)]
        self.faces = [face for _, solid in solids for face in solid.faces]
        self.face_body: IntArray = np.array([i for i, body in solids for _ in body.faces], np.intp)
        most = max((len(face.corners_m) for face in self.faces), default=3)
        self.corners_m = np.empty((len(self.faces), most, 3))
        for padded, face in zip(self.corners_m, self.faces, strict=True):
            padded[: len(face.corners_m)] = face.corners_m
            padded[len(face.corners_m) :] = face.corners_m[-1]
        self.normals = np.array([face.normal for face in self.faces]).reshape(-1, 3)
        self.rounds = [body for body in bodies if isinstance(body, Round)]
        self.round_body: IntArray = np.array(
            [i for i, body in enumerate(bodies) if isinstance(body, Round)], np.intp
        )
        self.ends_m = np.array([each.ends_m for each in self.rounds], float).reshape(-1, 2, 3)
        self.radii_m = np.array([each.radius_m for each in self.rounds], float)
        self._motions = [(i, body.motion) for i, body in enumerate(bodies) if body.motion]

    def offsets(self, time_s: float) -> FloatArray:
        """How far each body has moved, (n_bodies, 3), in m."""
        offsets = np.zeros((len(self.bodies), 3))
        for index, motion in self._motions:
            offsets[index] = motion(time_s)
        return offsets

    def velocities(self, time_s: float) -> FloatArray:
        """How fast each body moves at a time, (n_bodies, 3), in m/s."""
        later, earlier = self.offsets(time_s + _HALF_S), self.offsets(time_s - _HALF_S)
        velocities: FloatArray = (later - earlier) / (2.0 * _HALF_S)
        return velocities
