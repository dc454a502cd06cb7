"""What a flight is to do: phases in a row, each with what is commanded and for how long."""

from dataclasses import dataclass
from typing import Literal

Forward = Literal["stand", "hold", "keep", "tilt", "brake"]

# How long the propellers take to carry the weight.
SPIN_UP_S = 0.5


@dataclass(frozen=True)
class Phase:
    """A part of a flight in which one thing is commanded.

    Attributes
    ----------
    forward : str
        What happens to the speed along the nose: "stand" on the floor, "hold" the position,
        "keep" the speed there was at first, "tilt" by `pitch_deg` whatever the speed, or "brake"
        with `pitch_deg` and then hold the position.
    pitch_deg, roll_deg, yaw_rate_deg_s : float
        Nose up, right side down, and counter-clockwise as seen from above are positive. Without a
        roll, it banks as far as it takes not to slip sideways.
    climb_m : float
        How far it rises; at most about 1.4 (seconds - 0.5)² m can be flown.
    """

    name: str
    seconds: float
    forward: Forward
    pitch_deg: float = 0.0
    roll_deg: float | None = None
    yaw_rate_deg_s: float = 0.0
    climb_m: float = 0.0


def stand(seconds: float) -> Phase:
    """Stand on the floor with the propellers off; only before the first take-off."""
    return Phase("stand", seconds, "stand")


def take_off(seconds: float, height_m: float, pitch_deg: float = 0.0) -> Phase:
    """Rise by `height_m`, on the spot or with the nose up or down.

    As the first phase, or after `stand`, the propellers spin up before the drone leaves the floor;
    otherwise it climbs from where it is.
    """
    return Phase("take off", seconds, "tilt" if pitch_deg else "hold", pitch_deg, climb_m=height_m)


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
    """Lose speed with the nose up, by a positive angle, and then hold the position."""
    return Phase("decelerate", seconds, "brake", pitch_deg)


def yaw(seconds: float, rate_deg_s: float, pitch_deg: float = 0.0) -> Phase:
    """Turn about the vertical; on the spot, or in a curve.

    The forward speed stays what it was, or the nose where it was, if that is given.
    """
    forward: Forward = "tilt" if pitch_deg else "keep"
    return Phase("yaw", seconds, forward, pitch_deg, yaw_rate_deg_s=rate_deg_s)


def weave(
    seconds: float, pitch_deg: float, roll_deg: float, yaw_rate_deg_s: float, climb_m: float
) -> Phase:
    """Do it all at once: gain or lose speed, lean, turn and climb or sink."""
    return Phase("weave", seconds, "tilt", pitch_deg, roll_deg, yaw_rate_deg_s, climb_m)


def roll(seconds: float, roll_deg: float) -> Phase:
    """Lean to the right (positive) or left (negative) and slip there, at the forward speed."""
    return Phase("roll", seconds, "keep", roll_deg=roll_deg)
