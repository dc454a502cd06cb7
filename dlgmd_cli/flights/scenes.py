"""The scenes by name."""

from collections.abc import Iterator
from typing import Any

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.flights.options import FlightOptions
from dlgmd_cli.flights.scene import FlightScene
from dlgmd_cli.flights.stages.ball import ball_and_capsules
from dlgmd_cli.flights.stages.groups import group1, group2, group3, group4, group5
from dlgmd_cli.flights.stages.misses import (
    along_corridor,
    light_on,
    past_pillar,
    person_crossing,
    through_doorway,
    turn_at_wall,
)
from dlgmd_cli.flights.stages.random_flight import random_flight
from dlgmd_cli.parameters import nearest
from dlgmd_cli.stimuli.base import Scene
from dlgmd_cli.stimuli.flat.approach import Approach, ApproachOptions, Ball, Cube
from dlgmd_cli.stimuli.flat.translation import Translation, TranslationOptions

_LOOMING = ApproachOptions()
# Starts where the looming cube ends, so that the one is the other played backwards.
_RECEDING = ApproachOptions(distance_m=_LOOMING.speed_m_s / _LOOMING.fps)

# The size of the paper's videos; of its simulations; and one of which hundreds are soon rendered.
_FULL_HD = FlightOptions(shape=(1080, 1920))
_SIMULATED = FlightOptions(shape=(600, 800))
_SMALL = FlightOptions(shape=(360, 640))


def _flat_scenes() -> Iterator[Scene[Any]]:
    """Plain objects on a plain background."""
    yield Approach("looming-cube", "a cube that comes straight at the camera", Cube(), _LOOMING)
    yield Approach(
        "receding-cube",
        "a cube that goes straight away from the camera",
        Cube(),
        _RECEDING,
        recedes=True,
    )
    yield Approach("looming-ball", "a ball that comes straight at the camera", Ball(), _LOOMING)
    yield Translation(
        "translating-cubes",
        "cubes that cross the picture, each at its own speed",
        TranslationOptions(),
    )


def _flights() -> Iterator[FlightScene]:
    """First-person video of places."""
    for name, shows, stage in (
        ("group1", "cluttered room; pitches, hits a chair at frame 120", group1),
        ("group2", "the same; brakes, hits a gridded pattern at 140", group2),
        ("group3", "the same; yaws in a curve, hits a notebook at 135", group3),
        ("group4", "simple room; takes off, hits a gridded pattern at 210", group4),
        ("group5", "the same; hits a carton at frame 196", group5),
    ):
        yield FlightScene(name, shows, _FULL_HD, stage)
    yield FlightScene(
        "ball-and-capsules",
        "a looming ball, and four capsules that pass by",
        _SIMULATED,
        ball_and_capsules,
    )
    for name, shows, stage in (
        ("past-pillar", "a near miss: flies past a pillar", past_pillar),
        ("through-doorway", "a near miss: flies through a doorway", through_doorway),
        ("along-corridor", "a near miss: flies along a narrow corridor", along_corridor),
        ("turn-at-wall", "a near miss: stops before a wall and turns away", turn_at_wall),
        ("light-on", "a near miss: hovers while the light is switched on", light_on),
        ("person-crossing", "a near miss: hovers while a person walks by", person_crossing),
        ("random", "a random room, flight and outcome, by the seed", random_flight),
    ):
        yield FlightScene(name, shows, _SMALL, stage)


SCENES: dict[str, Scene[Any]] = {scene.name: scene for scene in (*_flat_scenes(), *_flights())}


def find_scene(name: str) -> Scene[Any]:
    """The scene called `name`.

    Raises
    ------
    ParameterError
        If there is none.

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
