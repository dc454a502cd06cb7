"""A room: four walls, a floor and a ceiling, seen from inside, and where things go in it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from dlgmd_cli.flights.places.blocks import Spot, Triple, spot
from dlgmd_cli.flights.places.fittings import ceiling_panels
from dlgmd_cli.flights.places.materials import (
    brick,
    carpet,
    concrete,
    parquet,
    plaster,
    tiles,
    wallpaper,
)
from dlgmd_cli.flights.places.shade import Wall, shaded
from dlgmd_cli.flights.places.sheet import Rng, limited
from dlgmd_cli.flights.renderer.solids import Body, Solid, quad
from dlgmd_cli.flights.renderer.texture import FloatImage, Texture

Material = Callable[..., FloatImage]
WALLS: dict[str, Material] = {
    "plaster": plaster,
    "wallpaper": wallpaper,
    "brick": brick,
    "concrete": concrete,
}
FLOORS: dict[str, Material] = {
    "parquet": parquet,
    "tiles": tiles,
    "carpet": carpet,
    "concrete": concrete,
}
OFF_WALL_M = 0.01
_GAINS = {"near": 0.82, "far": 0.85, "left": 0.9, "right": 0.78, "floor": 0.95, "ceiling": 0.85}
_WALL_PX_PER_M, _FLOOR_PX_PER_M, _CEILING_PX_PER_M = 250.0, 200.0, 120.0


@dataclass(frozen=True)
class Hall:
    """The inside of a room: x from 0 to its length, y from -width/2 to width/2, z from 0.

    Attributes
    ----------
    size_m : (float, float, float)
        Length, width and height.
    """

    size_m: Triple

    def walls(self) -> dict[str, Wall]:
        """Its sides: "near" (at x = 0), "far", "left" (towards y), "right", "floor", "ceiling"."""
        length, width, height = self.size_m
        half = width / 2
        sides = {
            "near": ((0, -half, height), (0, width, 0), (0, 0, -height)),
            "far": ((length, half, height), (0, -width, 0), (0, 0, -height)),
            "left": ((0, half, height), (length, 0, 0), (0, 0, -height)),
            "right": ((length, -half, height), (-length, 0, 0), (0, 0, -height)),
            "floor": ((0, half, 0), (length, 0, 0), (0, -width, 0)),
            "ceiling": ((0, -half, height), (length, 0, 0), (0, width, 0)),
        }
        return {
            side: Wall(*(np.array(each, float) for each in lines)) for side, lines in sides.items()
        }

    def stand(self, side: str, along_m: float, off_m: float) -> tuple[tuple[float, float], float]:
        """Where a thing is `off_m` in front of a wall, and the yaw with which it has it behind.

        `along_m` is x on the "left" and "right" wall and y on the "near" and "far" one.
        """
        length, width, _ = self.size_m
        return {
            "near": ((off_m, along_m), 0.0),
            "far": ((length - off_m, along_m), 180.0),
            "left": ((along_m, width / 2 - off_m), -90.0),
            "right": ((along_m, off_m - width / 2), 90.0),
        }[side]

    def on(self, side: str, along_m: float, up_m: float = 0.0) -> Spot:
        """A spot on a wall, `up_m` over the floor, that looks into the room; see `stand`."""
        (x, y), yaw_deg = self.stand(side, along_m, OFF_WALL_M)
        return spot((x, y, up_m), yaw_deg)


@dataclass(frozen=True)
class Place:
    """A room with what stands in it.

    Attributes
    ----------
    hall : Hall
        How large it is.
    room : Solid
        Its walls; see `World`.
    bodies : list of Body
        All that is in it.
    free_width_m : float
        No furniture is within half of this from the x axis.
    free_end_m : float
        That holds up to this x; a radiator at the near wall does not count.
    """

    hall: Hall
    room: Solid
    bodies: list[Body] = field(default_factory=list)
    free_width_m: float = 2.0
    free_end_m: float = 0.0


def room(
    size_m: Triple,
    rng: Rng,
    *,
    wall: str = "plaster",
    far: str | None = None,
    floor: str = "parquet",
    lamps: tuple[int, int] = (4, 2),
    tone: float = 0.55,
    bodies: Sequence[Body] = (),
) -> Solid:
    """Walls, floor and ceiling, with the soft shadows of what stands in front of them.

    Parameters
    ----------
    size_m : (float, float, float)
        Length along x, width along y, and height; see `Hall`.
    wall, far, floor : str
        What the walls, the wall at the end and the floor are made of: a key of `WALLS` or
        `FLOORS`. The far wall is like the others unless told.
    lamps : (int, int)
        Columns, along x, and rows of lamps in the ceiling.
    tone : float
        Reflectance of plaster and wallpaper.
    bodies : sequence of Body
        What casts a shadow.

    Returns
    -------
    Solid
        Faces "near", "far", "left", "right", "floor" and "ceiling", in this order.
    """
    faces = []
    for side, seen in Hall(size_m).walls().items():
        if side == "floor":
            image = FLOORS[floor](rng, seen.size_m, _FLOOR_PX_PER_M)
        elif side == "ceiling":
            image = ceiling_panels(rng, seen.size_m, _CEILING_PX_PER_M, 0.7, lamps)
        else:
            image = _wall(rng, (far or wall) if side == "far" else wall, seen, tone)
        picture = Texture(limited(shaded(image, seen, bodies)))
        faces.append(quad(seen.origin_m, seen.right_m, seen.down_m, picture, _GAINS[side]))
    return Solid("room", faces)


def _wall(rng: Rng, material: str, seen: Wall, tone: float) -> FloatImage:
    """A wall with its skirting board."""
    tones = {"tone": tone} if material in ("plaster", "wallpaper") else {}
    image = WALLS[material](rng, seen.size_m, _WALL_PX_PER_M, **tones)
    board = round(0.08 * image.shape[0] / seen.size_m[1])
    image[-board:] = 0.22
    image[-board : 2 - board] = 0.5
    image[-board - 2 : -board] *= 0.6
    return image
