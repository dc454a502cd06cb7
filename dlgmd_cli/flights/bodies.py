"""The bodies that furniture is made of: boxes, upright prisms and flat pictures, turned anyhow."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from dlgmd_cli.flights.renderer.camera import FloatArray, rotation
from dlgmd_cli.flights.renderer.solids import Face, Motion, Solid
from dlgmd_cli.flights.renderer.texture import FloatImage, Texture
from dlgmd_cli.flights.textures import Size

Triple = tuple[float, float, float]
SIDES = ("front", "back", "left", "right", "top", "bottom")
_ABOVE, _BELOW, _LEVEL = 1.0, 0.45, 0.72  # shares of the light on what looks up, down, sideways
_LEAF_M = 0.004
_LAMP_SIDE = np.array([0.1, -0.15, 0.0])


@dataclass(frozen=True)
class Skin:
    """What a face is covered with.

    Attributes
    ----------
    texture : Texture
    size_m : (float, float) or None
        Width and height of the picture; a face shows as much of it as it has room for, the
        height along its longer side. None: the picture fills every face.
    """

    texture: Texture
    size_m: Size | None = None


def skin(image: FloatImage, size_m: Size | None = None) -> Skin:
    """A skin of a picture; see `Skin`."""
    return Skin(Texture(image), size_m)


@dataclass(frozen=True)
class Spot:
    """Where a thing stands and how it is turned: x of its own is its front, y its left, z up.

    Attributes
    ----------
    at_m : ndarray, shape (3,)
        Its own origin, in the world.
    axes : ndarray, shape (3, 3)
        Its own axes in the world, as columns; as long as it is larger than usual.
    """

    at_m: FloatArray
    axes: FloatArray

    @property
    def scale(self) -> float:
        """How many times as large as usual it is."""
        return float(np.linalg.norm(self.axes[:, 0]))

    def world(self, points_m: npt.ArrayLike) -> FloatArray:
        """Points, (..., 3), from its own axes to the world's."""
        points: FloatArray = self.at_m + np.asarray(points_m, float) @ self.axes.T
        return points

    def inside(self, at_m: npt.ArrayLike, yaw_deg: float = 0.0, pitch_deg: float = 0.0) -> "Spot":
        """A spot that is given in the axes of this one."""
        return Spot(self.world(at_m), self.axes @ rotation(0.0, pitch_deg, yaw_deg))


def spot(at_m: Sequence[float], yaw_deg: float = 0.0, scale: float = 1.0) -> Spot:
    """A spot at (x, y), on the floor, or at (x, y, z); see `Spot`."""
    x, y, z = (*at_m, 0.0)[:3]
    return Spot(np.array([x, y, z], float), scale * rotation(0.0, 0.0, yaw_deg))


def light_on(normal: FloatArray) -> float:
    """Share of the light on a face that looks along a unit vector; there are lamps above."""
    up = normal[2] ** 2
    most = _ABOVE if normal[2] > 0 else _BELOW
    return min(1.0, float((1.0 - up) * _LEVEL + up * most + _LAMP_SIDE @ normal))


def block(
    name: str,
    where: Spot,
    low_m: npt.ArrayLike,
    high_m: npt.ArrayLike,
    covered: Skin,
    *,
    sides: Sequence[str] = SIDES,
    others: Mapping[str, Skin] | None = None,
    motion: Motion | None = None,
) -> Solid:
    """A box between two corners that are given in its spot's axes.

    Parameters
    ----------
    name, motion
        See `Solid`.
    where : Spot
    low_m, high_m : array_like, shape (3,)
    covered : Skin
        On all sides that `others` does not name.
    sides : sequence of str
        The faces that it has, of "front" (along x), "back", "left" (along y), "right", "top" and
        "bottom"; what nobody can ever see may be left out.
    others : mapping of str to Skin, optional
        What is on single sides.
    """
    (x0, y0, z0), (x1, y1, z1) = np.array([low_m, high_m], float).tolist()
    dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
    # Top left corner, right and down, as somebody who looks at that side has them.
    frames = {
        "front": ((x1, y0, z1), (0, dy, 0), (0, 0, -dz)),
        "back": ((x0, y1, z1), (0, -dy, 0), (0, 0, -dz)),
        "left": ((x1, y1, z1), (-dx, 0, 0), (0, 0, -dz)),
        "right": ((x0, y0, z1), (dx, 0, 0), (0, 0, -dz)),
        "top": ((x0, y0, z1), (0, dy, 0), (dx, 0, 0)),
        "bottom": ((x1, y0, z0), (0, dy, 0), (-dx, 0, 0)),
    }
    by_side = dict.fromkeys(sides, covered) | {
        side: other for side, other in (others or {}).items() if side in sides
    }
    faces = [_face(where, *frames[side], of_side) for side, of_side in by_side.items()]
    return Solid(name, faces, motion)


