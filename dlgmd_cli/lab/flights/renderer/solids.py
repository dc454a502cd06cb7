"""The contents of a world: convex solids with textured planar faces, balls and capsules."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from dlgmd_cli.lab.flights.renderer.camera import FloatArray
from dlgmd_cli.lab.flights.renderer.texture import Texture

IntArray = npt.NDArray[np.intp]
# Displacement of a body, (3,) in m, at a time in s.
Motion = Callable[[float], npt.ArrayLike]

# Step of the central difference that gives a body's velocity.
_HALF_S = 1e-4


@dataclass(frozen=True)
class Face:
    """A convex planar polygon with a texture, visible from its front only.

    Attributes
    ----------
    corners_m : ndarray, shape (n, 3)
        Counter-clockwise as seen from the front.
    texture : Texture
        Its image fills the rectangle at `origin_m` with the sides `right_m` and `down_m`, which
        contains all corners.
    origin_m, right_m, down_m : ndarray, shape (3,)
        Top left corner of the image, and its sides along the width and the height.
    gain : float
        Share of the light that reaches the face.
    """

    corners_m: FloatArray
    texture: Texture
    origin_m: FloatArray
    right_m: FloatArray
    down_m: FloatArray
    gain: float = 1.0

    @cached_property
    def normal(self) -> FloatArray:
        """Unit normal, pointing out of the front."""
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
    """A rectangular face filled by its texture; see `Face` for the corner and the sides."""
    origin, right, down = (np.asarray(each, float) for each in (origin_m, right_m, down_m))
    corners = np.array([origin, origin + down, origin + down + right, origin + right])
    return Face(corners, texture, origin, right, down, gain)


@dataclass(frozen=True)
class Solid:
    """A convex body with planar faces that face outwards, or a single face.

    Several bodies can share a name, such as "chair"; `motion` is None for a body at rest.
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
        """Greatest coordinate along unit vectors, (n, 3): (n,) in m."""
        farthest: FloatArray = (directions @ self.corners_m.T).max(axis=-1)
        return farthest

    def moved(self, by_m: FloatArray) -> "Solid":
        """The same solid elsewhere, at rest."""
        return Solid(self.name, [face.moved(by_m) for face in self.faces])


@dataclass(frozen=True)
class Capsule:
    """A capsule: all points within `radius_m` of the segment between `ends_m`, (2, 3).

    If both ends are the same point, it is a ball. The texture shows the capsule from the side at a
    large distance. Its height is the length from tip to tip, its bottom is at the first end, and
    its width is twice the radius.
    """

    name: str
    ends_m: FloatArray
    radius_m: float
    texture: Texture
    gain: float = 1.0
    motion: Motion | None = None

    @property
    def normals(self) -> FloatArray:
        """Empty, (0, 3): it has no faces."""
        return np.empty((0, 3))

    def reach(self, directions: FloatArray) -> FloatArray:
        """See `Solid.reach`."""
        farthest: FloatArray = (directions @ self.ends_m.T).max(axis=-1) + self.radius_m
        return farthest

    def moved(self, by_m: FloatArray) -> "Capsule":
        """The same capsule elsewhere, at rest."""
        return replace(self, ends_m=self.ends_m + by_m, motion=None)


Body = Solid | Capsule


@dataclass(frozen=True)
class World:
    """A room, whose faces face inwards, and convex bodies in it that do not intersect.

    `light` is the brightness at a time in s; 1 is normal.
    """

    room: Solid
    bodies: Sequence[Body] = ()
    light: Callable[[float], float] = lambda _: 1.0


class Surfaces:
    """The surfaces of bodies as arrays, at their positions before any motion.

    Attributes
    ----------
    faces : list of Face
        The faces of all solids, solid by solid.
    face_body, capsule_body : ndarray, shape (n_faces,) and (n_capsules,)
        Index of the body of each face and capsule.
    corners_m : ndarray, shape (n_faces, n_corners, 3)
        Faces with fewer corners repeat their last one.
    normals : ndarray, shape (n_faces, 3)
    capsules : list of Capsule
    ends_m, radii_m : ndarray, shape (n_capsules, 2, 3) and (n_capsules,)
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
        self.capsules = [body for body in bodies if isinstance(body, Capsule)]
        self.capsule_body: IntArray = np.array(
            [i for i, body in enumerate(bodies) if isinstance(body, Capsule)], np.intp
        )
        self.ends_m = np.array([each.ends_m for each in self.capsules], float).reshape(-1, 2, 3)
        self.radii_m = np.array([each.radius_m for each in self.capsules], float)
        self._motions = [(i, body.motion) for i, body in enumerate(bodies) if body.motion]

    def offsets(self, time_s: float) -> FloatArray:
        """Displacement of each body at a time, (n_bodies, 3), in m."""
        offsets = np.zeros((len(self.bodies), 3))
        for index, motion in self._motions:
            offsets[index] = motion(time_s)
        return offsets

    def velocities(self, time_s: float) -> FloatArray:
        """Velocity of each body at a time, (n_bodies, 3), in m/s."""
        later, earlier = self.offsets(time_s + _HALF_S), self.offsets(time_s - _HALF_S)
        velocities: FloatArray = (later - earlier) / (2.0 * _HALF_S)
        return velocities
