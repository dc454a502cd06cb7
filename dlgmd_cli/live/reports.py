"""What receivers report to the loop of `dlgmd live`."""

import math
from collections import deque

from dlgmd_cli.parameters.facts import Json


class Reports(deque[tuple[str, dict[str, Json]]]):
    """What receivers report to the loop: events, each with further entries for its object.

    Attributes
    ----------
    speed_m_s : float
        Speed of the drone by its autopilot; NaN if it is unknown.
    motion : (float, float, float) or None
        Its velocity in m/s forward, to the right and upwards, along its own axes, if it is known.
    """

    speed_m_s = math.nan
    motion: tuple[float, float, float] | None = None
