"""Things that stand about in rooms, most of them along the walls.

The functions take and give what those of `seats` do. What stands at a wall has no rear: it is at
half its depth from the wall, and its front looks along x.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from dlgmd_cli.flights.places.blocks import (
    AGAINST_WALL,
    STANDING,
    block,
    leaf,
    panel,
    prism,
    ring,
    skin,
    spot,
)
from dlgmd_cli.flights.places.fittings import cupboard_front, radiator_front
from dlgmd_cli.flights.places.materials import cloth, metal, plain, wood
from dlgmd_cli.flights.places.prints import carton_side, spines
from dlgmd_cli.flights.places.sheet import Rng, Sheet
from dlgmd_cli.flights.renderer.solids import Solid
from dlgmd_cli.flights.renderer.texture import FloatImage


def shelf(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    width_m: float = 1.0,
    height_m: float = 1.9,
    depth_m: float = 0.34,
    boards: int = 5,
    name: str = "shelf",
) -> list[Solid]:
    """A shelf with books, and a carton here and there, on its boards."""
    where = spot(at_m, yaw_deg)
    covered = skin(wood(rng, (0.4, 2.0), 300.0, rng.uniform(0.15, 0.45)), (0.4, 2.0))
    half, deep, thick = width_m / 2, depth_m / 2, 0.025
    sides = [
        block(
            name, where, (-deep, y, 0.0), (deep, y + thick, height_m), covered, sides=AGAINST_WALL
        )
        for y in (-half, half - thick)
    ]
    inner = half - thick
    back = panel(name, where.inside((0.01 - deep, 0, 0)), (2 * inner, height_m), skin(plain(0.08)))
    parts = [*sides, back]
    levels = np.linspace(0.06, height_m, boards + 1)
    # Their left ends cannot be seen, but tell them apart from those of a shelf next to this one.
    seen = ("front", "top", "bottom", "left")
    for z in levels:
        low, high = (0.05 - deep, -inner, z - thick), (deep, inner, z)
        parts.append(block(name, where, low, high, covered, sides=seen))
    for z, above in pairwise(levels):
        room = above - thick - z
        start = -inner + rng.choice([0.0, 0.0, 0.25 * width_m])
        end = inner - rng.choice([0.0, 0.0, 0.2 * width_m])
        is_carton = rng.uniform() < 0.2
        tall = 0.75 * room if is_carton else min(0.9 * room, rng.uniform(0.24, 0.32))
        drawn: Callable[..., FloatImage] = carton_side if is_carton else spines
        content = skin(drawn(rng, (end - start, tall), 500.0))
        low, high = (0.05 - deep, start, z), (deep - rng.uniform(0.02, 0.1), end, z + tall)
        plainer = dict.fromkeys(("left", "right", "top"), skin(plain(0.3)))
        parts.append(block(name, where, low, high, content, sides=AGAINST_WALL, others=plainer))
    return parts


def bookcase(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    size_m: tuple[float, float, float] = (0.32, 1.0, 1.9),
    boards: int = 5,
    name: str = "bookcase",
) -> list[Solid]:
    """Rows of books behind glass; as flat as it is, it has far fewer faces than a shelf."""
    deep, wide, high = size_m
    tone = rng.uniform(0.12, 0.4)
    covered = skin(wood(rng, (0.4, 2.0), 300.0, tone), (0.4, 2.0))
    sheet = Sheet((wide, high), 400.0, tone)
    tall = (high - 0.1) / boards
    for row in range(boards):
        books = spines(rng, (wide - 0.08, tall - 0.06), 400.0)
        # The board above keeps the light from the rear and from what stands there.
        books *= np.linspace(0.45, 1.0, len(books), dtype=np.float32)[:, None]
        sheet.stick(books, 0.04, 0.05 + row * tall)
    sheet.rectangle(0.5 * wide - 0.02, 0.0, 0.04, high, tone)
    sheet.rectangle(0.5 * wide - 0.003, 0.0, 0.006, high, 0.2 * tone)
    front = {"front": skin(sheet.finished())}
    low_m, high_m = (-deep / 2, -wide / 2, 0.0), (deep / 2, wide / 2, high)
    where = spot(at_m, yaw_deg)
    return [block(name, where, low_m, high_m, covered, sides=AGAINST_WALL, others=front)]


def cupboard(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    size_m: tuple[float, float, float] = (0.5, 1.0, 1.9),
    name: str = "cupboard",
) -> list[Solid]:
    """A cupboard with two doors and drawers, `size_m` along x, y and z."""
    deep, wide, high = size_m
    tone = rng.uniform(0.2, 0.6)
    covered = skin(wood(rng, (0.6, 2.0), 300.0, tone), (0.6, 2.0))
    front = skin(cupboard_front(rng, (wide, high), 400.0, tone))
    low_m, high_m = (-deep / 2, -wide / 2, 0.0), (deep / 2, wide / 2, high)
    where, others = spot(at_m, yaw_deg), {"front": front}
    return [block(name, where, low_m, high_m, covered, sides=AGAINST_WALL, others=others)]


def cartons(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    count: int = 4,
    name: str = "cartons",
) -> list[Solid]:
    """A stack of cartons, the upper ones a little smaller and turned a little."""
    where, parts, z = spot(at_m, yaw_deg), [], 0.0
    for number in range(count):
        width, deep = rng.uniform(0.45, 0.55) * 0.93**number, rng.uniform(0.38, 0.45) * 0.93**number
        high, tone = rng.uniform(0.25, 0.4), rng.uniform(0.22, 0.4)
        covered = skin(carton_side(rng, (width, high), 600.0, tone))
        turned = where.inside((0, 0, z), rng.uniform(-9.0, 9.0))
        low_m, high_m = (-deep / 2, -width / 2, 0.0), (deep / 2, width / 2, high)
        top = {"top": skin(plain(tone))} if number < count - 1 else {}
        parts.append(block(name, turned, low_m, high_m, covered, sides=STANDING, others=top))
        z += high
    return parts


def plant(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    height_m: float = 1.3,
    count: int = 9,
    name: str = "plant",
) -> list[Solid]:
    """A pot and long leaves that spread from its middle, each in an upright plane of its own."""
    where = spot(at_m, yaw_deg)
    pot = prism(name, where, ring(0.19, 6), (0.0, 0.34), skin(plain(rng.uniform(0.15, 0.6))))
    greens = [skin(wood(rng, (0.4, 0.9), 300.0, tone)) for tone in rng.uniform(0.05, 0.2, 3)]
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


def floor_lamp(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    height_m: float = 1.7,
    name: str = "lamp",
) -> list[Solid]:
    """A foot, a pole and a bright shade."""
    where = spot(at_m, yaw_deg)
    dark = skin(metal(rng, (0.4, 1.6), 200.0, 0.1), (0.4, 1.6))
    shade = skin(cloth(rng, (0.4, 0.3), 300.0, 0.85))
    under = height_m - 0.32
    return [
        prism(name, where, ring(0.16, 6), (0.0, 0.03), dark),
        prism(name, where, ring(0.015, 4), (0.03, under), dark, capped=False),
        prism(name, where, ring(0.2, 6), (under, height_m), shade),
    ]


def radiator(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    width_m: float = 1.2,
    name: str = "radiator",
) -> list[Solid]:
    """White ribs, a hand's breadth over the floor."""
    front = {"front": skin(radiator_front(rng, (width_m, 0.55)))}
    low_m, high_m = (-0.06, -width_m / 2, 0.12), (0.06, width_m / 2, 0.67)
    where, white = spot(at_m, yaw_deg), skin(plain(0.7))
    return [block(name, where, low_m, high_m, white, sides=AGAINST_WALL, others=front)]
