"""Reports from receivers to the loop of `dlgmd live`."""

import math
from collections import deque

from dlgmd_cli.models.stopping import Brake
from dlgmd_cli.parameters.facts import Json


class Reports(deque[tuple[str, dict[str, Json]]]):
    """Reports from receivers to the loop: events, each with further entries for its JSON object.

    Attributes
    ----------
    speed_m_s : float
        Speed of the drone by its autopilot; NaN if unknown.
    motion : (float, float, float) or None
        Velocity in m/s forward, to the right and upwards, along the drone's axes; None if unknown.
    brake : Brake or None
        The stop that the autopilot makes, by what it told; None if unknown.
    """

    speed_m_s = math.nan
    motion: tuple[float, float, float] | None = None
    brake: Brake | None = None
