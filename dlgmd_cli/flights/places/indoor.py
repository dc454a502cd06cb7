"""Furnished places to fly through; one flies along x, which runs through the middle of the floor.

In all of them `guests` are bodies that the flight is about. They are not among the bodies of the
place; nothing is put where they are, and those at rest cast their shadows on the floor.
"""

from collections.abc import Sequence

from dlgmd_cli.flights.places.blocks import Triple
from dlgmd_cli.flights.places.building import partition, pillar
from dlgmd_cli.flights.places.furnish import Furnishing
from dlgmd_cli.flights.places.rooms import Hall, Place, room
from dlgmd_cli.flights.places.sheet import Rng
from dlgmd_cli.flights.renderer.solids import Body

_CLUTTER = (
    *("shelf", "desk", "window", "sofa", "cupboard", "plant", "cartons", "bookcase", "door"),
    *("sideboard", "lamp", "window", "bookcase", "poster"),
)
_LITTLE = ("window", "door", "cupboard", "poster", "plant", "window", "poster", "sideboard")
_END = ("bookcase", "poster", "cupboard", "door", "cartons", "poster")
_FLAT = ("poster", "door", "window")


def cluttered_room(
    rng: Rng,
    *,
    length_m: float = 11.0,
    width_m: float = 5.6,
    height_m: float = 2.8,
    free_width_m: float = 2.4,
    end_m: float = 1.1,
    wall: str | None = None,
    floor: str | None = None,
    guests: Sequence[Body] = (),
) -> Place:
    """A room full of furniture along its walls.

    Parameters
    ----------
    length_m, width_m, height_m : float
        Of the room; see `Hall`.
    free_width_m : float
        No furniture is within half of this from the x axis, up to `end_m` before the far wall.
    end_m : float
        How far furniture at the far wall may reach into the room.
    wall, floor : str, optional
        See `room`; chosen by the generator unless told.
    guests : sequence of Body
        See the head of this module.
    """
    hall = Hall((length_m, width_m, height_m))
    furnishing = Furnishing(hall, guests)
    depth = (width_m - free_width_m) / 2
    ends = list(rng.permutation(_END))
    furnishing.line(rng, "far", ends, (0.05 - width_m / 2, width_m / 2 - 0.05), depth_m=end_m)
    names = list(rng.permutation(_CLUTTER))
    half = len(names) // 2
    for side, share in (("left", names[:half]), ("right", names[half:])):
        # Posters come last: they fill what is left of the wall.
        share = [*share, *("poster",) * 4]
        furnishing.line(rng, side, share, (0.3, length_m - 0.1), depth_m=depth)
    near = list(rng.permutation(_FLAT))
    furnishing.line(rng, "near", near, (0.1 - width_m / 2, width_m / 2 - 0.1), depth_m=0.2)
    wall = wall or str(rng.choice(["plaster", "wallpaper", "plaster", "brick"]))
    floor = floor or str(rng.choice(["parquet", "carpet", "tiles"]))
    return _place(rng, furnishing, wall, None, floor, free_width_m, end_m)


def simple_room(
    rng: Rng,
    *,
    length_m: float = 9.0,
    width_m: float = 5.0,
    height_m: float = 2.8,
    free_width_m: float = 2.6,
    wall: str = "plaster",
    far: str | None = None,
    floor: str | None = None,
    guests: Sequence[Body] = (),
) -> Place:
    """A room with a few things in it, all of them at its side walls; the far wall is bare.

    The parameters are those of `cluttered_room`; `far` is what the far wall is made of.
    """
    hall = Hall((length_m, width_m, height_m))
    furnishing = Furnishing(hall, guests)
    depth = (width_m - free_width_m) / 2
    names = list(rng.permutation(_LITTLE))
    for side, share in (("left", names[::2]), ("right", names[1::2])):
        span = (rng.uniform(0.3, 1.0), length_m - 0.3)
        furnishing.line(rng, side, share, span, depth_m=depth, gap_m=(0.3, 1.2))
    furnishing.line(rng, "near", ["door"], (-1.5, 1.5), depth_m=0.2)
    floor = floor or str(rng.choice(["parquet", "carpet", "tiles"]))
    return _place(rng, furnishing, wall, far, floor, free_width_m, 0.0)


def corridor(
    rng: Rng,
    *,
    length_m: float = 18.0,
    width_m: float = 2.2,
    height_m: float = 2.6,
    guests: Sequence[Body] = (),
) -> Place:
    """A long and narrow place with doors and posters on both sides and lamps along it."""
    hall = Hall((length_m, width_m, height_m))
    furnishing = Furnishing(hall, guests)
    for side, start in (("left", 0.4), ("right", 1.4)):
        names = [str(rng.choice(["door", "door", "poster"])) for _ in range(int(length_m))]
        furnishing.line(rng, side, names, (start, length_m - 0.2), depth_m=0.1, gap_m=(0.5, 1.3))
    for side in ("far", "near"):
        furnishing.line(rng, side, ["door"], (-width_m / 2, width_m / 2), depth_m=0.1)
    lamps = (max(1, round(length_m / 2.4)), 1)
    floor = str(rng.choice(["tiles", "carpet"]))
    return _place(rng, furnishing, "plaster", None, floor, width_m - 0.1, 0.1, lamps)


def pillared_room(
    rng: Rng,
    *,
    at_m: Sequence[tuple[float, float]] = ((6.0, 0.9),),
    pillar_m: float = 0.4,
    length_m: float = 12.0,
    width_m: float = 6.0,
    guests: Sequence[Body] = (),
) -> Place:
    """A cluttered room with pillars from the floor to the ceiling, called "pillar", at `at_m`."""
    height = 2.8
    pillars = [part for at in at_m for part in pillar(rng, at, width_m=pillar_m, height_m=height)]
    return _with(
        pillars,
        cluttered_room(
            rng,
            length_m=length_m,
            width_m=width_m,
            height_m=height,
            guests=[*guests, *pillars],
        ),
    )


def two_rooms(
    rng: Rng,
    *,
    doorway_x_m: float = 6.0,
    opening_m: tuple[float, float] = (1.1, 2.1),
    length_m: float = 12.0,
    width_m: float = 5.6,
    guests: Sequence[Body] = (),
) -> Place:
    """A cluttered room cut in two by a wall with a doorway; its parts are called "doorway"."""
    height = 2.8
    parts = partition(rng, doorway_x_m, (width_m, height), opening_m=opening_m)
    return _with(
        parts,
        cluttered_room(
            rng,
            length_m=length_m,
            width_m=width_m,
            height_m=height,
            guests=[*guests, *parts],
        ),
    )


def _with(bodies: Sequence[Body], place: Place) -> Place:
    """A place with more in it."""
    return Place(
        place.hall, place.room, [*place.bodies, *bodies], place.free_width_m, place.free_end_m
    )


def _place(
    rng: Rng,
    furnishing: Furnishing,
    wall: str,
    far: str | None,
    floor: str,
    free_width_m: float,
    end_m: float,
    lamps: tuple[int, int] | None = None,
) -> Place:
    """What was furnished, with the shadows of it all."""
    hall: Triple = furnishing.hall.size_m
    inside = room(
        hall,
        rng,
        wall=wall,
        far=far,
        floor=floor,
        lamps=lamps or (max(1, round(hall[0] / 2.5)), 2),
        tone=rng.uniform(0.4, 0.7),
        bodies=[*furnishing.guests, *furnishing.bodies],
    )
    return Place(furnishing.hall, inside, list(furnishing.bodies), free_width_m, hall[0] - end_m)
