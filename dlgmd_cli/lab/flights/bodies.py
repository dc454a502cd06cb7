"""The bodies that furniture is made of: boxes and flat panels in any orientation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dlgmd_cli.lab.flights.renderer.camera import FloatArray, rotation
from dlgmd_cli.lab.flights.renderer.solids import Face, Motion, Solid, quad
from dlgmd_cli.lab.flights.renderer.texture import Texture
from dlgmd_cli.lab.flights.textures import Size

SIDES = ("front", "back", "left", "right", "top", "bottom")
_ABOVE, _BELOW, _LEVEL = 1.0, 0.45, 0.72  # share of the light on faces facing up, down, sideways
_LAMP_SIDE = np.array([0.1, -0.15, 0.0])


@dataclass(frozen=True)
class Skin:
    """The texture of a face.

    A picture with a size (width and height, in m) is cut to the face, with its height along the
    longer side. A picture without a size is stretched to fill the face.
    """

    texture: Texture
    size_m: Size | None = None


@dataclass(frozen=True)
class Placement:
    """Position, orientation and scale of an object; its own axes are front (x), left (y), up (z).

    Attributes
    ----------
    at_m : ndarray, shape (3,)
        Its origin in the world.
    axes : ndarray, shape (3, 3)
        Its axes in the world, as columns; their length is the scale.
    """

    at_m: FloatArray
    axes: FloatArray

    @property
    def scale(self) -> float:
        """Scale relative to the catalogue."""
        return float(np.linalg.norm(self.axes[:, 0]))

    def world(self, points_m: npt.ArrayLike) -> FloatArray:
        """Points, (..., 3), from object to world coordinates."""
        points: FloatArray = self.at_m + np.asarray(points_m, float) @ self.axes.T
        return points

    def inside(
        self, at_m: npt.ArrayLike, yaw_deg: float = 0.0, pitch_deg: float = 0.0
    ) -> "Placement":
        """A placement given in the coordinates of this one."""
        return Placement(self.world(at_m), self.axes @ rotation(0.0, pitch_deg, yaw_deg))


def placement(at_m: Sequence[float], yaw_deg: float = 0.0, scale: float = 1.0) -> Placement:
    """A placement at (x, y) on the floor, or at (x, y, z)."""
    x, y, z = (*at_m, 0.0)[:3]
    return Placement(np.array([x, y, z], float), scale * rotation(0.0, 0.0, yaw_deg))


def block(
    name: str,
    where: Placement,
    corners_m: FloatArray,
    skins: Mapping[str, Skin],
    motion: Motion | None,
) -> Solid:
    """A box between two corners, (2, 3) in object coordinates, the lower one first.

    It has only the sides that have skins: "front" (+x), "back", "left" (+y), "right", "top" and
    "bottom". Sides that can never be seen may be left out.
    """
    (x0, y0, z0), (x1, y1, z1) = corners_m.tolist()
    dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
    # Top left corner, right and down, as seen from outside.
    frames = {
        "front": ((x1, y0, z1), (0, dy, 0), (0, 0, -dz)),
        "back": ((x0, y1, z1), (0, -dy, 0), (0, 0, -dz)),
        "left": ((x1, y1, z1), (-dx, 0, 0), (0, 0, -dz)),
        "right": ((x0, y0, z1), (dx, 0, 0), (0, 0, -dz)),
        "top": ((x0, y0, z1), (0, dy, 0), (dx, 0, 0)),
        "bottom": ((x1, y0, z0), (0, dy, 0), (-dx, 0, 0)),
    }
    faces = [_face(where, *frames[side], covered) for side, covered in skins.items()]
    return Solid(name, faces, motion)


def panel(name: str, where: Placement, size_m: Size, covered: Skin, motion: Motion | None) -> Solid:
    """An upright flat picture facing +x; its placement is at the middle of the bottom edge."""
    width, height = size_m
    face = _face(where, (0, -width / 2, height), (0, width, 0), (0, 0, -height), covered)
    return Solid(name, [face], motion)


def _face(
    where: Placement,
    origin: npt.ArrayLike,
    right: npt.ArrayLike,
    down: npt.ArrayLike,
    covered: Skin,
) -> Face:
    """A rectangular face in object coordinates with a skin, lit by lamps above."""
    at = where.world(origin)
    across, along = (where.axes @ np.asarray(side, float) for side in (right, down))
    width, height = float(np.linalg.norm(across)), float(np.linalg.norm(along))
    normal = np.cross(along, across) / (width * height)
    up = normal[2] ** 2
    most = _ABOVE if normal[2] > 0 else _BELOW
    gain = min(1.0, float((1.0 - up) * _LEVEL + up * most + _LAMP_SIDE @ normal))
    face = quad(at, across, along, covered.texture, gain)
    if covered.size_m is None:
        return face
    if width > height:
        at, across, along = at + along, -along, across
        width, height = height, width
    across = across * max(1.0, covered.size_m[0] / width)
    along = along * max(1.0, covered.size_m[1] / height)
    return Face(face.corners_m, covered.texture, at, across, along, gain)
