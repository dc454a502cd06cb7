"""The script of a flight: a sequence of phases with their commands and durations."""

from dataclasses import dataclass
from typing import Literal

Forward = Literal["stand", "hold", "keep", "tilt", "brake"]

# Time until the propellers carry the weight.
SPIN_UP_S = 0.5


@dataclass(frozen=True)
class Phase:
    """A part of a flight with constant commands.

    Attributes
    ----------
    forward : str
        Control of the forward speed: "stand" on the floor, "hold" the position, "keep" the initial
        speed, "tilt" by `pitch_deg` regardless of the speed, or "brake" with `pitch_deg` and then
        hold the position.
    pitch_deg, roll_deg, yaw_rate_deg_s : float
        Positive for nose up, right side down, and counter-clockwise as seen from above. Without
        `roll_deg`, the drone banks so as not to slip sideways.
    climb_m : float
        Gain in height; the drone can climb at most about 1.4 (seconds - 0.5)² m.
    """

    name: str
    seconds: float
    forward: Forward
    pitch_deg: float = 0.0
    roll_deg: float | None = None
    yaw_rate_deg_s: float = 0.0
    climb_m: float = 0.0


def stand(seconds: float) -> Phase:
    """Stand on the floor with the motors off; only before the first take-off."""
    return Phase("stand", seconds, "stand")


def take_off(seconds: float, height_m: float, pitch_deg: float = 0.0) -> Phase:
    """Climb by `height_m`, vertically or with a constant pitch.

    As the first phase or after `stand`, the propellers spin up before the drone leaves the floor.
    """
    return Phase("take off", seconds, "tilt" if pitch_deg else "hold", pitch_deg, climb_m=height_m)


def hover(seconds: float) -> Phase:
    """Stop and hold the position."""
    return Phase("hover", seconds, "hold")


def pitch(seconds: float, pitch_deg: float) -> Phase:
    """Pitch up (positive) or down (negative) and keep that angle."""
    return Phase("pitch", seconds, "tilt", pitch_deg)


def accelerate(seconds: float, pitch_deg: float) -> Phase:
    """Accelerate with the nose down (a negative angle); drag limits the speed."""
    return Phase("accelerate", seconds, "tilt", pitch_deg)


def cruise(seconds: float, yaw_rate_deg_s: float = 0.0) -> Phase:
    """Keep the initial forward speed, straight on or in a banked turn."""
    return Phase("cruise", seconds, "keep", yaw_rate_deg_s=yaw_rate_deg_s)


def decelerate(seconds: float, pitch_deg: float) -> Phase:
    """Brake with the nose up (a positive angle), then hold the position."""
    return Phase("decelerate", seconds, "brake", pitch_deg)


def yaw(seconds: float, rate_deg_s: float, pitch_deg: float = 0.0) -> Phase:
    """Turn about the vertical axis, on the spot or in a curve.

    The drone keeps its forward speed or, if `pitch_deg` is given, that pitch.
    """
    forward: Forward = "tilt" if pitch_deg else "keep"
    return Phase("yaw", seconds, forward, pitch_deg, yaw_rate_deg_s=rate_deg_s)


def weave(
    seconds: float, pitch_deg: float, roll_deg: float, yaw_rate_deg_s: float, climb_m: float
) -> Phase:
    """Do everything at once: change speed, roll, turn, and climb or sink."""
    return Phase("weave", seconds, "tilt", pitch_deg, roll_deg, yaw_rate_deg_s, climb_m)


def roll(seconds: float, roll_deg: float) -> Phase:
    """Roll right (positive) or left (negative) and slip sideways, keeping the forward speed."""
    return Phase("roll", seconds, "keep", roll_deg=roll_deg)
