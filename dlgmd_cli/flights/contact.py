"""When a flight first touches something."""

import math
from collections.abc import Callable, Collection

import numpy as np
import numpy.typing as npt

from dlgmd_cli.flights.nearest import Nearest
from dlgmd_cli.flights.path import Path
from dlgmd_cli.flights.renderer.camera import FloatArray
from dlgmd_cli.flights.renderer.solids import Surfaces, World
from dlgmd_cli.flights.stage import REACH_M

# Distances are looked at no less often than this, and no more often than that.
_LONGEST_S, _SHORTEST_S = 0.02, 0.002
# What the drone or a body may gain in speed until the next look.
_MARGIN_M_S = 0.5
_N_HALVINGS = 40
# A flight that is thrown back by what it touches is within reach for an instant only, but for
# rounding.
_ROUNDING_M = 1e-6


class Surroundings:
    """What there is to hit in a world.

    Parameters
    ----------
    world : World
    names : collection of str, optional
        Only bodies with these names count, and the room only if its own is one of them; by
        default everything does.
    """

    def __init__(self, world: World, names: Collection[str] | None = None) -> None:
        bodies = [body for body in world.bodies if names is None or body.name in names]
        self._surfaces = Surfaces(bodies)
        self._nearest = Nearest(self._surfaces)
        walls = world.room.faces if names is None or world.room.name in names else ()
        self._normals = np.array([wall.normal for wall in walls]).reshape(-1, 3)
        self._levels = np.array([wall.normal @ wall.corners_m[0] for wall in walls])

    def distances(self, position_m: FloatArray, time_s: float) -> FloatArray:
        """From a point to each body, and then to the plane of each of the room's faces, in m.

        Behind such a plane it is negative.
        """
        to_bodies = self._nearest.distances(position_m, time_s)
        return np.concatenate([to_bodies, self._normals @ position_m - self._levels])

    def top_speed(self, time_s: float) -> float:
        """Of the bodies, in m/s."""
        velocities = self._surfaces.velocities(time_s)
        return float(np.sqrt((velocities**2).sum(axis=-1)).max(initial=0.0))


def first_contact(
    path: Path, world: World, target_names: Collection[str] | None = None
) -> float | None:
    """When something first comes within `REACH_M` of the camera.

    What is that near from the start on, such as the floor that the drone stands on, counts only
    once it has been farther away.

    Parameters
    ----------
    path : Path
    world : World
    target_names : collection of str, optional
        See `Surroundings`.

    Returns
    -------
    float or None
        In s; None if nothing ever does.
    """
    surroundings = Surroundings(world, target_names)

    def distances(time_s: float) -> FloatArray:
        return surroundings.distances(path.state(time_s).position_m, time_s)

    blows = [stretch.start_s for stretch in path.stretches[1:]]
    time, was = 0.0, distances(0.0)
    clear = was > REACH_M
    while time < path.duration_s and len(was):
        speed = float(np.linalg.norm(path.state(time).velocity_m_s))
        fastest = speed + surroundings.top_speed(time) + _MARGIN_M_S
        gap = float((was[clear] - REACH_M).min(initial=math.inf))
        step = min(max(gap / fastest, _SHORTEST_S), _LONGEST_S)
        later = min(time + step, path.duration_s, *(blow for blow in blows if blow > time))
        now = distances(later)
        touched = clear & (now <= REACH_M + _ROUNDING_M)
        if touched.any():
            return _bisected(distances, touched, time, later)
        clear |= now > REACH_M
        time, was = later, now
    return None


def _bisected(
    distances: Callable[[float], FloatArray],
    touched: npt.NDArray[np.bool_],
    start: float,
    end: float,
) -> float:
    """The time from which on one of those that are touched in the end is."""
    for _ in range(_N_HALVINGS):
        middle = 0.5 * (start + end)
        if (distances(middle)[touched] <= REACH_M).any():
            end = middle
        else:
            start = middle
    return end
