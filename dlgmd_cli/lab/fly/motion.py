"""A drone that follows a script: its speed is commanded, its acceleration tilts it.

The thrust of a quadrotor is along its own z axis. A drone that accelerates by a, against drag, has
that axis along a + DRAG v + g: it noses down to gain speed, and up to brake. The acceleration grows
by at most JERK, so that the tilt changes by at most JERK / g, 47 degrees/s, and this rate of the
tilt changes as ArduCopter shapes its attitude: it follows an error with a time constant, at an
angular acceleration of at most 1100 degrees/s2 (ATC_ACCEL_P_MAX).
"""

import math
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from dlgmd_cli.lab.fly.scripts import Leg, Script
from dlgmd_cli.lab.fly.textures import FloatArray

STEP_S = 1 / 240
# A slower drone has no direction of flight, in m/s.
LEAST_M_S = 0.5
# Radius of the drone: what is that near to the camera is touched.
HULL_M = 0.15
G_M_S2 = 9.81
# Of a stabilised camera drone (PX4: MPC_JERK_MAX), and of a racing drone.
JERK_M_S3, AGILE_JERK_M_S3 = 8.0, 300.0
DRAG_1_S = 0.2
# How a drone stops at an alarm, and the time that it may take after the end of its script.
BRAKE_TILT_DEG, BRAKING_S = 25.0, 4.0
_CLIMB_M_S2 = 3.0
_YAW_DEG_S2, _AGILE_YAW_DEG_S2 = 60.0, 600.0
# The last of an error of speed decays with this time constant, longer than that of the tilt, so
# that it settles without a swing.
_SPEED_S = 0.6
# The greatest angular acceleration, as the second derivative of the acceleration.
_SNAP_M_S4 = G_M_S2 * math.radians(1100.0)
# Speed of the drift of a drone in calm air, for each of three frequencies in Hz.
_DRIFT_M_S, _DRIFT_HZ = 0.025, (0.3, 0.7, 1.4)
_DRIFT_YAW_DEG_S = 0.5
# A contact throws the drone back with a share of its speed, which decays.
_REBOUND, _REBOUND_S = 0.25, 0.3


@dataclass(frozen=True)
class State:
    """Where the camera is: position and velocity in m and m/s, shape (3,), x forward at first, y to
    the left, z up; `rotation`, shape (3, 3), has the drone's axes as columns."""

    position: FloatArray
    velocity: FloatArray
    rotation: FloatArray

    @property
    def attitude_deg(self) -> tuple[float, float, float]:
        """Roll (right side down), pitch (nose up), yaw (to the right), in degrees."""
        r = self.rotation
        roll, yaw = math.atan2(r[2, 1], r[2, 2]), -math.atan2(r[1, 0], r[0, 0])
        return math.degrees(roll), math.degrees(math.asin(r[2, 0])), math.degrees(yaw)

    def heading(self, camera_tilt_deg: float) -> tuple[float, ...]:
        """Direction of flight from the axis of a tilted camera, speed, and attitude.

        To the right and upwards in degrees: NaN if the drone stands, or flies backwards.
        """
        forward, left, up = self.rotation.T @ self.velocity
        tilt, speed = math.radians(camera_tilt_deg), float(np.linalg.norm(self.velocity))
        along = math.cos(tilt) * forward + math.sin(tilt) * up
        above = math.cos(tilt) * up - math.sin(tilt) * forward
        direction = math.nan, math.nan
        if along > 0.0 and speed >= LEAST_M_S:
            direction = (
                math.degrees(math.atan2(-left, along)),
                math.degrees(math.atan2(above, along)),
            )
        return *direction, speed, *self.attitude_deg


@dataclass(frozen=True)
class Path:
    """A simulated flight: a row every `STEP_S` of position, velocity, acceleration, and yaw.

    Attributes
    ----------
    samples : ndarray, shape (n, 10)
        x, y, z; their first and second derivatives; yaw in rad.
    """

    samples: FloatArray

    def at(self, time_s: float) -> State:
        """The state at a time, between two rows."""
        row = min(max(time_s / STEP_S, 0.0), len(self.samples) - 1.0)
        low = min(int(row), len(self.samples) - 2)
        part = row - low
        now = (1 - part) * self.samples[low] + part * self.samples[low + 1]
        thrust = now[6:9] + DRAG_1_S * now[3:6] + [0.0, 0.0, G_M_S2]
        up = thrust / np.linalg.norm(thrust)
        left = np.cross(up, _heading(now[9]))
        left /= np.linalg.norm(left)
        return State(now[:3], now[3:6], np.column_stack((np.cross(left, up), left, up)))

    def rebounding(self, contact_s: float, pushed_m_s: FloatArray) -> "Path":
        """The same flight up to a contact, which throws the drone back, or along with a mover."""
        samples = self.samples.copy()
        first = math.floor(contact_s / STEP_S + 1e-6) + 1
        after_s = STEP_S * np.arange(1, len(samples) - first + 1)[:, None]
        left = np.exp(-after_s / _REBOUND_S)
        hit = samples[first - 1].copy()
        back = _REBOUND * (pushed_m_s - hit[3:6])
        samples[first:, :3] = hit[:3] + _REBOUND_S * (1 - left) * back
        samples[first:, 3:6] = left * back
        samples[first:, 6:9] = left * hit[6:9]
        samples[first:, 9] = hit[9]
        return Path(samples)


