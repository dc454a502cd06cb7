"""Things to fly at, and a person who walks by.

The functions take and give what those of `seats` do.
"""

import math
from collections.abc import Sequence

import numpy as np

from dlgmd_cli.flights.places.blocks import (
    AROUND,
    SIDES,
    STANDING,
    block,
    skin,
    spot,
)
from dlgmd_cli.flights.places.materials import cloth, leaves, plain
from dlgmd_cli.flights.places.prints import carton_side, gridded, keyboard, notebook_screen
from dlgmd_cli.flights.places.seats import stool, table
from dlgmd_cli.flights.places.sheet import Rng, Size, limited
from dlgmd_cli.flights.renderer.solids import Body, Motion, Round, Solid
from dlgmd_cli.flights.renderer.texture import Texture


def gridded_board(
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    size_m: Size = (0.9, 0.9),
    bottom_m: float = 0.65,
    lines: int = 9,
    px_per_m: float = 1600.0,
    name: str = "gridded pattern",
) -> list[Solid]:
    """A board with black lines on white, `bottom_m` over the floor, and a stand behind it.

    The front of the board is at 0.01 m along x; see `gridded` for its lines.
    """
    where, (width, height) = spot(at_m, yaw_deg), size_m
    low, high = (-0.01, -width / 2, bottom_m), (0.01, width / 2, bottom_m + height)
    front = {"front": skin(gridded(size_m, px_per_m, lines))}
    parts = [block(name, where, low, high, skin(plain(0.35)), others=front)]
    dark = skin(plain(0.08))
    for y in (-0.3 * width, 0.3 * width):
        low, high = (-0.05, y - 0.02, 0.03), (-0.01, y + 0.02, bottom_m + 0.8 * height)
        parts.append(block(name, where, low, high, dark, sides=STANDING))
        low, high = (-0.3, y - 0.025, 0.0), (0.25, y + 0.025, 0.03)
        parts.append(block(name, where, low, high, dark, sides=STANDING))
    return parts


def notebook(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    scale: float = 1.0,
    lean_deg: float = 15.0,
    px_per_m: float = 1600.0,
    name: str = "notebook",
) -> list[Solid]:
    """An open notebook computer, 0.42 m wide times `scale`; its screen looks along x.

    `lean_deg` is how far the screen leans back.
    """
    where, dark = spot(at_m, yaw_deg), skin(plain(0.06))
    half, thick, hinge = 0.21 * scale, 0.018 * scale, -0.13 * scale
    deep, high = 0.28 * scale, 0.29 * scale
    keys = {"top": skin(keyboard(rng, (2 * half, deep), px_per_m))}
    screen = {"front": skin(notebook_screen(rng, (2 * half, high), px_per_m))}
    base = (hinge, -half, 0.0), (hinge + deep, half, thick)
    # The rear edge of a screen that leans back is its lowest.
    lift = thick + 0.6 * thick * math.sin(math.radians(lean_deg))
    lid = where.inside((hinge, 0.0, lift), pitch_deg=lean_deg)
    return [
        block(name, where, *base, dark, sides=STANDING, others=keys),
        block(name, lid, (-0.6 * thick, -half, 0.0), (0.0, half, high), dark, others=screen),
    ]


def notebook_on_table(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    height_m: float = 0.74,
    scale: float = 1.0,
    name: str = "notebook",
) -> list[Solid]:
    """An open notebook computer on a small table; the table is called "table"."""
    x, y, z = (*at_m, 0.0)[:3]
    stand = table(rng, at_m, yaw_deg, size_m=(0.6, 0.9), height_m=height_m)
    return [*stand, *notebook(rng, (x, y, z + height_m), yaw_deg, scale=scale, name=name)]


def carton(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    size_m: tuple[float, float, float] = (0.4, 0.5, 0.4),
    tone: float = 0.3,
    px_per_m: float = 1600.0,
    name: str = "carton",
) -> list[Solid]:
    """A closed carton with print and tape on it, `size_m` along x, y and z."""
    deep, wide, high = size_m
    front = skin(carton_side(rng, (wide, high), px_per_m, tone))
    flank = skin(carton_side(rng, (deep, high), 0.6 * px_per_m, tone))
    by_side = {"left": flank, "right": flank}
    low_m, high_m = (-deep / 2, -wide / 2, 0.0), (deep / 2, wide / 2, high)
    where = spot(at_m, yaw_deg)
    return [block(name, where, low_m, high_m, front, sides=SIDES, others=by_side)]


