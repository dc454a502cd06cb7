"""Rooms, offices and corridors; fields and streets: what stands around a flight."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dlgmd_cli.lab.fly.objects import INDOORS, KINDS, OUTDOORS
from dlgmd_cli.lab.fly.textures import FloatArray, Look

if TYPE_CHECKING:
    from dlgmd_cli.lab.fly.builder import Builder, Part

# Free space between the drone's way and the things beside it.
_BESIDE_M = 0.75
_TRIES = 60


@dataclass(frozen=True)
class Area:
    """The rectangle that a flight needs, and what has to stay free.

    Attributes
    ----------
    low, high : (float, float)
        Corners in m: x along the first heading, y to the left.
    ways : ndarray, shape (n, 2)
        Points near which nothing may stand: of the drone and of what it meets.
    slabs : tuple of (float, float)
        Ranges of x in which nothing may stand.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    ways: FloatArray
    slabs: tuple[tuple[float, float], ...] = ()

    @property
    def size(self) -> tuple[float, float]:
        """Length and width."""
        return self.high[0] - self.low[0], self.high[1] - self.low[1]

    @property
    def middle(self) -> tuple[float, float]:
        """The middle, x and y."""
        return (self.low[0] + self.high[0]) / 2, (self.low[1] + self.high[1]) / 2

    def is_free(self, x: float, y: float, radius: float, beside: float = _BESIDE_M) -> bool:
        """Whether something may stand there."""
        if any(low - radius < x < high + radius for low, high in self.slabs):
            return False
        distance = np.hypot(self.ways[:, 0] - x, self.ways[:, 1] - y)
        return bool(distance.min() > radius + beside)


class Furnisher:
    """Places objects where there is room for them."""

    def __init__(self, builder: "Builder", area: Area) -> None:
        self.builder, self.area, self.rng = builder, area, builder.rng
        self._standing: list[tuple[float, float, float]] = []

    def place(
        self, kind: str, x: float, y: float, yaw_deg: float, *, beside: float = _BESIDE_M
    ) -> bool:
        """Place an object, unless something is in the way; whether it was placed."""
        radius = KINDS[kind].radius_m
        if not self.area.is_free(x, y, radius, beside):
            return False
        if any(math.hypot(x - a, y - b) < radius + r for a, b, r in self._standing):
            return False
        self._standing.append((x, y, radius))
        height = 0.0 if KINDS[kind].stands else 0.4
        KINDS[kind].build(self.builder.part("", (x, y, height), yaw_deg))
        return True

    def scatter(
        self, kinds: Sequence[str], n: int, low: Sequence[float], high: Sequence[float]
    ) -> None:
        """Place up to `n` objects of some kinds at random within a rectangle."""
        for _ in range(_TRIES):
            x, y = self.rng.uniform(low, high)
            n -= self.place(str(self.rng.choice(kinds)), x, y, self.rng.uniform(0, 360))
            if n <= 0:
                return

    def along_walls(self, kinds: Sequence[str], share: float) -> None:
        """Furniture with its back to the walls; `share` of the places are taken."""
        (x0, y0), (x1, y1) = self.area.low, self.area.high
        long, short = np.arange(x0 + 0.8, x1 - 0.6, 1.3), np.arange(y0 + 1.4, y1 - 1.2, 1.3)
        places = [(x, y, yaw) for x in long for y, yaw in ((y0 + 0.5, 90.0), (y1 - 0.5, -90.0))]
        places += [(x, y, yaw) for y in short for x, yaw in ((x0 + 0.5, 0.0), (x1 - 0.5, 180.0))]
        for x, y, yaw in places:
            if self.rng.random() < share:
                self.place(str(self.rng.choice(kinds)), x, y, yaw, beside=0.4)


def _walls(
    builder: "Builder", area: Area, height: float, floor: Look, wall: Look, pictures: float
) -> Furnisher:
    """Floor, ceiling with lamps, four walls with skirtings, and pictures on a share of them."""
    (length, width), (x, y) = area.size, area.middle
    body = builder.part()
    body.floor((length, width), (x, y, -0.01), floor)
    body.floor((length, width), (x, y, height), Look("plaster", 0.95))
    for facing, side, out in ((0, width, length), (90, length, width),
                              (180, width, length), (270, length, width)):  # fmt: skip
        turn = math.radians(facing)
        at = (x - out / 2 * math.cos(turn), y - out / 2 * math.sin(turn))
        body.board((side, height), (*at, height / 2), wall, facing)
        skirting = (at[0] + 0.02 * math.cos(turn), at[1] + 0.02 * math.sin(turn), 0.05)
        body.board((side, 0.1), skirting, Look("wood", 0.4), facing)
    for lamp_x in np.arange(area.low[0] + 1.2, area.high[0], 2.4):
        body.box((1.2, 0.3, 0.05), (lamp_x, y, height - 0.03), Look("plain", 1.15))
    _pictures(builder, area, pictures)
    return Furnisher(builder, area)


