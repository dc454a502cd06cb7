"""Flights that are quick to render, in a module that worker processes can import."""

import os
import signal
from collections import Counter
from functools import lru_cache

import numpy as np

from dlgmd_cli.errors import OutputError
from dlgmd_cli.scenes.flights.drone import PHASES
from dlgmd_cli.scenes.flights.path import Path, Stage, Stretch
from dlgmd_cli.scenes.flights.scenes import SCENES, FlightOptions, FlightScene
from dlgmd_cli.scenes.flights.solids import Solid, Texture, World, quad

SMALL = {"size": (36, 64)}
SHAPE = (16, 32)
DURATION_S, SHORT_S = 0.6, 0.29
SHORT = 8  # the seed of the short flight
# Seeds with a collision, and when it comes.
CONTACTS_S = {1: 0.4, 3: 0.41, 5: 0.6, 7: 0.601, 11: 0.28}
WALL = Solid("wall", [quad((5, 2, 4), (0, -4, 0), (0, 0, -4), Texture([[0.5]]))])

stand, take_off, hover, pitch, accelerate, cruise, decelerate, yaw, _, roll = PHASES.values()
built = Counter()


def stage_of(seed, agile=None):
    """Straight on at 1 m/s, to a wall that some seeds reach."""
    built[seed] += 1
    start = [0.0, 0.0, 1.5, 1.0, 0, 0, 0, 0, 0, 0, 0, 0]
    end = [DURATION_S, *start[1:]]
    phases = (("hover", 0.0, 0.2), ("cruise", 0.2, 0.3), ("hover", 0.3, DURATION_S))
    path = Path([Stretch(0.0, DURATION_S, np.array([start, end]))], phases)
    room = Solid("room", WALL.faces)
    duration_s = SHORT_S if seed == SHORT else DURATION_S
    return Stage(World(room, [WALL]), path, "wall", CONTACTS_S.get(seed), duration_s, bool(agile))


@lru_cache
def scene_of(name):
    """A scene with its options, small, and the rows of its truth."""
    scene = SCENES[name]
    options = scene.configure(SMALL)
    return scene, options, list(scene.truth(options))


class Quick(FlightScene):
    """Frames of noise; `faults` has what happens to some seeds after a few of them."""

    def __init__(self, **faults):
        super().__init__("quick", "noise for an image", FlightOptions(shape=SHAPE), stage_of)
        self.faults = {int(seed.removeprefix("at_")): fault for seed, fault in faults.items()}

    def frames(self, options):
        rng = np.random.default_rng(options.seed)
        for index in range(self.n_frames(options)):
            if index == 2:
                self._fail(self.faults.get(options.seed))
            yield rng.integers(100, 140, options.shape, np.uint8)

    def _fail(self, fault):
        if fault == "error":
            raise OutputError("here", "it cannot be", "Mend it.")
        if fault == "bug":
            raise IndexError
        if fault == "interrupt":
            signal.raise_signal(signal.SIGINT)
        if fault == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
