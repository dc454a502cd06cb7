"""What can be put at a wall, by name."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dlgmd_cli.flights.places.blocks import spot
from dlgmd_cli.flights.places.building import door, notes_on_wall, print_on_wall, window
from dlgmd_cli.flights.places.furniture import (
    bookcase,
    cartons,
    cupboard,
    floor_lamp,
    plant,
    radiator,
    shelf,
)
from dlgmd_cli.flights.places.obstacles import carton, notebook
from dlgmd_cli.flights.places.rooms import Hall
from dlgmd_cli.flights.places.seats import chair, sofa, table
from dlgmd_cli.flights.places.sheet import Rng
from dlgmd_cli.flights.renderer.solids import Solid

Made = Callable[[Rng, Hall, str, float], Sequence[Solid]]


@dataclass(frozen=True)
class Piece:
    """One sort of thing for a wall.

    Attributes
    ----------
    width_m : float
        What it takes of the wall.
    depth_m : float
        How far it reaches into the room.
    made : callable
        Its bodies, from the generator, the hall, the wall's name and the place along the wall.
    """

    width_m: float
    depth_m: float
    made: Made


def _shelf(rng: Rng, hall: Hall, side: str, along_m: float) -> Sequence[Solid]:
    """A shelf as high as a person."""
    return shelf(rng, *hall.stand(side, along_m, 0.17), boards=4)


def _bookcase(rng: Rng, hall: Hall, side: str, along_m: float) -> Sequence[Solid]:
    """A bookcase as high as a person."""
    return bookcase(rng, *hall.stand(side, along_m, 0.16))


def _cupboard(rng: Rng, hall: Hall, side: str, along_m: float) -> Sequence[Solid]:
    """A cupboard as high as a person."""
    return cupboard(rng, *hall.stand(side, along_m, 0.25))


def _sideboard(rng: Rng, hall: Hall, side: str, along_m: float) -> Sequence[Solid]:
    """A low cupboard with a whiteboard over it."""
    low = cupboard(rng, *hall.stand(side, along_m, 0.22), size_m=(0.44, 1.4, 0.85))
    return [*low, *notes_on_wall(rng, hall.on(side, along_m, 1.1))]


def _sofa(rng: Rng, hall: Hall, side: str, along_m: float) -> Sequence[Solid]:
    """A sofa with two posters over it."""
    parts = sofa(rng, *hall.stand(side, along_m, 0.45))
    for aside in (-0.45, 0.45):
        parts += print_on_wall(rng, hall.on(side, along_m + aside, 1.25))
    return parts


def _desk(rng: Rng, hall: Hall, side: str, along_m: float) -> Sequence[Solid]:
    """A table with a notebook computer and a carton on it, and a window over it."""
    at_m, yaw_deg = hall.stand(side, along_m, 0.45)
    top, aside = 0.74, float(rng.choice([-0.45, 0.45]))
    on_top = spot(at_m, yaw_deg).world([(-0.05, -0.3 * aside, top), (-0.1, aside, top)])
    return [
        *table(rng, at_m, yaw_deg, tone=rng.uniform(0.2, 0.45)),
        *notebook(rng, on_top[0], yaw_deg, px_per_m=700.0),
        *carton(rng, on_top[1], yaw_deg, size_m=(0.25, 0.3, 0.22), px_per_m=700.0, name="box"),
        *window(rng, hall.on(side, along_m, 1.2)),
    ]


def _window(rng: Rng, hall: Hall, side: str, along_m: float) -> Sequence[Solid]:
    """A window with curtains, and a radiator under it."""
    warm = radiator(rng, *hall.stand(side, along_m, 0.06))
    return [*warm, *window(rng, hall.on(side, along_m, 1.0), curtains=True)]


def _cartons(rng: Rng, hall: Hall, side: str, along_m: float) -> Sequence[Solid]:
    """A stack of cartons."""
    return cartons(rng, *hall.stand(side, along_m, 0.3), count=int(rng.integers(2, 5)))


def _chair(rng: Rng, hall: Hall, side: str, along_m: float) -> Sequence[Solid]:
    """A chair, turned a little, and a poster over it."""
    at_m, yaw_deg = hall.stand(side, along_m, 0.4)
    turned = yaw_deg + rng.uniform(-30.0, 30.0)
    seat = chair(at_m, turned, tone=rng.uniform(0.05, 0.4), name="seat")
    return [*seat, *print_on_wall(rng, hall.on(side, along_m, 1.25))]


def _plant(rng: Rng, hall: Hall, side: str, along_m: float) -> Sequence[Solid]:
    """A plant."""
    return plant(rng, *hall.stand(side, along_m, 0.52), height_m=rng.uniform(1.2, 1.6))


def _lamp(rng: Rng, hall: Hall, side: str, along_m: float) -> Sequence[Solid]:
    """A lamp."""
    return floor_lamp(rng, *hall.stand(side, along_m, 0.3))


def _door(rng: Rng, hall: Hall, side: str, along_m: float) -> Sequence[Solid]:
    """A closed door."""
    return door(rng, hall.on(side, along_m))


def _poster(rng: Rng, hall: Hall, side: str, along_m: float) -> Sequence[Solid]:
    """A poster, larger or smaller."""
    wide = rng.uniform(0.5, 0.8)
    size_m = (wide, wide * rng.uniform(0.7, 1.4))
    return print_on_wall(rng, hall.on(side, along_m, rng.uniform(1.0, 1.3)), size_m=size_m)


PIECES = {
    "shelf": Piece(1.0, 0.34, _shelf),
    "bookcase": Piece(1.0, 0.32, _bookcase),
    "cupboard": Piece(1.0, 0.5, _cupboard),
    "sideboard": Piece(1.6, 0.44, _sideboard),
    "sofa": Piece(1.8, 0.87, _sofa),
    "desk": Piece(1.45, 0.85, _desk),
    "window": Piece(2.2, 0.12, _window),
    "cartons": Piece(0.65, 0.6, _cartons),
    "chair": Piece(0.7, 0.75, _chair),
    "plant": Piece(1.0, 1.0, _plant),
    "lamp": Piece(0.5, 0.5, _lamp),
    "door": Piece(1.0, 0.02, _door),
    "poster": Piece(0.9, 0.02, _poster),
}
