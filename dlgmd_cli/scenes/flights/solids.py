"""The contents of a world: textured convex solids, balls and capsules.

A texture is sampled by its exact homography, at the size at which it appears: smaller copies of it
(mipmaps) prevent flicker in the distance.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import FloatArray, FloatImage

IntArray = npt.NDArray[np.intp]
# Displacement of a body, (3,) in m, at a time in s.
Motion = Callable[[float], npt.ArrayLike]
# Left, top, right and bottom of a part of the image, in px; the last two are excluded.
Window = tuple[int, int, int, int]

# Padding: OpenCV is ten times slower at sampling outside an image than inside.
_MARGIN = 4
# Weight of foreshortening in the choice of the texture size. With 0 the texture would be aliased in
# one direction, with 1 it would be blurred in the other.
_FORESHORTENING = 0.75
# A texture is sampled finer than the pixels by this power of two. This makes up for the blur of
# interpolation between texels, and agrees with the mean over each pixel.
_SHARPENING = 0.5
# A 1 / depth, in 1/m, that counts as infinitely far away.
_VANISHING = 1e-9
# Step of the central difference that gives a body's velocity.
_HALF_S = 1e-4


class Texture:
    """Reflectance over a rectangle, (h, w) float32 in 0..1, linear in light.

    A single number is a plain colour. An image with a size (width and height, in m) is cut to a
    face, see `furniture`; one without is stretched to fill it.
    """

    def __init__(self, image: npt.ArrayLike, size_m: tuple[float, float] | None = None) -> None:
        self.image: FloatImage = np.ascontiguousarray(np.atleast_2d(image), np.float32)
        self.size_m = size_m

    @cached_property
    def mean(self) -> float:
        """Mean reflectance."""
        return float(self.image.mean())

    @cached_property
    def levels(self) -> tuple[FloatImage, ...]:
        """The image and its copies at 1/2, 1/4, … of its size, down to a single pixel.

        Each is padded with `_MARGIN` copies of its edge pixels.
        """
        levels = [self.image]
        while max(levels[-1].shape) > 1:
            height, width = ((side + 1) // 2 for side in levels[-1].shape)
            small: FloatImage = np.asarray(
                cv2.resize(levels[-1], (width, height), interpolation=cv2.INTER_AREA), np.float32
            )
            levels.append(small.reshape(height, width))
        return tuple(np.pad(level, _MARGIN, mode="edge") for level in levels)


class Shade(Texture):
    """A shadow: the share of the light that passes; what lies behind it is multiplied by it."""


@dataclass(frozen=True)
class Outline:
    """A convex polygon in the image, and the textured plane that it shows.

    Attributes
    ----------
    corners_xy : ndarray, shape (n, 2)
        In px, clockwise on the screen.
    plane : ndarray, shape (3,)
        1 / depth at the point (x, y) of the image is ``plane @ (x, y, 1)``, in 1/m.
    distance_m : float
        Distance from the camera to the plane.
    texture_from_xy : ndarray, shape (3, 3)
        Homography from (x, y, 1) to texture coordinates in 0..1.
    texels_per_m : float
        Resolution of the texture along its finer side.
    texture : Texture
    gain : float
        Share of the light that reaches the plane.
    """

    corners_xy: FloatArray
    plane: FloatArray
    distance_m: float
    texture_from_xy: FloatArray
    texels_per_m: float
    texture: Texture
    gain: float

    def sample(self, window: Window, focal_px: float) -> FloatImage:
        """The projected texture in a window, without `gain`: (h, w) float32.

        Adjacent texture sizes are blended by 1 / depth, so that neither ends abruptly.
        """
        levels = self.texture.levels
        left, top, right, bottom = window
        shape = bottom - top, right - left
        if len(levels) == 1:
            return np.full(shape, self.texture.mean, np.float32)
        finest, coarsest = self._sizes_in(window, focal_px)
        picture = self._warped(window, coarsest)
        for size in range(coarsest - 1, finest - 1, -1):
            finer = self._warped(window, size)
            finer -= picture
            finer *= self._share_of_finer(window, size, focal_px)
            picture += finer
        # On the horizon of the plane, zero times infinity gives NaN.
        cv2.patchNaNs(picture, self.texture.mean)
        return picture

    def _warped(self, window: Window, size: int) -> FloatImage:
        """The projection of one texture size in a window."""
        left, top, right, bottom = window
        level = self.texture.levels[size]
        height, width = (side - 2 * _MARGIN for side in level.shape)
        shift = _MARGIN - 0.5
        texel = np.array([[width, 0.0, shift], [0.0, height, shift], [0.0, 0.0, 1.0]])
        to_window = np.array([[1.0, 0.0, left + 0.5], [0.0, 1.0, top + 0.5], [0.0, 0.0, 1.0]])
        return np.asarray(
            cv2.warpPerspective(
                level,
                texel @ self.texture_from_xy @ to_window,
                (right - left, bottom - top),
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=self.texture.mean,
            ),
            np.float32,
        )

    def _sizes_in(self, window: Window, focal_px: float) -> tuple[int, int]:
        """The finest and the coarsest texture size that a window needs."""
        left, top, right, bottom = window
        a, b, c = self.plane
        at_corners = self.corners_xy @ self.plane[:2] + c
        least, most = max(float(at_corners.min()), _VANISHING), max(at_corners.max(), _VANISHING)
        farthest = max(least, c + min(a * left, a * right) + min(b * top, b * bottom))
        nearest = max(least, min(most, c + max(a * left, a * right) + max(b * top, b * bottom)))
        last = len(self.texture.levels) - 1
        finest = min(max(math.floor(self._size(nearest, focal_px)), 0), last)
        coarsest = math.ceil(self._size(min(farthest, nearest), focal_px))
        return finest, min(max(coarsest, finest), last)

    def _share_of_finer(self, window: Window, size: int, focal_px: float) -> FloatImage:
        """Weight of texture size `size` in the blend with the next coarser one, 0..1."""
        left, top, right, bottom = window
        whole, none = self._closeness(size, focal_px), self._closeness(size + 1, focal_px)
        a, b, c = self.plane / (whole - none)
        c -= none / (whole - none)
        x, y = np.arange(left + 0.5, right), np.arange(top + 0.5, bottom)
        share: FloatImage = np.add.outer((b * y + c).astype(np.float32), (a * x).astype(np.float32))
        return np.clip(share, 0.0, 1.0, out=share)

    def _size(self, closeness: float, focal_px: float) -> float:
        """Texture size at a given 1 / depth, as log2 of the reduction."""
        per_pixel = self.texels_per_m / (focal_px * closeness)
        slant = max(1.0, 1.0 / (closeness * self.distance_m))
        return math.log2(per_pixel) + _FORESHORTENING * math.log2(slant) - _SHARPENING

    def _closeness(self, size: float, focal_px: float) -> float:
        """1 / depth at which `_size` is `size`: the inverse function."""
        facing = self.texels_per_m / (focal_px * 2.0 ** (size + _SHARPENING))
        if facing * self.distance_m >= 1.0:
            return facing
        slanted = facing * self.distance_m**-_FORESHORTENING
        return float(slanted ** (1.0 / (1.0 + _FORESHORTENING)))


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
        first, second, third = self.corners_m[:3]
        across: FloatArray = np.cross(second - first, third - first)
        return across / math.sqrt(across @ across)

    @cached_property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the rectangle."""
        return float(np.linalg.norm(self.right_m)), float(np.linalg.norm(self.down_m))

    @cached_property
    def texels_per_m(self) -> float:
        """Resolution of the texture along its finer side."""
        n_rows, n_columns = self.texture.image.shape
        right, down = np.sqrt((np.array([self.right_m, self.down_m]) ** 2).sum(axis=1))
        return max(n_columns / right, n_rows / down)

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
        return (directions @ self.corners_m.T).max(axis=-1)

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

    # It has no faces.
    normals = np.empty((0, 3))

    def reach(self, directions: FloatArray) -> FloatArray:
        """See `Solid.reach`."""
        return (directions @ self.ends_m.T).max(axis=-1) + self.radius_m

    def moved(self, by_m: FloatArray) -> "Capsule":
        """The same capsule elsewhere, at rest."""
        return replace(self, ends_m=self.ends_m + by_m, motion=None)