def _pictures(builder: "Builder", area: Area, share: float) -> None:
    """Posters, windows and doors on the walls."""
    (x0, y0), (x1, y1) = area.low, area.high
    body, rng = builder.part(), builder.rng
    places = [(x, y0 + 0.02, 90.0) for x in np.arange(x0 + 1, x1 - 0.6, 1.5)]
    places += [(x, y1 - 0.02, 270.0) for x in np.arange(x0 + 1, x1 - 0.6, 1.5)]
    places += [(x1 - 0.02, y, 180.0) for y in np.arange(y0 + 1, y1 - 0.6, 1.5)]
    places += [(x0 + 0.02, y, 0.0) for y in np.arange(y0 + 1, y1 - 0.6, 1.5)]
    for x, y, facing in places:
        if rng.random() > share:
            continue
        what = rng.random()
        if what < 0.5:
            size = (float(rng.uniform(0.5, 1.0)), float(rng.uniform(0.5, 1.1)))
            body.board(size, (x, y, 1.5), Look("poster", once=True), facing)
        elif what < 0.75:  # a window
            body.board((1.1, 1.2), (x, y, 1.6), Look("plain", 0.5), facing)
            turn = math.radians(facing)
            x, y = x + 0.02 * math.cos(turn), y + 0.02 * math.sin(turn)
            body.board((1.0, 1.1), (x, y, 1.6), Look("leaves", 1.6, once=True), facing)
        else:  # a door
            body.board((0.9, 2.0), (x, y, 1.0), Look("wood", 0.55, once=True), facing)


_FLOORS, _WALLS = ("parquet", "carpet", "tiles"), ("plaster", "wallpaper", "bricks", "concrete")
_FURNITURE = ("cabinet", "shelf", "table", "chair", "carton", "notebook", "poster")


def room(builder: "Builder", area: Area) -> None:
    """A cluttered room: furniture along the walls and beside the way, pictures on the walls."""
    rng, height = builder.rng, float(builder.rng.uniform(2.5, 3.0))
    floor, wall = str(rng.choice(_FLOORS)), str(rng.choice(_WALLS))
    look = Look(wall, float(rng.uniform(0.8, 1.0)))
    furnisher = _walls(builder, area, height, Look(floor, 0.9), look, 0.55)
    furnisher.along_walls(_FURNITURE, 0.75)
    furnisher.scatter(("chair", "carton", "crate", "box", "poster"), 8, area.low, area.high)
    builder.lamps(area.middle, max(area.size), height)


def simple(builder: "Builder", area: Area) -> None:
    """A room with bare walls and little in it."""
    furnisher = _walls(builder, area, 2.9, Look("carpet"), Look("plaster", 0.95), 0.2)
    furnisher.along_walls(("cabinet", "chair", "table"), 0.15)
    builder.lamps(area.middle, max(area.size), 2.9)


def office(builder: "Builder", area: Area) -> None:
    """Desks with notebook computers, chairs, shelves, pillars."""
    furnisher = _walls(builder, area, 2.8, Look("carpet", 0.9), Look("plaster", 0.95), 0.45)
    for x in np.arange(area.low[0] + 1.2, area.high[0] - 0.8, 2.2):
        for y in np.arange(area.low[1] + 1.0, area.high[1] - 0.8, 1.9):
            yaw = 90.0 if builder.rng.random() < 0.5 else -90.0
            if furnisher.place("notebook", x, y, yaw, beside=0.35):
                furnisher.place("chair", x, y + math.copysign(1.0, yaw), 180.0 - yaw, beside=0.3)
    furnisher.along_walls(("shelf", "cabinet", "poster"), 0.7)
    furnisher.scatter(("pillar", "carton"), 4, area.low, area.high)
    builder.lamps(area.middle, max(area.size), 2.8)


def corridor(builder: "Builder", area: Area) -> None:
    """A narrow corridor with doors and boards."""
    half = float(builder.rng.uniform(1.1, 1.5))
    narrow = Area((area.low[0], -half), (area.high[0], half), area.ways, area.slabs)
    wall, floor = str(builder.rng.choice(_WALLS)), str(builder.rng.choice(_FLOORS))
    furnisher = _walls(builder, narrow, 2.5, Look(floor), Look(wall, 0.9), 0.8)
    furnisher.along_walls(("chair", "carton", "poster"), 0.3)
    builder.lamps(area.middle, max(area.size), 2.5)


