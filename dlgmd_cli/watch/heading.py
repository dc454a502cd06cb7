"""The direction of flight in the camera's image, from the motion that the autopilot reports."""

import math
import time

from dlgmd_cli.models.corridor import Motion
from dlgmd_cli.models.windows import Camera, Direction
from dlgmd_cli.parameters.facts import Json
from dlgmd_cli.watch.reports import Reports

# Event: the direction of flight becomes known or unknown, or unknown for another reason.
HEADING = "heading"
# Below LEAST_M_S, a drone has no direction. A known direction is kept down to KEPT_M_S, so that a
# drone near the limit does not report a change at every frame.
LEAST_M_S, KEPT_M_S = 0.5, 0.4
# Seconds for which a reported attitude and velocity are valid.
MOTION_FRESH_S = 1.0
_UNSEEN = "the camera does not see where the drone flies"

# Along the drone's own axes, in m/s: forward, to the right, upwards.
Velocity = tuple[float, float, float]


def along_axes(
    north_east_down: tuple[float, float, float], roll_pitch_yaw: tuple[float, float, float]
) -> Velocity:
    """A velocity (m/s) along the axes of a drone with this attitude (rad)."""
    north, east, down = north_east_down
    roll, pitch, yaw = roll_pitch_yaw
    ahead = math.cos(yaw) * north + math.sin(yaw) * east
    right = math.cos(yaw) * east - math.sin(yaw) * north
    forward = math.cos(pitch) * ahead - math.sin(pitch) * down
    below = math.sin(pitch) * ahead + math.cos(pitch) * down
    return (
        forward,
        math.cos(roll) * right + math.sin(roll) * below,
        math.sin(roll) * right - math.cos(roll) * below,
    )


def direction_of(motion: Velocity, tilt_deg: float) -> Direction | None:
    """The direction of flight from the axis of a tilted camera; None for backwards flight."""
    forward, right, up = motion
    tilt = math.radians(tilt_deg)
    along = math.cos(tilt) * forward + math.sin(tilt) * up
    above = math.cos(tilt) * up - math.sin(tilt) * forward
    if along <= 0.0:
        return None
    return math.degrees(math.atan2(right, along)), math.degrees(math.atan2(above, along))


class Heading:
    """The motion by an autopilot; reports when its direction becomes known or unknown.

    Parameters
    ----------
    reports : Reports
        Source of the motion that the autopilot reports; receives the events.
    """

    def __init__(self, reports: Reports) -> None:
        self._reports, self._shape = reports, (0, 0)
        self._camera: Camera | None = None
        self._why: str | None = None

    def look(self, camera: Camera, small_wh: tuple[int, int]) -> None:
        """Set the camera and the size of the images to which directions refer from now on."""
        self._camera, self._shape = camera, small_wh[::-1]

    def motion(self) -> Motion:
        """The reported motion now; what is unknown is NaN."""
        motion, why = self._found()
        if why != self._why:
            self._why = why
            facts: dict[str, Json] = {"by": "default", "why": why}
            if not why:
                right_deg, up_deg = motion.direction
                facts = {"by": "autopilot", "right_deg": round(right_deg, 1)}
                facts["up_deg"] = round(up_deg, 1)
            self._reports.append((HEADING, facts))
        return motion

    def _found(self) -> tuple[Motion, str]:
        """The reported motion, and why the default direction holds; empty if it does not."""
        velocity, attitude, now_s = self._reports.motion, self._reports.attitude, time.monotonic()
        assert self._camera is not None  # `look` comes first
        nowhere, angles = Motion().direction, tuple[float, ...]()
        if attitude is not None and now_s - attitude.came_s <= MOTION_FRESH_S:
            angles = attitude.at(now_s)
        if velocity is None:
            # The attitude alone tells of turns.
            why = f"no attitude and velocity within {MOTION_FRESH_S:g} s"
            return Motion(nowhere, math.nan, *angles), why
        speed_m_s = math.hypot(*velocity)
        if speed_m_s < (KEPT_M_S if self._why == "" else LEAST_M_S):
            return Motion(nowhere, speed_m_s, *angles), f"slower than {LEAST_M_S:g} m/s"
        direction = direction_of(velocity, self._camera.tilt_deg)
        if direction is None:
            return Motion(nowhere, speed_m_s, *angles), _UNSEEN
        is_seen = self._camera.window(self._shape, direction) is not None
        return Motion(direction, speed_m_s, *angles), "" if is_seen else _UNSEEN