Body = Solid | Capsule


def box_of(body: Body) -> FloatArray:
    """The least and the greatest coordinates of a body, (2, 3) in m."""
    axes = np.eye(3)
    return np.array([-body.reach(-axes), body.reach(axes)])


@dataclass(frozen=True)
class World:
    """A room, whose faces face inwards, and convex bodies in it that do not intersect.

    `light` is the brightness at a time in s; 1 is normal. `shadows` lie on the room's faces, have a
    `Shade` as their texture, and darken the room, but not the bodies in it.
    """

    room: Solid
    bodies: Sequence[Body] = ()
    light: Callable[[float], float] = lambda _: 1.0
    shadows: Sequence[Solid] = ()


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
    normals, origins_m : ndarray, shape (n_faces, 3)
    capsules : list of Capsule
    ends_m, radii_m : ndarray, shape (n_capsules, 2, 3) and (n_capsules,)
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        self._n_bodies = len(bodies)
        solids = [(i, body) for i, body in enumerate(bodies) if isinstance(body, Solid)]
        capsules = [(i, body) for i, body in enumerate(bodies) if isinstance(body, Capsule)]
        self.faces = [face for _, solid in solids for face in solid.faces]
        self.face_body: IntArray = np.array([i for i, body in solids for _ in body.faces], np.intp)
        most = max((len(face.corners_m) for face in self.faces), default=3)
        each = np.arange(most)
        padded = [face.corners_m[np.minimum(each, len(face.corners_m) - 1)] for face in self.faces]
        self.corners_m = np.array(padded).reshape(-1, most, 3)
        self.normals = np.array([face.normal for face in self.faces]).reshape(-1, 3)
        self.origins_m = np.array([face.origin_m for face in self.faces]).reshape(-1, 3)
        self.capsules = [body for _, body in capsules]
        self.capsule_body: IntArray = np.array([i for i, _ in capsules], np.intp)
        self.ends_m = np.array([each.ends_m for each in self.capsules], float).reshape(-1, 2, 3)
        self.radii_m = np.array([each.radius_m for each in self.capsules], float)
        self._motions = [(i, body.motion) for i, body in enumerate(bodies) if body.motion]

    @cached_property
    def shares(self) -> FloatArray:
        """Of each face, the map from a point to its coordinates along the sides of the texture."""
        sides = [np.array([face.right_m, face.down_m]) for face in self.faces]
        return np.array([np.linalg.pinv(pair).T for pair in sides]).reshape(-1, 2, 3)

    def offsets(self, time_s: float) -> FloatArray:
        """Displacement of each body at a time, (n_bodies, 3), in m."""
        offsets = np.zeros((self._n_bodies, 3))
        for index, motion in self._motions:
            offsets[index] = motion(time_s)
        return offsets

    def velocities(self, time_s: float) -> FloatArray:
        """Velocity of each body at a time, (n_bodies, 3), in m/s."""
        later, earlier = self.offsets(time_s + _HALF_S), self.offsets(time_s - _HALF_S)
        return (later - earlier) / (2.0 * _HALF_S)
