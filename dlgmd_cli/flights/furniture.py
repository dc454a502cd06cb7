"""Furniture: every piece that `furniture.yaml` describes, and those that only code can draw."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dlgmd_cli.flights import pictures, textures
from dlgmd_cli.flights.bodies import (
    SIDES,
    Skin,
    Spot,
    block,
    leaf,
    panel,
    prism,
    ring,
    skin,
)
from dlgmd_cli.flights.renderer.solids import Body, Motion, Round, Solid
from dlgmd_cli.flights.renderer.texture import FloatImage
from dlgmd_cli.flights.textures import Rng, Size, plain

CATALOGUE = Path(__file__).with_name("furniture.yaml")
PICTURES: dict[str, Callable[..., FloatImage]] = {
    made.__name__: made
    for made in (
        *(textures.brick, textures.concrete, textures.wood, textures.cloth, textures.metal),
        *(
            textures.curtain,
            textures.plaster,
            pictures.gridded,
            pictures.poster,
            pictures.whiteboard,
        ),
        *(pictures.carton_side, pictures.notebook_screen, pictures.keyboard, pictures.shirt),
        *(pictures.bookcase_front, pictures.cupboard_front, pictures.radiator_front),
        *(pictures.door_leaf, pictures.window_pane),
    )
}
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


def furniture(
    name: str,
    rng: Rng,
    where: Spot,
    *,
    detail: float = 1.0,
    motion: Motion | None = None,
) -> list[Body]:
    """The bodies of one piece of furniture.

    Parameters
    ----------
    name : str
        A piece of the catalogue, or "shelf", "cartons", "plant" or "poster".
    rng : numpy.random.Generator
        Where all that is random in it comes from.
    where : Spot
        Where it stands, how it is turned, and how large it is.
    detail : float
        Factor on the resolution of its pictures.
    motion : callable, optional
        See `Body`; of all its bodies.

    Returns
    -------
    list of Body
        None of them cuts into another; each has the name of the piece that it belongs to.

    Raises
    ------
    KeyError
        If there is no such piece.
    """
    if name in _DRAWN:
        return [*_DRAWN[name](rng, where)]
    piece = catalogue()["pieces"][name]
    return _Maker(rng, piece, piece.get("name", name), detail, motion).parts(where)


def furniture_at_wall(name: str, rng: Rng, where: Spot) -> list[Body]:
    """What the catalogue has at walls under a name, at a spot where a wall meets the floor."""
    return _Maker(rng, catalogue()["at_walls"][name], name).parts(where)


@dataclass
class _Maker:
    """Makes the bodies of one entry of the catalogue."""

    rng: Rng
    entry: Mapping[str, Any]
    name: str
    detail: float = 1.0
    motion: Motion | None = None

    def parts(self, where: Spot) -> list[Body]:
        """All of them, in the order of the catalogue."""
        side = float(self.rng.choice([-1.0, 1.0])) if self.entry.get("flips") else 1.0
        self._tones = {
            name: self._number(spec) for name, spec in self.entry.get("tones", {}).items()
        }
        parts = self.entry["parts"]
        sizes = {part["skin"]: tuple(part["panel"]) for part in parts if "panel" in part}
        self._skins = {
            name: self._skin(spec, sizes.get(name))
            for name, spec in self.entry.get("skins", {}).items()
        }
        bodies: list[Body] = []
        for part in parts:
            x, y, z = part.get("at", (0.0, 0.0, 0.0))
            at = (x, side * y, z)
            bodies += self._part(
                part, where.inside(at, part.get("yaw", 0.0), part.get("pitch", 0.0))
            )
        return bodies

    def _part(self, part: Mapping[str, Any], where: Spot) -> list[Body]:
        """The bodies of one part."""
        if "piece" in part:
            detail = self.detail * part.get("detail", 1.0)
            return furniture(part["piece"], self.rng, where, detail=detail, motion=self.motion)
        covered = self._skins[part["skin"]]
        if "panel" in part:
            return [panel(self.name, where, tuple(part["panel"]), covered, motion=self.motion)]
        if "prism" in part:
            rim, capped = ring(part["radius_m"], part["sides"]), part.get("capped", True)
            low, high = part["prism"]
            made = prism(
                self.name, where, rim, (low, high), covered, capped=capped, motion=self.motion
            )
            return [made]
        if "capsule" in part:
            ends = where.world(np.reshape(part["capsule"][:6], (2, 3)))
            radius = where.scale * part["capsule"][6]
            return [Round(self.name, ends, radius, covered.texture, 0.85, self.motion)]
        others = {side: self._skins[part[side]] for side in SIDES if side in part}
        shown, corners = _SHOWN[part.get("shows", "all")], np.reshape(part["box"], (2, 3))
        bodies: list[Body] = []
        for along_x, along_y in _MIRRORED[part.get("mirror", "")]:
            image = corners * (along_x, along_y, 1)
            low, high = image.min(axis=0), image.max(axis=0)
            bodies.append(
                block(
                    self.name,
                    where,
                    low,
                    high,
                    covered,
                    sides=shown,
                    others=others,
                    motion=self.motion,
                )
            )
        return bodies

    def _skin(self, spec: Mapping[str, Any], size_m: Size | None) -> Skin:
        """What a skin of the catalogue looks like this time."""
        if "plain" in spec:
            return skin(plain(self._number(spec["plain"])))
        if "head" in spec:
            return skin(pictures.head(self._number(spec["head"])))
        name = spec["cut"] if "cut" in spec else spec["fill"]
        if isinstance(name, list):
            name = name[int(self.rng.uniform() * len(name))]
        size = size_m or tuple(spec["size_m"])
        looks = {"tone": self._number(spec["tone"])} if "tone" in spec else {}
        image = PICTURES[name](self.rng, size, spec["px_per_m"] * self.detail, **looks)
        return skin(image, size if "cut" in spec else None)

    def _number(self, spec: Any) -> float:
        """A tone: given, drawn evenly from a range, or one that has a name."""
        if isinstance(spec, list):
            return float(self.rng.uniform(*spec))
        return self._tones[spec] if isinstance(spec, str) else float(spec)


def _shelf(rng: Rng, where: Spot) -> list[Solid]:
    """A shelf with books, and a carton here and there, on its four boards."""
    name, shown = "shelf", _SHOWN["at a wall"]
    covered = skin(textures.wood(rng, (0.4, 2.0), 300.0, rng.uniform(0.15, 0.45)), (0.4, 2.0))
    half, deep, thick, high = 0.5, 0.17, 0.025, 1.9
    inner = half - thick
    parts = [
        block(name, where, (-deep, y, 0.0), (deep, y + thick, high), covered, sides=shown)
        for y in (-half, inner)
    ]
    back = where.inside((0.01 - deep, 0, 0))
    parts.append(panel(name, back, (2 * inner, high), skin(plain(0.08))))
    levels = np.linspace(0.06, high, 5)
    # Their left ends cannot be seen, but tell them apart from those of a shelf next to this one.
    seen = ("front", "top", "bottom", "left")
    for z in levels:
        low, upper = (0.05 - deep, -inner, z - thick), (deep, inner, z)
        parts.append(block(name, where, low, upper, covered, sides=seen))
    for z, above in pairwise(levels):
        room = above - thick - z
        start = -inner + rng.choice([0.0, 0.0, 0.25])
        end = inner - rng.choice([0.0, 0.0, 0.2])
        is_carton = rng.uniform() < 0.2
        tall = 0.75 * room if is_carton else min(0.9 * room, rng.uniform(0.24, 0.32))
        drawn: Callable[..., FloatImage] = pictures.carton_side if is_carton else pictures.spines
        content = skin(drawn(rng, (end - start, tall), 500.0))
        low, upper = (0.05 - deep, start, z), (deep - rng.uniform(0.02, 0.1), end, z + tall)
        plainer = dict.fromkeys(("left", "right", "top"), skin(plain(0.3)))
        parts.append(block(name, where, low, upper, content, sides=shown, others=plainer))
    return parts


def _cartons(rng: Rng, where: Spot) -> list[Solid]:
    """A stack of two to four cartons, the upper ones a little smaller and turned a little."""
    parts: list[Solid] = []
    count, z = int(rng.integers(2, 5)), 0.0
    for number in range(count):
        width, deep = rng.uniform(0.45, 0.55) * 0.93**number, rng.uniform(0.38, 0.45) * 0.93**number
        high, tone = rng.uniform(0.25, 0.4), rng.uniform(0.22, 0.4)
        covered = skin(pictures.carton_side(rng, (width, high), 600.0, tone))
        turned = where.inside((0, 0, z), rng.uniform(-9.0, 9.0))
        low, upper = (-deep / 2, -width / 2, 0.0), (deep / 2, width / 2, high)
        top = {"top": skin(plain(tone))} if number < count - 1 else {}
        shown = _SHOWN["standing"]
        parts.append(block("cartons", turned, low, upper, covered, sides=shown, others=top))
        z += high
    return parts


def _plant(rng: Rng, where: Spot) -> list[Solid]:
    """A pot and nine long leaves that spread from its middle, each in an upright plane."""
    name, count, height_m = "plant", 9, rng.uniform(1.2, 1.6)
    pot = prism(name, where, ring(0.19, 6), (0.0, 0.34), skin(plain(rng.uniform(0.15, 0.6))))
    tones = rng.uniform(0.05, 0.2, 3)
    greens = [skin(textures.wood(rng, (0.4, 0.9), 300.0, tone)) for tone in tones]
    parts = [pot]
    for number in range(count):
        turned = where.inside((0, 0, 0.34), (number + rng.uniform(-0.15, 0.15)) * 360.0 / count)
        tall = (height_m - 0.34) * rng.uniform(0.55, 1.0)
        wide = rng.uniform(0.3, 0.47)
        outline = [
            (0.03, 0.0),
            (0.55 * wide + 0.06, 0.42 * tall),
            (wide, tall),
            (0.55 * wide - 0.07, 0.68 * tall),
            (0.03, 0.12 * tall),
        ]
        parts.append(leaf(name, turned, outline, greens[number % 3]))
    return parts


def _poster(rng: Rng, where: Spot) -> list[Solid]:
    """A poster, larger or smaller, at about the height of the eyes over its spot."""
    wide = rng.uniform(0.5, 0.8)
    size = (wide, wide * rng.uniform(0.7, 1.4))
    at = where.inside((0.0, 0.0, rng.uniform(1.0, 1.3)))
    return [panel("poster", at, size, skin(pictures.poster(rng, size, 500.0)))]


_DRAWN: dict[str, Callable[[Rng, Spot], list[Solid]]] = {
    "shelf": _shelf,
    "cartons": _cartons,
    "plant": _plant,
    "poster": _poster,
}
