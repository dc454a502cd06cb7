"""The furniture that `furniture.yaml` describes."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dlgmd_cli.flights import pictures, textures
from dlgmd_cli.flights.bodies import SIDES, Skin, Spot, block, panel
from dlgmd_cli.flights.renderer.solids import Body, Motion, Round
from dlgmd_cli.flights.renderer.texture import Texture
from dlgmd_cli.flights.textures import Rng, Size

CATALOGUE = Path(__file__).with_name("furniture.yaml")
_PICTURES = {**vars(textures), **vars(pictures)}
# The faces of a box that can be seen.
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
    """What `furniture.yaml` has: `pieces` and what can be put `at_walls`, each by name."""
    found: dict[str, dict[str, Any]] = yaml.safe_load(CATALOGUE.read_text("utf-8"))
    return found


def furniture(name: str, rng: Rng, where: Spot, *, motion: Motion | None = None) -> list[Body]:
    """The bodies of one piece of the catalogue, none of which cuts into another.

    Each has the name of the piece that it belongs to, and all move by `motion`.
    """
    piece = catalogue()["pieces"][name]
    return _parts(piece, piece.get("name", name), rng, where, motion)


def furniture_at_wall(name: str, rng: Rng, where: Spot) -> list[Body]:
    """What the catalogue has at walls under a name, at a spot where a wall meets the floor."""
    return _parts(catalogue()["at_walls"][name], name, rng, where)


def _parts(
    entry: Mapping[str, Any], name: str, rng: Rng, where: Spot, motion: Motion | None = None
) -> list[Body]:
    """The bodies of one entry of the catalogue, in its order."""
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
            bodies.append(Round(name, middles, at.scale * radius, texture, 0.85, motion))
        else:
            bodies += _boxes(part, name, at, skins, motion)
    return bodies


def _boxes(
    part: Mapping[str, Any], name: str, where: Spot, skins: Mapping[str, Skin], motion: Any
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
    """What a skin of the catalogue looks like this time."""
    if "plain" in spec:
        return Skin(Texture(_number(spec["plain"], tones, rng)))
    size = size_m or tuple(spec["size_m"])
    looks = {"tone": _number(spec["tone"], tones, rng)} if "tone" in spec else {}
    draw = _PICTURES[spec["cut"] if "cut" in spec else spec["fill"]]
    image = draw(rng, size, spec["px_per_m"], **looks)
    return Skin(Texture(image), size if "cut" in spec else None)


def _number(spec: Any, tones: Mapping[str, float], rng: Rng) -> float:
    """A tone: given, drawn evenly from a range, or one that has a name."""
    if isinstance(spec, list):
        return float(rng.uniform(*spec))
    return tones[spec] if isinstance(spec, str) else float(spec)