def _open_air(builder: "Builder", area: Area, texture: str, beyond_m: float) -> None:
    """A sky, and the ground."""
    builder.sky()
    body, (x, y) = builder.part(), area.middle
    size = (area.size[0] + 2 * beyond_m, area.size[1] + 2 * beyond_m)
    body.floor(size, (x, y, -0.01), Look(texture))


def field(builder: "Builder", area: Area) -> None:
    """A meadow with trees, bushes and benches, in front of a wood."""
    _open_air(builder, area, "grass", 60.0)
    (x0, y0), (x1, y1), (x, y) = area.low, area.high, area.middle
    body, rng = builder.part(), builder.rng
    far = float(rng.uniform(22, 35)) + max(area.size) / 2
    for facing in range(0, 360, 45):
        turn = math.radians(facing)
        at = (x - far * math.cos(turn), y - far * math.sin(turn), 4.0)
        body.board((far * 0.9, 8.0), at, Look("leaves", 0.8), facing)
    furnisher = Furnisher(builder, area)
    furnisher.scatter(("tree", "bush", "pole"), 8, (x0 - 2, y0 - 3), (x1 + 3, y1 + 3))
    furnisher.scatter(("tree", "bush"), 8, (x0 - 5, y0 - 12), (x1 + 14, y1 + 12))


def street(builder: "Builder", area: Area) -> None:
    """A street between houses, with parked cars, trees and lamp posts."""
    _open_air(builder, area, "asphalt", 50.0)
    (x0, y0), (x1, y1), (x, _) = area.low, area.high, area.middle
    body, rng = builder.part(), builder.rng
    length = area.size[0] + 70.0
    for side, edge in ((1.0, max(y1, 3.2)), (-1.0, min(y0, -3.2))):
        body.floor((length, 4.0), (x, edge + side * 2.0, 0.06), Look("paving"))
        texture = str(rng.choice(["facade", "bricks"]))
        for number in range(7):
            at = x - length / 2 + (number + 0.5) * length / 7
            height = float(rng.uniform(7, 13))
            size = (length / 7, float(rng.uniform(2.0, 3.5)), height)
            look = Look("facade" if number % 3 else texture, float(rng.uniform(0.7, 1.0)))
            body.block(size, (at, edge + side * 5.5, height / 2), look)
    for end in (x - length / 2, x + length / 2):
        body.block((2.0, 30.0, 11.0), (end, 0, 5.5), Look("facade", 0.8))
    furnisher = Furnisher(builder, area)
    for edge in (max(y1, 3.2) - 1.1, min(y0, -3.2) + 1.1):
        for at in np.arange(x0 - 6, x1 + 14, 6.0):
            if rng.random() < 0.5:
                furnisher.place("car", at, edge, 180.0 * rng.integers(2))
    outside = (x0 - 4, min(y0, -3.2) - 2.5), (x1 + 10, max(y1, 3.2) + 2.5)
    furnisher.scatter(("tree", "pole", "bush", "poster"), 8, *outside)


WORLDS: dict[str, Callable[["Builder", Area], None]] = {
    "room": room,
    "simple": simple,
    "office": office,
    "corridor": corridor,
    "field": field,
    "street": street,
}
# Worlds by what --environment takes.
ENVIRONMENTS = {INDOORS: ("room", "office", "corridor", "simple"), OUTDOORS: ("field", "street")}


def environment_of(world: str) -> str:
    """Indoors or outdoors."""
    return INDOORS if world in ENVIRONMENTS[INDOORS] else OUTDOORS


def doorway(body: "Part", world: str) -> None:
    """A wall across the way with a doorway 1 m wide."""
    is_inside = environment_of(world) == INDOORS
    half, top, height = 0.5, 2.05, 3.0 if is_inside else 2.5
    textures = ("plaster", "wallpaper") if is_inside else ("bricks",)
    look = Look(str(body.rng.choice(textures)), 0.85)
    side = 7.0 - half
    for sign in (1, -1):
        body.board((side, height), (0, sign * (half + side / 2), height / 2), look)
        body.box((0.14, 0.08, top), (0, sign * half, top / 2), Look("wood", 0.45))
        body.board((0.8, 1.0), (0.02, sign * 1.6, 1.45), Look("poster", once=True))
    body.board((2 * half, height - top), (0, 0, (height + top) / 2), look)
    body.box((0.14, 2 * half, 0.08), (0, 0, top), Look("wood", 0.45))
