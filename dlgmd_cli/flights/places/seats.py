"""Things with legs: chairs, stools, tables and sofas.

Every function gives the bodies of one thing that stands at `at_m`, (x, y) or (x, y, z), and looks
along x, turned by `yaw_deg` counter-clockwise; all bear its name. None cuts into another.
"""

from collections.abc import Sequence

from dlgmd_cli.flights.places.blocks import (
    AGAINST_WALL,
    AROUND,
    SIDES,
    STANDING,
    Skin,
    Spot,
    block,
    skin,
    spot,
)
from dlgmd_cli.flights.places.materials import cloth, plain, wood
from dlgmd_cli.flights.places.sheet import Rng
from dlgmd_cli.flights.renderer.solids import Solid


def chair(
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    tone: float = 0.1,
    covered: Skin | None = None,
    scale: float = 1.0,
    name: str = "chair",
) -> list[Solid]:
    """A plain-coloured chair: four legs, a seat, and a back of two posts with slats between.

    It is 0.92 m high and 0.46 m wide, times `scale`; who sits on it looks along x.
    """
    where, covered = spot(at_m, yaw_deg), covered or skin(plain(tone))
    half, thick = 0.23 * scale, 0.045 * scale
    seat, top = 0.46 * scale, 0.92 * scale
    parts = legs(name, where, (2 * half, 2 * half), seat - thick, thick, covered)
    low, high = (-half, -half, seat - thick), (half, half, seat)
    parts.append(block(name, where, low, high, covered))
    for y in (-half, half - thick):
        low, high = (-half, y, seat), (thick - half, y + thick, top)
        parts.append(block(name, where, low, high, covered, sides=STANDING))
    across = ("front", "back", "top", "bottom")
    for bottom, upper in ((0.60, 0.66), (0.70, 0.76), (0.80, 0.91)):
        low = (0.008 - half, thick - half, bottom * scale)
        high = (0.035 * scale - half, half - thick, upper * scale)
        parts.append(block(name, where, low, high, covered, sides=across))
    return parts


def stool(
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    height_m: float = 0.6,
    side_m: float = 0.4,
    tone: float = 0.25,
    name: str = "stool",
) -> list[Solid]:
    """A square seat on four legs."""
    return _slab(name, spot(at_m, yaw_deg), (side_m, side_m), height_m, 0.04, skin(plain(tone)))


def table(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    size_m: tuple[float, float] = (0.8, 1.4),
    height_m: float = 0.74,
    tone: float = 0.3,
    name: str = "table",
) -> list[Solid]:
    """A table of wood, `size_m` along x and y, with four legs."""
    covered = skin(wood(rng, (0.8, 1.6), 400.0, tone), (0.8, 1.6))
    return _slab(name, spot(at_m, yaw_deg), size_m, height_m, 0.055, covered)


def sofa(
    rng: Rng,
    at_m: Sequence[float],
    yaw_deg: float = 0.0,
    *,
    width_m: float = 1.8,
    tone: float = 0.2,
    name: str = "sofa",
) -> list[Solid]:
    """A sofa with its back at -0.45 m along x; it has no rear, which stands at a wall."""
    where = spot(at_m, yaw_deg)
    covered = skin(cloth(rng, (0.9, 0.9), 400.0, tone), (0.9, 0.9))
    half, inner = width_m / 2, width_m / 2 - 0.18
    base = ((-0.45, -half, 0.0), (0.38, half, 0.26))
    back = ((-0.45, -inner, 0.26), (-0.2, inner, 0.85))
    parts = [
        block(name, where, *base, covered, sides=AGAINST_WALL),
        block(name, where, *back, covered, sides=STANDING),
    ]
    for y in (-half, inner):
        low, high = (-0.45, y, 0.26), (0.38, y + half - inner, 0.6)
        parts.append(block(name, where, low, high, covered, sides=AGAINST_WALL))
    for y in (-inner, 0.0):
        low, high = (-0.2, y + 0.005, 0.26), (0.41, y + inner - 0.005, 0.44)
        parts.append(block(name, where, low, high, covered, sides=AGAINST_WALL))
    return parts


def legs(
    name: str,
    where: Spot,
    size_m: tuple[float, float],
    height_m: float,
    thick_m: float,
    covered: Skin,
) -> list[Solid]:
    """Four legs at the corners of a rectangle, `size_m` along x and y, around a spot."""
    (dx, dy), parts = (side / 2 for side in size_m), []
    for x in (-dx, dx - thick_m):
        for y in (-dy, dy - thick_m):
            low, high = (x, y, 0.0), (x + thick_m, y + thick_m, height_m)
            parts.append(block(name, where, low, high, covered, sides=AROUND))
    return parts


def _slab(
    name: str,
    where: Spot,
    size_m: tuple[float, float],
    height_m: float,
    thick_m: float,
    covered: Skin,
) -> list[Solid]:
    """A slab on four legs that stand a little inside its corners."""
    under = height_m - 0.035
    inner = (size_m[0] - 0.04, size_m[1] - 0.04)
    low, high = (-size_m[0] / 2, -size_m[1] / 2, under), (size_m[0] / 2, size_m[1] / 2, height_m)
    return [
        *legs(name, where, inner, under, thick_m, covered),
        block(name, where, low, high, covered, sides=SIDES),
    ]
