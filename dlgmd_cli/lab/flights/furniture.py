"""Building the furniture described in `furniture.yaml`."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dlgmd_cli.lab.flights import pictures, textures
from dlgmd_cli.lab.flights.bodies import SIDES, Placement, Skin, block, panel
from dlgmd_cli.lab.flights.renderer.solids import Body, Capsule, Motion
from dlgmd_cli.lab.flights.renderer.texture import Texture
from dlgmd_cli.lab.flights.textures import Rng, Size

CATALOGUE = Path(__file__).with_name("furniture.yaml")
_PICTURES = {**vars(textures), **vars(pictures)}
# Visible faces of a box, by the values of `shows`.
_SHOWN = {
    "all": SIDES,
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


@cache
def catalogue() -> dict[str, dict[str, Any]]:
    """The contents of `furniture.yaml`: `pieces`, and furniture `at_walls`, each by name."""
    found: dict[str, dict[str, Any]] = yaml.safe_load(CATALOGUE.read_text("utf-8"))
    return found


def furniture(name: str, rng: Rng, where: Placement, *, motion: Motion | None = None) -> list[Body]:
    """The bodies of one piece of the catalogue, which do not intersect.

    Each has the name of its piece, and all share `motion`.
    """
    piece = catalogue()["pieces"][name]
    return _parts(piece, piece.get("name", name), rng, where, motion)


def furniture_at_wall(name: str, rng: Rng, where: Placement) -> list[Body]:
    """The bodies of an `at_walls` entry; `where` is at the foot of the wall."""
    return _parts(catalogue()["at_walls"][name], name, rng, where)


def _parts(
    entry: Mapping[str, Any], name: str, rng: Rng, where: Placement, motion: Motion | None = None
) -> list[Body]:
    """The bodies of a catalogue entry, in its order."""
    tones = {name: _number(spec, {}, rng) for name, spec in entry.get("tones", {}).items()}
    parts = entry["parts"]
    sizes = {part["skin"]: tuple(part["panel"]) for part in parts if "panel" in part}
    skins = {
        name: _skin(spec, sizes.get(name), tones, rng)
        for name, spec in entry.get("skins", {}).items()
    }
    bodies: list[Body] = []
    for part in parts:
        at = where.inside(part.get("at", (0, 0, 0)), part.get("yaw", 0.0), part.get("pitch", 0.0))
        if "piece" in part:
            bodies += furniture(part["piece"], rng, at, motion=motion)
        elif "panel" in part:
            bodies.append(panel(name, at, tuple(part["panel"]), skins[part["skin"]], motion))
        elif "capsule" in part:
            *ends, radius = part["capsule"]
            texture = skins[part["skin"]].texture
            middles = at.world(np.reshape(ends, (2, 3)))
            bodies.append(Capsule(name, middles, at.scale * radius, texture, 0.85, motion))
        else:
            bodies += _boxes(part, name, at, skins, motion)
    return bodies


def _boxes(
    part: Mapping[str, Any], name: str, where: Placement, skins: Mapping[str, Skin], motion: Any
) -> list[Body]:
    """A box and its mirror images."""
    sides = {side: skins[part.get(side, part["skin"])] for side in _SHOWN[part.get("shows", "all")]}
    low, high = np.reshape(part["box"], (2, 3))
    middle, half = (low + high) / 2, (high - low) / 2
    middles = [middle * (x, y, 1) for x, y in _MIRRORED[part.get("mirror", "")]]
    return [block(name, where, np.array([m - half, m + half]), sides, motion) for m in middles]


def _skin(
    spec: Mapping[str, Any], size_m: Size | None, tones: Mapping[str, float], rng: Rng
) -> Skin:
    """A skin of the catalogue with random details."""
    if "plain" in spec:
        return Skin(Texture(_number(spec["plain"], tones, rng)))
    size = size_m or tuple(spec["size_m"])
    looks = {"tone": _number(spec["tone"], tones, rng)} if "tone" in spec else {}
    draw = _PICTURES[spec["cut"] if "cut" in spec else spec["fill"]]
    image = draw(rng, size, spec["px_per_m"], **looks)
    return Skin(Texture(image), size if "cut" in spec else None)


def _number(spec: Any, tones: Mapping[str, float], rng: Rng) -> float:
    """A tone: a number, a uniform draw from a range, or a named tone."""
    if isinstance(spec, list):
        return float(rng.uniform(*spec))
    return tones[spec] if isinstance(spec, str) else float(spec)