def carton_on_stool(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    height_m: float = 0.7,
    size_m: tuple[float, float, float] = (0.4, 0.5, 0.4),
    name: str = "carton",
) -> list[Solid]:
    """A carton on a stool that is `height_m` high; the stool is called "stool"."""
    x, y, z = (*at_m, 0.0)[:3]
    upper = carton(rng, (x, y, z + height_m), yaw_deg, size_m=size_m, name=name)
    return [*stool(at_m, yaw_deg, height_m=height_m), *upper]


def person(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    height_m: float = 1.75,
    motion: Motion | None = None,
    name: str = "person",
) -> list[Body]:
    """Somebody in mid-stride who walks along x; all of the body moves by the same `motion`."""
    where, unit = spot(at_m, yaw_deg), height_m / 1.75
    trousers = skin(cloth(rng, (0.3, 0.9), 300.0, rng.uniform(0.05, 0.2)), (0.3, 0.9))
    shirt = skin(_shirt(rng), (0.6, 0.7))
    shoes, bare = skin(plain(0.05)), rng.uniform(0.15, 0.45)
    bodies: list[Body] = []
    for side, swing in ((-1.0, 14.0), (1.0, -14.0)):
        hip = where.inside((0.0, side * 0.1 * unit, 0.85 * unit), pitch_deg=swing)
        low, high = (-0.08, -0.075, -0.76), (0.08, 0.075, 0.0)
        leg = block(name, hip, _times(unit, low), _times(unit, high), trousers, motion=motion)
        low, high = (-0.09, -0.06, -0.83), (0.16, 0.06, -0.76)
        shoe = block(name, hip, _times(unit, low), _times(unit, high), shoes, motion=motion)
        bodies += [leg, shoe]
        arm_at = where.inside((0.0, side * 0.27 * unit, 1.44 * unit), pitch_deg=-1.3 * swing)
        low, high = (-0.05, -0.045, -0.45), (0.05, 0.045, 0.0)
        sleeve = block(name, arm_at, _times(unit, low), _times(unit, high), shirt, motion=motion)
        low, high = (-0.04, -0.035, -0.6), (0.04, 0.035, -0.45)
        hand = block(
            name, arm_at, _times(unit, low), _times(unit, high), skin(plain(bare)), motion=motion
        )
        bodies += [sleeve, hand]
    low, high = (-0.12, -0.215, 0.875), (0.12, 0.215, 1.46)
    bodies.append(block(name, where, _times(unit, low), _times(unit, high), shirt, motion=motion))
    low, high = (-0.05, -0.05, 1.46), (0.05, 0.05, 1.5)
    neck = skin(plain(0.8 * bare))
    around = block(
        name, where, _times(unit, low), _times(unit, high), neck, sides=AROUND, motion=motion
    )
    ends = where.world([(0.0, 0.0, 1.6 * unit), (0.0, 0.0, 1.65 * unit)])
    head = Round(name, ends, 0.1 * unit, Texture(_head(bare)), 0.85, motion)
    return [*bodies, around, head]


def _times(unit: float, point: tuple[float, float, float]) -> tuple[float, float, float]:
    """A point of a body that is `unit` times as large."""
    return point[0] * unit, point[1] * unit, point[2] * unit


def _shirt(rng: Rng) -> np.ndarray:
    """Striped cloth, or cloth with a pattern."""
    size, tone = (0.6, 0.7), rng.uniform(0.2, 0.6)
    image = cloth(rng, size, 300.0, tone)
    if rng.uniform() < 0.5:
        rows = np.arange(image.shape[0]) / image.shape[0]
        return limited(image * (1.0 + 0.35 * np.sin(2 * np.pi * 9 * rows))[:, None])
    return limited(0.6 * image + 0.6 * leaves(rng, size, 300.0, tone))


def _head(bare: float) -> np.ndarray:
    """Hair over skin, as a capsule has it from the side."""
    image = np.full((50, 40), bare, np.float32)
    image[:22] = 0.05
    image[22:28] += np.linspace(0.05 - bare, 0.0, 6, dtype=np.float32)[:, None]
    return image
