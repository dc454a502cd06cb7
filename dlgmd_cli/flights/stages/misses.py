"""Flights that come close to something and do not hit it, or only look as if they might.

They are the hard ones: much moves in the picture, or grows, or changes at once, and a collision
detector should stay quiet.
"""

from collections.abc import Sequence

import numpy as np

from dlgmd_cli.flights.drone import fly
from dlgmd_cli.flights.path import Path, Stage
from dlgmd_cli.flights.places.building import door, notes_on_wall
from dlgmd_cli.flights.places.indoor import (
    cluttered_room,
    corridor,
    pillared_room,
    simple_room,
    two_rooms,
)
from dlgmd_cli.flights.places.obstacles import person
from dlgmd_cli.flights.places.rooms import Hall, Place
from dlgmd_cli.flights.renderer.solids import Body
from dlgmd_cli.flights.script import Phase, accelerate, cruise, decelerate, hover, yaw
from dlgmd_cli.flights.stages.placing import DAYLIGHT, lit_by, world_of

_LAMPS_ON_S, _DUSK = 2.0, 0.3
_WALK_M_S = 1.3


def past_pillar(seed: int) -> Stage:
    """Flying straight past a pillar, half a metre beside it."""
    path = _flight(seed, [hover(1.0), accelerate(1.4, -10.0), cruise(1.6), decelerate(2.0, 12.0)])
    x = _position(path, 3.2)
    place = pillared_room(
        np.random.default_rng([seed, 1]),
        at_m=((x, 0.7),),
        length_m=_position(path, path.duration_s) + 2.5,
    )
    return _stage(place, path, "pillar")


def through_doorway(seed: int) -> Stage:
    """Flying through a doorway into the next room."""
    path = _flight(seed, [hover(1.0), accelerate(1.2, -9.0), cruise(2.2), decelerate(1.6, 10.0)])
    place = two_rooms(
        np.random.default_rng([seed, 1]),
        doorway_x_m=_position(path, 3.4),
        length_m=_position(path, path.duration_s) + 2.2,
    )
    return _stage(place, path, "doorway")


def along_corridor(seed: int) -> Stage:
    """Flying along a narrow corridor, and stopping well before the door at its end."""
    path = _flight(seed, [hover(0.8), accelerate(1.5, -10.0), cruise(2.6), decelerate(1.6, 12.0)])
    length = _position(path, path.duration_s) + 3.0
    rng = np.random.default_rng([seed, 1])
    end = door(rng, Hall((length, 2.2, 2.6)).on("far", 0.0), name="end door")
    place = corridor(rng, length_m=length, guests=end)
    return _stage(place, path, "end door", end)


def turn_at_wall(seed: int) -> Stage:
    """Stopping a good metre before a wall, and turning away from it on the spot."""
    script = [hover(0.8), accelerate(1.2, -8.0), decelerate(1.6, 8.0), yaw(2.2, 45.0)]
    path = _flight(seed, script, x_m=2.0)
    stops_m = _position(path, path.duration_s)
    rng = np.random.default_rng([seed, 1])
    hall = Hall((stops_m + 1.3, 5.6, 2.8))
    board = notes_on_wall(rng, hall.on("far", 0.0, 0.8), name="whiteboard")
    place = cluttered_room(rng, length_m=hall.size_m[0], end_m=0.3, guests=board)
    return _stage(place, path, "whiteboard", board)


def light_on(seed: int) -> Stage:
    """Hovering in a dim room when the lamps go on, two seconds after the start."""
    path = _flight(seed, [hover(4.0)], x_m=2.0)
    rng = np.random.default_rng([seed, 1])
    hall = Hall((7.5, 5.0, 2.8))
    board = notes_on_wall(rng, hall.on("far", 0.0, 0.8), name="whiteboard")
    place = simple_room(rng, length_m=hall.size_m[0], width_m=hall.size_m[1], guests=board)
    world = lit_by(lambda time_s: DAYLIGHT if time_s >= _LAMPS_ON_S else _DUSK, place, board)
    return Stage(world, path, "whiteboard", None, path.duration_s)


def person_crossing(seed: int) -> Stage:
    """Hovering while somebody walks by, four metres ahead."""
    path = _flight(seed, [hover(4.5)], x_m=1.5)
    rng = np.random.default_rng([seed, 1])
    reach = 2.4

    def walk(time_s: float) -> tuple[float, float, float]:
        return 0.0, float(np.clip(_WALK_M_S * (time_s - 0.4), 0.0, 2.0 * reach)), 0.0

    walker = person(rng, (5.5, -reach), 90.0, motion=walk)
    place = cluttered_room(rng, length_m=9.0, width_m=8.0, free_width_m=5.8, guests=walker)
    return _stage(place, path, "person", walker)


def _flight(seed: int, script: Sequence[Phase], x_m: float = 1.0) -> Path:
    """A flight along the middle of a room."""
    return fly(script, position_m=(x_m, 0.0, 1.25), seed=seed)


def _position(path: Path, time_s: float) -> float:
    """How far along the room it is at a time, in m."""
    return float(path.state(time_s).position_m[0])


def _stage(place: Place, path: Path, target: str, guests: Sequence[Body] = ()) -> Stage:
    """A flight that hits nothing."""
    return Stage(world_of(place, guests), path, target, None, path.duration_s)
