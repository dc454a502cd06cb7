"""All scenes, by name."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dlgmd_cli.checks import nearest
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.lab.flights import script
from dlgmd_cli.lab.flights.ball import ball_and_capsules
from dlgmd_cli.lab.flights.bodies import placement
from dlgmd_cli.lab.flights.drone import fly
from dlgmd_cli.lab.flights.furniture import furniture
from dlgmd_cli.lab.flights.path import Path as FlightPath
from dlgmd_cli.lab.flights.path import Stage
from dlgmd_cli.lab.flights.placing import DAYLIGHT, FRAME_S, build_world, obstacle_in_path
from dlgmd_cli.lab.flights.random_flight import random_flight
from dlgmd_cli.lab.flights.renderer.solids import Body, Motion
from dlgmd_cli.lab.flights.rooms import cluttered_room, corridor, simple_room
from dlgmd_cli.lab.flights.scene import FlightOptions, FlightScene
from dlgmd_cli.lab.flights.textures import Rng
from dlgmd_cli.lab.stimuli.base import Scene
from dlgmd_cli.lab.stimuli.looming import Approach, ApproachOptions
from dlgmd_cli.lab.stimuli.translating import Translation, TranslationOptions

NAMED_FLIGHTS = Path(__file__).with_name("scenes.yaml")
_ROOMS = {"cluttered": cluttered_room, "simple": simple_room, "corridor": corridor}
_DUSK, _OFF_WALL_M = 0.3, 0.01
# Time filmed after a collision.
_AFTER_S = 15 * FRAME_S

_LOOMING = ApproachOptions()
# Starts where the looming cube ends: each is the other played backwards.
_RECEDING = ApproachOptions(distance_m=_LOOMING.speed_m_s / _LOOMING.fps)

# Frame sizes of the paper's videos, of its simulations, and one that is fast to render.
_FULL_HD = FlightOptions(shape=(1080, 1920))
_SIMULATED = FlightOptions(shape=(600, 800))
_SMALL = FlightOptions(shape=(360, 640))


def named_flight(spec: Mapping[str, Any], seed: int, agile: bool | None = None) -> Stage:
    """The flight described by an entry of `scenes.yaml`; `seed` determines everything random.

    `agile` overrides the entry.
    """
    agile = spec.get("agile", False) if agile is None else agile
    phases = [getattr(script, name)(n / 30.0, *told) for name, n, *told in spec["flies"]]
    start = {"position_m": spec["start_m"], "yaw_deg": spec.get("yaw_deg", 0.0)}
    flight = partial(fly, phases, **start, seed=seed, agile=agile)
    free, obstacle = flight(), spec["obstacle"]
    target, hit_at = obstacle.get("target", obstacle["piece"]), obstacle.get("hit_at")
    room = dict(spec["room"])
    rng = np.random.default_rng([seed, room.pop("number", 1)])
    kind, behind_m = _ROOMS[room.pop("kind")], room.pop("behind_m", 0.0)
    if hit_at is not None:
        contact_s = hit_at * FRAME_S
        build = partial(_piece, obstacle["piece"], np.random.default_rng([seed, 2]))
        turned = obstacle.get("turned_deg", 0.0)
        obstacles = obstacle_in_path(free, contact_s, build, target, turned_deg=turned)
        end_m = max(float(body.reach(np.array([[1.0, 0.0, 0.0]]))[0]) for body in obstacles)
        place = kind(rng, **{"length_m": end_m + behind_m, **room}, obstacles=obstacles)
        path = flight(contact_s=contact_s)
        return Stage(
            build_world(place, obstacles), path, target, contact_s, contact_s + _AFTER_S, agile
        )
    room.setdefault("length_m", _x(free, free.duration_s) + behind_m)
    obstacles = _missed_obstacle(obstacle, rng, free, room["length_m"])
    world = build_world(kind(rng, **room, obstacles=obstacles), obstacles)
    if "lamps_on_at" in spec:
        on_s = spec["lamps_on_at"] / 30.0
        world = replace(world, light=lambda time_s: DAYLIGHT if time_s >= on_s else _DUSK)
    return Stage(world, free, target, None, free.duration_s, agile)


def _piece(
    name: str, rng: Rng, at_m: Sequence[float], yaw_deg: float = 0.0, motion: Motion | None = None
) -> list[Body]:
    """A piece of furniture at (x, y) on the floor, or at (x, y, z)."""
    return furniture(name, rng, placement(at_m, yaw_deg), motion=motion)


def _missed_obstacle(
    obstacle: Mapping[str, Any], rng: Rng, path: FlightPath, length_m: float
) -> list[Body]:
    """An obstacle that is not hit."""
    name = obstacle["piece"]
    if "at_frame" in obstacle:
        return _piece(name, rng, (_x(path, obstacle["at_frame"] / 30.0), obstacle["y_m"]))
    if "up_m" in obstacle:
        return _piece(name, rng, (length_m - _OFF_WALL_M, 0.0, obstacle["up_m"]), 180.0)
    walk = obstacle["walks"]

    def motion(time_s: float) -> tuple[float, float, float]:
        way = walk["m_s"] * (time_s - walk["from"] / 30.0)
        return 0.0, float(np.clip(way, 0.0, walk["way_m"])), 0.0

    return _piece(name, rng, obstacle["at_m"], obstacle["yaw_deg"], motion)


def _x(path: FlightPath, time_s: float) -> float:
    """Position along the room at a time, in m."""
    return float(path.state(time_s).position_m[0])


def _flat_scenes() -> Iterator[Scene[Any]]:
    """Plain objects on a plain background."""
    yield Approach("looming-cube", "a cube that comes straight at the camera", "cube", _LOOMING)
    yield Approach(
        "receding-cube",
        "a cube that goes straight away from the camera",
        "cube",
        _RECEDING,
        recedes=True,
    )
    yield Approach("looming-ball", "a ball that comes straight at the camera", "ball", _LOOMING)
    yield Translation(
        "translating-cubes",
        "cubes that cross the picture, each at its own speed",
        TranslationOptions(),
    )


def _flights() -> Iterator[FlightScene]:
    """First-person flights: collisions, the paper's Fig. 8, near misses, and random ones."""
    named = yaml.safe_load(NAMED_FLIGHTS.read_text("utf-8")).items()
    hits = {name for name, spec in named if "hit_at" in spec["obstacle"]}
    for name, spec in named:
        if name in hits:
            yield FlightScene(name, spec["shows"], _FULL_HD, partial(named_flight, spec))
    shows = "a looming ball, and four capsules that pass by"
    yield FlightScene("ball-and-capsules", shows, _SIMULATED, ball_and_capsules)
    for name, spec in named:
        if name not in hits:
            yield FlightScene(name, spec["shows"], _SMALL, partial(named_flight, spec))
    shows = "a random room, flight and outcome, by the seed"
    yield FlightScene("random", shows, _SMALL, random_flight)


SCENES: dict[str, Scene[Any]] = {scene.name: scene for scene in (*_flat_scenes(), *_flights())}


def find_scene(name: str) -> Scene[Any]:
    """The scene called `name`; raises ParameterError if there is none.

    Examples
    --------
    >>> scene = find_scene("looming-cube")
    >>> options = scene.configure({"--speed": 2.0, "--size": (135, 240)})
    >>> next(scene.frames(options)).shape
    (135, 240)
    """
    if name not in SCENES:
        near = nearest(name[:100], SCENES)
        hint = f"Did you mean '{near}'? " if near else ""
        raise ParameterError(
            "", f"there is no scene {name[:100]!r}", f"{hint}Choose from {', '.join(SCENES)}."
        )
    return SCENES[name]
