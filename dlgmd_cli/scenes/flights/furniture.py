"""Furniture: boxes, panels and capsules, put together as described in `furniture.yaml`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from dlgmd_cli.frame import FloatArray
from dlgmd_cli.scenes.flights import textures
from dlgmd_cli.scenes.flights.camera import rotation
from dlgmd_cli.scenes.flights.solids import Body, Capsule, Face, Motion, Solid, Texture, quad
from dlgmd_cli.scenes.flights.textures import Rng

# Visible faces of a box, by the values of `shows`.
_SHOWN = {
    "all": ("front", "back", "left", "right", "top", "bottom"),
    "standing": ("front", "back", "left", "right", "top"),
    "at a wall": ("front", "left", "right", "top"),
    "around": ("front", "back", "left", "right"),
    "between posts": ("front", "back", "top", "bottom"),
}
_MIRRORED = {
    "": ((1, 1),),
    "y": ((1, 1), (1, -1)),
    "xy": ((1, 1), (1, -1), (-1, 1), (-1, -1)),
}
_ABOVE, _BELOW, _LEVEL = 1.0, 0.45, 0.72  # share of the light on faces facing up, down, sideways
_LAMP_SIDE = np.array([0.1, -0.15, 0.0])


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

    def world(self, points_m: npt.ArrayLike) -> FloatArray:
        """Points, (..., 3), from object to world coordinates."""
        return self.at_m + np.asarray(points_m, float) @ self.axes.T


def placement(at_m: Sequence[float], yaw_deg: float = 0.0, scale: float = 1.0) -> Placement:
    """A placement at (x, y) on the floor, or at (x, y, z)."""
    return Placement(np.array((*at_m, 0.0)[:3], float), scale * rotation(0.0, 0.0, yaw_deg))


def block(
    name: str,
    where: Placement,
    corners_m: FloatArray,
    skins: Mapping[str, Texture],
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
    faces = [_face(where, covered, *frames[side]) for side, covered in skins.items()]
    return Solid(name, faces, motion)


def _face(where: Placement, texture: Texture, *lines: npt.ArrayLike) -> Face:
    """A face lit by lamps above; `lines` are its origin, right and down."""
    at = where.world(lines[0])
    across, along = (where.axes @ np.asarray(side, float) for side in lines[1:])
    width, height = float(np.linalg.norm(across)), float(np.linalg.norm(along))
    normal = np.cross(along, across) / (width * height)
    up = normal[2] ** 2
    most = _ABOVE if normal[2] > 0 else _BELOW
    gain = min(1.0, float((1.0 - up) * _LEVEL + up * most + _LAMP_SIDE @ normal))
    face = quad(at, across, along, texture, gain)
    if texture.size_m is None:
        return face
    # The image is cut, with its height along the longer side.
    if width > height:
        at, across, along = at + along, -along, across
        width, height = height, width
    across = across * max(1.0, texture.size_m[0] / width)
    along = along * max(1.0, texture.size_m[1] / height)
    return Face(face.corners_m, texture, at, across, along, gain)


@cache
def catalogue() -> dict[str, Any]:
    """The contents of `furniture.yaml`: `pieces`, and furniture `at_walls`, each by name; lists."""
    return yaml.safe_load(Path(__file__).with_name("furniture.yaml").read_text("utf-8"))


def furniture(
    name: str,
    rng: Rng,
    where: Placement,
    *,
    motion: Motion | None = None,
    group: str = "pieces",
) -> list[Body]:
    """The bodies of one entry of the catalogue, in its order, which do not intersect.

    Each has the name of its piece, and all share `motion`. Of the group `at_walls`, `where` is at
    the foot of the wall.
    """
    entry = catalogue()[group][name]
    name = entry.get("name", name)
    tones = {name: _number(spec, {}, rng) for name, spec in entry.get("tones", {}).items()}
    # A skin without a size takes that of the panel it is on.
    sizes = {part["skin"]: part["panel"] for part in entry["parts"] if "panel" in part}
    skins = {
        name: _skin({"size_m": sizes.get(name), **spec}, tones, rng)
        for name, spec in entry.get("skins", {}).items()
    }
    bodies: list[Body] = []
    for part in entry["parts"]:
        turn = rotation(0.0, part.get("pitch", 0.0), part.get("yaw", 0.0))
        at = Placement(where.world(part.get("at", (0, 0, 0))), where.axes @ turn)
        if "piece" in part:
            bodies += furniture(part["piece"], rng, at, motion=motion)
        elif "panel" in part:
            width, height = part["panel"]
            lines = (0, -width / 2, height), (0, width, 0), (0, 0, -height)
            bodies.append(Solid(name, [_face(at, skins[part["skin"]], *lines)], motion))
        elif "capsule" in part:
            *ends, radius = part["capsule"]
            middles = at.world(np.reshape(ends, (2, 3)))
            thick = float(np.linalg.norm(at.axes[:, 0])) * radius
            bodies.append(Capsule(name, middles, thick, skins[part["skin"]], 0.85, motion))
        else:
            shown = _SHOWN[part.get("shows", "all")]
            sides = {side: skins[part.get(side, part["skin"])] for side in shown}
            low, high = np.reshape(part["box"], (2, 3))
            middle, half = (low + high) / 2, (high - low) / 2
            for x, y in _MIRRORED[part.get("mirror", "")]:
                image = middle * (x, y, 1)
                corners = np.array([image - half, image + half])
                bodies.append(block(name, at, corners, sides, motion))
    return bodies


def _skin(spec: Mapping[str, Any], tones: Mapping[str, float], rng: Rng) -> Texture:
    """A skin of the catalogue with random details."""
    if "plain" in spec:
        return Texture(_number(spec["plain"], tones, rng))
    size = tuple(spec["size_m"])
    looks = {"tone": _number(spec["tone"], tones, rng)} if "tone" in spec else {}
    draw = getattr(textures, spec.get("cut") or spec["fill"])
    return Texture(draw(rng, size, spec["px_per_m"], **looks), size if "cut" in spec else None)


def _number(spec: float | str | list[float], tones: Mapping[str, float], rng: Rng) -> float:
    """A tone: a number, a uniform draw from a range, or a named tone."""
    if isinstance(spec, list):
        low, high = spec
        return float(rng.uniform(low, high))
    return tones[spec] if isinstance(spec, str) else float(spec)