def prism(
    name: str,
    where: Spot,
    rim_m: npt.ArrayLike,
    z_m: tuple[float, float],
    covered: Skin,
    *,
    capped: bool = True,
    motion: Motion | None = None,
) -> Solid:
    """An upright prism over a convex polygon, (n, 2), counter-clockwise as seen from above.

    It has no bottom, and a top only where it is `capped`.
    """
    rim = np.asarray(rim_m, float)
    low, high = z_m
    faces = []
    for start, end in zip(rim, np.roll(rim, -1, axis=0), strict=True):
        faces.append(_face(where, (*start, high), (*(end - start), 0), (0, 0, low - high), covered))
    if capped:
        (x0, y0), (x1, y1) = rim.min(axis=0), rim.max(axis=0)
        lid = _face(where, (x0, y0, high), (0, y1 - y0, 0), (x1 - x0, 0, 0), covered)
        top = where.world(np.column_stack([rim, np.full(len(rim), high)]))
        faces.append(Face(top, lid.texture, lid.origin_m, lid.right_m, lid.down_m, lid.gain))
    return Solid(name, faces, motion)


def panel(
    name: str,
    where: Spot,
    size_m: Size,
    covered: Skin,
    *,
    motion: Motion | None = None,
) -> Solid:
    """A flat upright picture that looks along x of its spot, which is the middle of its bottom."""
    width, height = size_m
    face = _face(where, (0, -width / 2, height), (0, width, 0), (0, 0, -height), covered)
    return Solid(name, [face], motion)


def leaf(name: str, where: Spot, outline_m: npt.ArrayLike, covered: Skin) -> Solid:
    """A thin convex polygon, (n, 2), on x and z of its spot; it is seen from both sides.

    Its first and its last corner are an edge that looks against x.
    """
    outline = np.asarray(outline_m, float)
    (x0, z0), (x1, z1) = outline.min(axis=0), outline.max(axis=0)
    wide, tall, thick = x1 - x0, z1 - z0, _LEAF_M / 2
    flat = np.insert(outline, 1, -thick, axis=1)
    behind = flat + np.array([0.0, _LEAF_M, 0.0])
    # The edge is a plane across the leaf: no other tells apart two leaves that cross in the sky.
    edge = np.array([flat[0], flat[-1], behind[-1], behind[0]])
    shown = (
        (flat, (x0, -thick, z1), (wide, 0, 0)),
        (behind[::-1], (x1, thick, z1), (-wide, 0, 0)),
        (edge, (x0, thick, z1), (0, -_LEAF_M, 0)),
    )
    faces = []
    for corners, origin, right in shown:
        seen = _face(where, origin, right, (0, 0, -tall), covered)
        faces.append(replace(seen, corners_m=where.world(corners)))
    return Solid(name, faces)


def ring(radius_m: float, count: int) -> FloatArray:
    """The corners of a regular polygon, counter-clockwise, for `prism`."""
    turn = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    around: FloatArray = radius_m * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    return around


def _face(
    where: Spot,
    origin: npt.ArrayLike,
    right: npt.ArrayLike,
    down: npt.ArrayLike,
    covered: Skin,
) -> Face:
    """A rectangle given in a spot's axes, lit and covered."""
    at = where.world(origin)
    across, along = (where.axes @ np.asarray(side, float) for side in (right, down))
    corners = np.array([at, at + along, at + along + across, at + across])
    width, height = float(np.linalg.norm(across)), float(np.linalg.norm(along))
    gain = light_on(np.cross(along, across) / (width * height))
    if covered.size_m is None:
        return Face(corners, covered.texture, at, across, along, gain)
    if width > height:
        at, across, along = at + along, -along, across
        width, height = height, width
    across = across * max(1.0, covered.size_m[0] / width)
    along = along * max(1.0, covered.size_m[1] / height)
    return Face(corners, covered.texture, at, across, along, gain)