def simulated(script: Script, seed: int, brake_s: float | None = None) -> Path:
    """Fly a script.

    Parameters
    ----------
    script : Script
    seed : int
        Of the drift.
    brake_s : float, optional
        From this time on the drone brakes, with at most `BRAKE_TILT_DEG`, until it stands.
    """
    legs, ends_s = script.legs, list(accumulate(leg.seconds for leg in script.legs))
    n_steps = math.ceil((ends_s[-1] + (0.0 if brake_s is None else BRAKING_S)) / STEP_S) + 2
    jerk = AGILE_JERK_M_S3 if script.agile else JERK_M_S3
    yaw_acceleration = math.radians(_AGILE_YAW_DEG_S2 if script.agile else _YAW_DEG_S2)
    drift = _drift(n_steps, seed)
    position = np.array([0.0, 0.0, script.height_m])
    yaw, yaw_rate = math.radians(script.yaw_deg), 0.0
    velocity = script.starts_m_s * _heading(yaw)
    acceleration, growth, rows, number = np.zeros(3), np.zeros(3), [], 0
    for step in range(n_steps):
        rows.append(np.concatenate((position, velocity, acceleration, [yaw])))
        while number < len(legs) - 1 and step * STEP_S >= ends_s[number]:
            number += 1
        leg = legs[number]
        if brake_s is not None and step * STEP_S >= brake_s:
            leg = Leg("brake", 0.0, tilt_deg=BRAKE_TILT_DEG)
        still = 0.0 if leg.name == "stand" else 1.0
        forward = leg.forward_m_s * _heading(yaw)
        wanted = still * drift[step, :3] + forward + [0.0, 0.0, leg.climb_m_s]
        error = wanted - velocity
        most = G_M_S2 * math.tan(math.radians(leg.tilt_deg))
        level = _towards(error[:2], most, jerk, _SPEED_S)
        aim = np.concatenate((level, _towards(error[2:], _CLIMB_M_S2, jerk, _SPEED_S)))
        wanted_growth = _towards(aim - acceleration, jerk, _SNAP_M_S4, script.tilt_s)
        growth = growth + _limited(wanted_growth - growth, _SNAP_M_S4 * STEP_S)
        acceleration = acceleration + STEP_S * growth
        velocity = velocity + STEP_S * acceleration
        position = position + STEP_S * velocity
        turn = math.radians(leg.yaw_deg_s) + still * drift[step, 3] - yaw_rate
        yaw_rate += float(np.clip(turn, -yaw_acceleration * STEP_S, yaw_acceleration * STEP_S))
        yaw += STEP_S * yaw_rate
    return Path(np.array(rows))


def _heading(yaw: float) -> FloatArray:
    """The level direction of a yaw in rad."""
    return np.array([math.cos(yaw), math.sin(yaw), 0.0])


def _drift(n_steps: int, seed: int) -> FloatArray:
    """Speeds in m/s and rate of yaw in rad/s that a drone in calm air has, shape (n, 4)."""
    phases = np.random.default_rng([seed, 1]).uniform(0, 2 * np.pi, (len(_DRIFT_HZ), 4))
    time_s = STEP_S * np.arange(n_steps)[:, None]
    waves = [
        np.sin(2 * np.pi * hz * time_s + phase) for hz, phase in zip(_DRIFT_HZ, phases, strict=True)
    ]
    return np.sum(waves, axis=0) * [*[_DRIFT_M_S] * 3, math.radians(_DRIFT_YAW_DEG_S)]


def _towards(error: FloatArray, most: float, change: float, settle_s: float) -> FloatArray:
    """The rate, at most `most`, that removes an error and can itself end in time.

    The rate changes by at most `change` a second. The last of the error decays with the time
    constant `settle_s`.
    """
    size = float(np.linalg.norm(error))
    wanted = min(most, math.sqrt(1.6 * change * size), size / settle_s)
    return error * (wanted / max(size, 1e-9))


def _limited(vector: FloatArray, most: float) -> FloatArray:
    """A vector, shortened to a length if it is longer."""
    return vector * min(1.0, most / max(float(np.linalg.norm(vector)), 1e-12))
