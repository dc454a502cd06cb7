"""What a flight is to do: phases in a row, each with what is commanded and for how long."""

import math
from dataclasses import dataclass
from typing import Literal

from dlgmd_cli.errors import ParameterError

Forward = Literal["stand", "hold", "keep", "tilt", "brake"]

MAX_SECONDS = 3600.0
MAX_TILT_DEG = 45.0
MAX_YAW_RATE_DEG_S = 360.0
MAX_CLIMB_M = 100.0
# How long the propellers take to carry the weight.
SPIN_UP_S = 0.5
# A climb of h metres in T seconds along the smoothest path peaks at 10 h / (sqrt(3) T²).
MAX_CLIMB_M_S2 = 8.0


@dataclass(frozen=True)
class Phase:
    """A stretch of a flight in which one thing is commanded.

    Attributes
    ----------
    name : str
        What the truth calls it.
    seconds : float
    forward : str
        What is done about the speed along the nose: "stand" on the floor, "hold" the position,
        "keep" the speed there was at first, "tilt" by `pitch_deg` whatever the speed, or "brake"
        with `pitch_deg` and hold the position then.
    pitch_deg : float
        Nose up is positive.
    roll_deg : float or None
        Right side down is positive; None banks as it takes not to slip sideways.
    yaw_rate_deg_s : float
        Counter-clockwise as seen from above is positive.
    climb_m : float
        How far it rises.

    Raises
    ------
    ParameterError
        If a number is out of its range.
    """

    name: str
    seconds: float
    forward: Forward
    pitch_deg: float = 0.0
    roll_deg: float | None = None
    yaw_rate_deg_s: float = 0.0
    climb_m: float = 0.0

    def __post_init__(self) -> None:
        # `not <=` is also true of NaN.
        if not 0.0 < self.seconds <= MAX_SECONDS:
            raise self._error(f"{self.seconds:g} s is not above 0 and up to {MAX_SECONDS:g} s")
        for tilt in (self.pitch_deg, self.roll_deg or 0.0):
            if not abs(tilt) <= MAX_TILT_DEG:
                raise self._error(f"a tilt of {tilt:g}° is beyond {MAX_TILT_DEG:g}°")
        if not abs(self.yaw_rate_deg_s) <= MAX_YAW_RATE_DEG_S:
            raise self._error(f"{self.yaw_rate_deg_s:g}°/s is beyond {MAX_YAW_RATE_DEG_S:g}°/s")
        if self.forward == "brake" and not self.pitch_deg > 0.0:
            raise self._error(f"{self.pitch_deg:g}° is not nose up")
        if not 0.0 <= self.climb_m <= MAX_CLIMB_M:
            raise self._error(f"a climb of {self.climb_m:g} m is not 0 to {MAX_CLIMB_M:g} m")
        needed = climb_seconds(self.climb_m)
        if self.climb_m and self.seconds < needed:
            raise self._error(f"a climb of {self.climb_m:g} m takes {needed:.1f} s at least")

    def _error(self, why: str) -> ParameterError:
        """The error that blames this phase."""
        return ParameterError(f"phase '{self.name}'", why)


def climb_seconds(climb_m: float) -> float:
    """How long a take-off to a height in m takes at least, in s."""
    return SPIN_UP_S + math.sqrt(10.0 / math.sqrt(3.0) * climb_m / MAX_CLIMB_M_S2)


def stand(seconds: float) -> Phase:
    """Stand on the floor with the propellers off; only before the first take-off."""
    return Phase("stand", seconds, "stand")


def hover(seconds: float) -> Phase:
    """Stop, and hold the position."""
    return Phase("hover", seconds, "hold")


def pitch(seconds: float, pitch_deg: float) -> Phase:
    """Turn the nose up (positive) or down (negative) and leave it there."""
    return Phase("pitch", seconds, "tilt", pitch_deg)


def accelerate(seconds: float, pitch_deg: float) -> Phase:
    """Gain speed with the nose down, by a negative angle; drag sets the final speed."""
    return Phase("accelerate", seconds, "tilt", pitch_deg)


def cruise(seconds: float, yaw_rate_deg_s: float = 0.0) -> Phase:
    """Keep the forward speed there was at first, straight on or in a banked turn."""
    return Phase("cruise", seconds, "keep", yaw_rate_deg_s=yaw_rate_deg_s)


def decelerate(seconds: float, pitch_deg: float) -> Phase:
    """Lose speed with the nose up, by a positive angle, and hold the position then."""
    return Phase("decelerate", seconds, "brake", pitch_deg)


def yaw(seconds: float, rate_deg_s: float) -> Phase:
    """Turn about the vertical; on the spot, or in a curve at the forward speed there was."""
    return Phase("yaw", seconds, "keep", yaw_rate_deg_s=rate_deg_s)


def take_off(seconds: float, height_m: float, pitch_deg: float = 0.0) -> Phase:
    """Rise to `height_m` above where it stood, on the spot or with the nose up or down.

    As the first phase, or after `stand`, the propellers spin up before it leaves the floor;
    otherwise it climbs from where it is.
    """
    if not height_m > 0.0:
        raise ParameterError("phase 'take off'", f"a climb of {height_m:g} m is not above 0")
    forward: Forward = "tilt" if pitch_deg else "hold"
    return Phase("take off", seconds, forward, pitch_deg, climb_m=height_m)


def roll(seconds: float, roll_deg: float) -> Phase:
    """Lean to the right (positive) or left (negative) and slip there, at the forward speed."""
    return Phase("roll", seconds, "keep", roll_deg=roll_deg)
