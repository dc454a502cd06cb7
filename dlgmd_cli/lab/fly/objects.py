"""The kinds of objects, as boxes, boards, cylinders and balls.

An object stands at the origin of its body, x towards the drone, z up. Lengths are in m.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dlgmd_cli.lab.fly.textures import Look

if TYPE_CHECKING:  # without MuJoCo, names can still be checked
    from dlgmd_cli.lab.fly.builder import Part

Build = Callable[["Part"], None]
Numbers = tuple[float, ...]
INDOORS, OUTDOORS = "indoors", "outdoors"


def _shade(b: "Part", low: float = 0.5, high: float = 1.0) -> float:
    return round(float(b.rng.uniform(low, high)), 2)


def _legs(b: "Part", xs: Numbers, y: float, size: Numbers, look: Look) -> None:
    """Cylinders of a radius and height that stand on the floor, on both sides."""
    radius, height = size
    for x in xs:
        for side in (-y, y):
            b.cylinder(radius, height, (x, side, height / 2), look)


def _box(b: "Part") -> None:
    side = float(b.rng.uniform(0.5, 0.8))
    b.box((side, side, side), (0, 0, 0), Look("plain", _shade(b, 0.25, 0.9)))


def _crate(b: "Part") -> None:
    side = float(b.rng.uniform(0.5, 0.9))
    look = Look(str(b.rng.choice(["wood", "poster", "patches", "concrete"])), _shade(b, 0.7))
    b.box((side, side, side), (0, 0, 0), look)


def _carton(b: "Part") -> None:
    """A carton on a stool."""
    b.box((0.4, 0.5, 0.4), (0, 0, 0.2 + 0.6), Look("cardboard", 0.85))
    b.box((0.36, 0.36, 0.04), (0, 0, 0.58), Look("wood", 0.5))
    _legs(b, (-0.14, 0.14), 0.14, (0.02, 0.56), Look("wood", 0.4))


def _chair(b: "Part") -> None:
    """A chair of one dark colour that turns its back to the drone."""
    look = Look("plain", _shade(b, 0.1, 0.25))
    b.box((0.44, 0.46, 0.05), (-0.2, 0, 0.46), look)
    b.box((0.05, 0.46, 0.5), (0, 0, 0.74), look)
    _legs(b, (-0.4, 0.0), 0.21, (0.022, 0.46), look)


def _table(b: "Part") -> None:
    b.box((0.75, 1.4, 0.04), (0, 0, 0.73), Look("wood", _shade(b)))
    for x in (-0.32, 0.32):
        for y in (-0.62, 0.62):
            b.box((0.05, 0.05, 0.71), (x, y, 0.355), Look("wood", 0.6))


def _notebook_on_table(b: "Part") -> None:
    _table(b)
    b.box((0.02, 0.40, 0.27), (0.1, 0, 0.90), Look("screen"))
    b.box((0.26, 0.40, 0.02), (0.23, 0, 0.76), Look("keys", 0.8))


def _pole(b: "Part") -> None:
    b.cylinder(float(b.rng.uniform(0.05, 0.09)), 3.4, (0, 0, 1.7), Look("concrete", 0.8))


def _pillar(b: "Part") -> None:
    side = float(b.rng.uniform(0.35, 0.55))
    look = Look(str(b.rng.choice(["concrete", "bricks", "plaster"])), _shade(b, 0.7))
    b.block((side, side, 2.9), (0, 0, 1.45), look)


def _person(b: "Part") -> None:
    """A person who faces the drone, in mid-step."""
    top, legs = Look("cloth", _shade(b, 0.4)), Look("cloth", _shade(b, 0.25, 0.6))
    skin = Look("plaster", 0.85)
    for side, step in ((0.1, 0.16), (-0.1, -0.16)):
        b.limb((0, side, 0.9), (step, side, 0.1), 0.08, legs)
        b.ball((0.14, 0.05, 0.05), (step + 0.05, side, 0.05), Look("plain", 0.2))
        arm = (-step, 1.9 * side + math.copysign(0.06, side), 0.88)
        b.limb((0, 2.2 * side, 1.4), arm, 0.05, top)
    b.ball((0.14, 0.22, 0.34), (0, 0, 1.17), top)
    b.ball((0.1, 0.09, 0.13), (0.01, 0, 1.66), skin)
    b.ball((0.11, 0.1, 0.1), (-0.03, 0, 1.72), Look("bark", 0.6))


def _board(b: "Part", side: float = 1.0) -> None:
    """A board with a gridding pattern on two feet, as wide as high."""
    b.board((side, side), (0.02, 0, 1.1), Look("grid", once=True))
    _legs(b, (-0.02,), 0.45 * side, (0.02, 1.6), Look("wood", 0.5))


def _panel(b: "Part") -> None:
    """A wider board."""
    _board(b, 1.6)


def _poster(b: "Part") -> None:
    """A stand with a poster."""
    b.board((0.9, 1.5), (0.02, 0, 1.0), Look("poster", once=True))
    b.box((0.4, 0.5, 0.03), (0, 0, 0.015), Look("plain", 0.3))
    b.cylinder(0.025, 0.6, (-0.02, 0, 0.3), Look("plain", 0.3))


def _shelf(b: "Part") -> None:
    b.box((0.32, 1.0, 2.0), (-0.16, 0, 1.0), Look("wood", _shade(b, 0.5)))
    b.board((0.96, 1.96), (0.01, 0, 1.0), Look("books", once=True))


def _cabinet(b: "Part") -> None:
    look = Look("wood", _shade(b, 0.6))
    b.box((0.45, 0.9, 1.3), (-0.2, 0, 0.65), look)
    for z in (0.25, 0.65, 1.05):
        b.box((0.02, 0.84, 0.36), (0.03, 0, z), look)
        b.box((0.03, 0.16, 0.03), (0.05, 0, z), Look("plain", 0.25))


def _ball(b: "Part") -> None:
    radius = float(b.rng.uniform(0.11, 0.18))
    b.ball((radius, radius, radius), (0, 0, 0), Look("patches"))


def _drone(b: "Part") -> None:
    """Another drone, 0.5 m wide."""
    dark = Look("plain", 0.2)
    b.box((0.22, 0.14, 0.08), (0, 0, 0), Look("patches", 0.6))
    b.ball((0.04, 0.04, 0.04), (0.11, 0, -0.03), Look("plain", 0.1))
    for turn in (45, 135, 225, 315):
        x, y = 0.22 * math.cos(math.radians(turn)), 0.22 * math.sin(math.radians(turn))
        b.box((0.22, 0.03, 0.02), (x / 2, y / 2, 0), dark, turn)
        b.cylinder(0.02, 0.06, (x, y, 0.02), dark)
        b.cylinder(0.11, 0.006, (x, y, 0.055), Look("plain", 0.5))


def _tree(b: "Part") -> None:
    height = float(b.rng.uniform(3.5, 5.5))
    b.cylinder(float(b.rng.uniform(0.12, 0.22)), height, (0, 0, height / 2), Look("bark"))
    for _ in range(7):
        x, y = b.rng.uniform(-0.9, 0.9, 2)
        size = b.rng.uniform(0.6, 1.1, 3)
        b.ball(size, (x, y, height + b.rng.uniform(-0.7, 0.9)), Look("leaves", _shade(b)))


def _bush(b: "Part") -> None:
    for _ in range(7):
        (x, y), size = b.rng.uniform(-0.35, 0.35, 2), b.rng.uniform(0.35, 0.55, 3)
        b.ball(size, (x, y, b.rng.uniform(0.3, 1.0)), Look("leaves", _shade(b, 0.6)))


def _car(b: "Part") -> None:
    """A parked car, seen from behind."""
    paint, glass = Look("plaster", _shade(b, 0.25, 0.95)), Look("plain", 0.2)
    b.box((4.2, 1.75, 0.55), (-2.1, 0, 0.6), paint)
    b.box((2.4, 1.55, 0.5), (-2.1, 0, 1.12), glass)
    b.box((2.2, 1.58, 0.05), (-2.1, 0, 1.4), paint)
    b.box((0.03, 0.5, 0.13), (0.01, 0, 0.6), Look("keys", 1.0))
    for y in (-0.75, 0.75):
        b.box((0.03, 0.2, 0.14), (0.01, y, 0.75), Look("plain", 0.45))
        for x in (-0.8, -3.4):
            b.cylinder(0.32, 0.2, (x, y, 0.32), Look("plain", 0.15), lies=True)


def _wall(b: "Part") -> None:
    """A wall across the way."""
    texture = str(b.rng.choice(["bricks", "wallpaper", "plaster", "concrete"]))
    b.board((7.0, 3.0), (0, 0, 1.5), Look(texture, _shade(b, 0.8)))
    for y in (-1.9, 0.3, 2.2):
        b.board((0.9, 1.2), (0.012, y, 1.45), Look("poster", once=True))


def _blank(b: "Part") -> None:
    """A wall of one colour across the way: nothing on it can be measured."""
    b.board((7.0, 3.0), (0, 0, 1.5), Look("plain", _shade(b, 0.8)))


@dataclass(frozen=True)
class Kind:
    """A kind of object.

    Attributes
    ----------
    build : callable
    radius_m : float
        Of the circle on the floor that holds the object.
    aim_m : (float, float)
        The heights at which a drone can hit the object; of one that is aimed at as a whole and
        does not stand, (0, 0).
    half_m : float
        Half of the width that a drone can hit.
    where : str
        "indoors", "outdoors", or both.
    is_drawn : bool
        Whether the seed may choose it.
    """

    build: Build
    radius_m: float
    aim_m: tuple[float, float]
    half_m: float
    where: str = f"{INDOORS} {OUTDOORS}"
    is_drawn: bool = True

    @property
    def stands(self) -> bool:
        """Whether the object stands on the floor."""
        return self.aim_m[1] > 0


KINDS: dict[str, Kind] = {
    "ball": Kind(_ball, 0.2, (0, 0), 0.1),
    "blank": Kind(_blank, 3.6, (0.8, 1.8), 2.0, is_drawn=False),
    "board": Kind(_board, 0.6, (0.75, 1.45), 0.45),
    "box": Kind(_box, 0.6, (0, 0), 0.25),
    "bush": Kind(_bush, 0.9, (0.8, 1.1), 0.5, OUTDOORS),
    "cabinet": Kind(_cabinet, 0.6, (0.7, 1.2), 0.4, INDOORS),
    "car": Kind(_car, 2.3, (0.8, 1.2), 0.7, OUTDOORS),
    "carton": Kind(_carton, 0.45, (0.68, 0.92), 0.22, INDOORS),
    "chair": Kind(_chair, 0.5, (0.6, 0.9), 0.2, INDOORS),
    "crate": Kind(_crate, 0.65, (0, 0), 0.25),
    "drone": Kind(_drone, 0.35, (0, 0), 0.1),
    "notebook": Kind(_notebook_on_table, 0.9, (0.94, 0.99), 0.15, INDOORS),
    "panel": Kind(_panel, 0.9, (0.5, 1.7), 0.7, is_drawn=False),
    "person": Kind(_person, 0.4, (1.0, 1.6), 0.12),
    "pillar": Kind(_pillar, 0.4, (0.8, 1.8), 0.2),
    "pole": Kind(_pole, 0.12, (0.8, 2.0), 0.1),
    "poster": Kind(_poster, 0.55, (0.8, 1.6), 0.4),
    "shelf": Kind(_shelf, 0.6, (0.7, 1.8), 0.45, INDOORS),
    "table": Kind(_table, 0.85, (0.68, 0.78), 0.5, INDOORS),
    "tree": Kind(_tree, 0.6, (0.8, 2.0), 0.1, OUTDOORS),
    "wall": Kind(_wall, 3.6, (0.8, 1.8), 2.0),
}
