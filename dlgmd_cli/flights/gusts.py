"""What disturbs a hovering drone: wind, and an attitude that is never quite still."""

import math

import numpy as np

# Standard deviation and time constant, in s, of each disturbance in the order of a row: wind
# along x, y and z in m/s²; roll and pitch in rad; yaw rate in rad/s. Together they shift a
# hovering drone by about a centimetre.
_KINDS = (
    *((0.02, 0.8), (0.02, 0.8), (0.1, 0.8)),
    *((math.radians(0.25), 0.2), (math.radians(0.25), 0.2), (math.radians(1.0), 0.4)),
)

Gust = tuple[float, ...]
CALM: Gust = (0.0,) * len(_KINDS)


def gusts(n_steps: int, step_s: float, seed: int, strength: float) -> list[Gust]:
    """Disturbances at each step: Ornstein-Uhlenbeck processes, from their usual level on.

    Parameters
    ----------
    n_steps : int
        A longer flight begins with the disturbances of a shorter one.
    step_s : float
    seed : int
    strength : float
        Factor on all of them; 0 is still air.

    Returns
    -------
    list of tuple
        Wind along x, y and z in m/s², roll and pitch in rad, yaw rate in rad/s.
    """
    if strength == 0.0:
        return [CALM] * n_steps
    normal = np.random.default_rng(seed).standard_normal((n_steps, len(_KINDS)))
    channels = []
    for (deviation, memory_s), column in zip(_KINDS, normal.T.tolist(), strict=True):
        kept = math.exp(-step_s / memory_s)
        fresh = math.sqrt(1.0 - kept * kept)
        level, levels = column[0], []
        for number in column:
            levels.append(strength * deviation * level)
            level = kept * level + fresh * number
        channels.append(levels)
    return list(zip(*channels, strict=True))
