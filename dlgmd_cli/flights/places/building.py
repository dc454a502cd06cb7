"""Parts of buildings: pillars, a wall with a doorway, and what hangs on walls.

The functions take and give what those of `seats` do, but what hangs on a wall is told by a spot
on it, which is the middle of its lower edge; see `Hall.on`.
"""

from collections.abc import Sequence

import numpy as np

from dlgmd_cli.flights.places.blocks import AROUND, Spot, block, panel, prism, ring, skin, spot
from dlgmd_cli.flights.places.fittings import door_leaf, window_pane
from dlgmd_cli.flights.places.materials import brick, concrete, curtain, plaster, wood
from dlgmd_cli.flights.places.prints import poster, whiteboard
from dlgmd_cli.flights.places.shade import Wall, shaded
from dlgmd_cli.flights.places.sheet import Rng, Sheet, Size
from dlgmd_cli.flights.renderer.solids import Solid
from dlgmd_cli.flights.renderer.texture import FloatImage


def pillar(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    width_m: float = 0.4,
    height_m: float = 2.8,
    is_round: bool = False,
    name: str = "pillar",
) -> list[Solid]:
    """A square pillar of brick or concrete, or a round one of twelve faces."""
    where, half = spot(at_m, yaw_deg), width_m / 2
    if is_round:
        strip = (0.28 * width_m, height_m)
        covered = skin(concrete(rng, strip, 400.0, 0.5))
        return [prism(name, where, ring(half, 12), (0.0, height_m), covered, capped=False)]
    made = brick if rng.uniform() < 0.5 else concrete
    covered = skin(made(rng, (width_m, height_m), 800.0))
    low, high = (-half, -half, 0.0), (half, half, height_m)
    return [block(name, where, low, high, covered, sides=AROUND)]


def partition(
    rng: Rng,
    x_m: float,
    size_m: Size,
    *,
    opening_m: Size = (1.1, 2.1),
    at_y_m: float = 0.0,
    thick_m: float = 0.15,
    tone: float = 0.5,
    name: str = "doorway",
) -> list[Solid]:
    """A wall across a room, with a doorway in it: what is left of it, right of it and above it.

    Parameters
    ----------
    x_m : float
        Where its near side is; it looks against x.
    size_m : (float, float)
        Width and height of the room; the wall reaches from y = -width/2 to width/2.
    opening_m : (float, float)
        Width and height of the doorway.
    at_y_m : float
        The middle of the doorway.
    """
    width, height = size_m
    sheet = Sheet(size_m, 300.0, tone)
    sheet.image = plaster(rng, size_m, 300.0, tone)
    left, right, top = at_y_m + opening_m[0] / 2, at_y_m - opening_m[0] / 2, opening_m[1]
    casing = 0.09
    # As seen from the near side, y runs to the left.
    start, end = width / 2 - left, width / 2 - right
    sheet.rectangle(0.0, height - 0.08, width, 0.08, 0.22)
    # Posts up to the ceiling: where the parts of the wall meet there is an edge in any case.
    for x in (start - casing, end):
        sheet.rectangle(x, 0.0, casing, height, 0.2)
        sheet.rectangle(x, 0.0, 0.012, height, 0.1)
    sheet.rectangle(start, height - top - casing, end - start, casing, 0.2)
    seen = Wall(np.zeros(3), np.array([width, 0.0, 0.0]), np.array([0.0, 0.0, -height]))
    picture = shaded(sheet.finished(), seen, ())
    frame = skin(wood(rng, (0.2, 2.2), 300.0, 0.2), (0.2, 2.2))

    def part(y: tuple[float, float], z: tuple[float, float], sides: Sequence[str]) -> Solid:
        """One of the three, with its piece of the picture."""
        columns = [round((width / 2 - each) * sheet.scale) for each in (y[1], y[0])]
        rows = [round((height - each) * sheet.scale) for each in (z[1], z[0])]
        piece = picture[rows[0] : rows[1], columns[0] : columns[1]]
        faced = {"back": skin(piece), "front": skin(piece[:, ::-1])}
        low, high = (0.0, y[0], z[0]), (thick_m, y[1], z[1])
        at = spot((x_m, 0.0))
        return block(name, at, low, high, frame, sides=sides, others=faced)

    return [
        part((left, width / 2), (0.0, height), ("front", "back", "right")),
        part((-width / 2, right), (0.0, height), ("front", "back", "left")),
        part((right, left), (top, height), ("front", "back", "bottom")),
    ]


def hung(where: Spot, picture: FloatImage, size_m: Size, name: str) -> list[Solid]:
    """Any flat picture on a wall."""
    return [panel(name, where, size_m, skin(picture))]


def door(rng: Rng, where: Spot, *, name: str = "door") -> list[Solid]:
    """A closed door in its frame, 0.95 m wide and 2.05 m high."""
    size = (0.95, 2.05)
    return hung(where, door_leaf(rng, size, tone=rng.uniform(0.2, 0.7)), size, name)


def window(
    rng: Rng,
    where: Spot,
    *,
    size_m: Size = (1.4, 1.3),
    curtains: bool = False,
    name: str = "window",
) -> list[Solid]:
    """A bright window, with or without a curtain on either side."""
    parts = hung(where, window_pane(rng, size_m), size_m, name)
    if curtains:
        size = (0.4, size_m[1] + 0.25)
        picture = curtain(rng, size, 300.0, rng.uniform(0.2, 0.6))
        for y in (-0.5 * size_m[0] - 0.1, 0.5 * size_m[0] + 0.1):
            parts += hung(where.inside((0.03, y, -0.15)), picture, size, "curtain")
    return parts


def print_on_wall(
    rng: Rng, where: Spot, *, size_m: Size = (0.6, 0.85), name: str = "poster"
) -> list[Solid]:
    """A framed poster."""
    return hung(where, poster(rng, size_m), size_m, name)


def notes_on_wall(
    rng: Rng, where: Spot, *, size_m: Size = (1.6, 1.0), name: str = "whiteboard"
) -> list[Solid]:
    """A whiteboard that has been written on."""
    return hung(where, whiteboard(rng, size_m), size_m, name)
