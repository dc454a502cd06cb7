"""Reports from receivers to the loop of `dlgmd live`."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from dlgmd_cli.models.stopping import Brake
from dlgmd_cli.parameters.facts import Json


class Attitude(NamedTuple):
    """Roll, pitch and yaw (rad), their rates (rad/s), and when they came, by `time.monotonic`."""

    angles: tuple[float, float, float]
    rates: tuple[float, float, float]
    came_s: float

    def at(self, time_s: float) -> tuple[float, float, float]:
        """The angles at a time, in degrees."""
        after_s = time_s - self.came_s
        roll, pitch, yaw = np.degrees(np.add(self.angles, np.multiply(self.rates, after_s)))
        return float(roll), float(pitch), float(yaw)


class Reports(deque[tuple[str, dict[str, Json]]]):
    """Reports from receivers to the loop: events, each with further entries for its JSON object.

    Attributes
    ----------
    speed_m_s : float
        Speed of the drone by its autopilot; NaN if unknown.
    motion : (float, float, float) or None
        Velocity in m/s forward, to the right and upwards, along the drone's axes; None if unknown.
    attitude : Attitude or None
        The last known one.
    brake : Brake or None
        The stop that the autopilot makes, by what it told; None if unknown.
    """

    speed_m_s = math.nan
    motion: tuple[float, float, float] | None = None
    attitude: Attitude | None = None
    brake: Brake | None = None
