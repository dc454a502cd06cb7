"""Flying a script: a point mass with an attitude, whose thrust points along its own up."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.flights.craft import (
    ATTITUDE_RAD_S,
    DRAG_1_S,
    GRAVITY_M_S2,
    MAX_THRUST_M_S2,
    MOTOR_LAG_S,
    YAW_LAG_S,
    Craft,
)
from dlgmd_cli.flights.gusts import Gust, gusts
from dlgmd_cli.flights.path import Path, Stretch
from dlgmd_cli.flights.pilot import Orders, Pilot
from dlgmd_cli.flights.script import Phase, hover

STEP_S = 0.001
MAX_SPEED_M_S, MAX_JITTER = 30.0, 20.0
# Of a blow: the share of the speed that it leaves, backwards, the greatest angle by which it
# throws the nose up, that for each m/s of speed, and how far the drone backs off.
RESTITUTION = 0.25
_MAX_KICK_DEG, _KICK_DEG_PER_M_S = 12.0, 4.0
_BACK_OFF_M = 0.25


def fly(
    script: Sequence[Phase],
    *,
    position_m: npt.ArrayLike,
    yaw_deg: float = 0.0,
    speed_m_s: float = 0.0,
    seed: int = 0,
    jitter: float = 1.0,
    contact_s: float | None = None,
) -> Path:
    """Fly a script.

    Parameters
    ----------
    script : sequence of Phase
        If it begins with `stand` or `take_off`, the drone stands on the floor at first; else it
        is in the air.
    position_m : array_like, shape (3,)
        Where it starts.
    yaw_deg : float
        Where its nose points at first.
    speed_m_s : float
        How fast it flies at first, along its nose.
    seed : int
        Of what disturbs it. The same script and seed are the same flight to the last bit.
    jitter : float
        How much it is disturbed; 0 is still air.
    contact_s : float, optional
        When it hits something: it is thrown back, and hovers near by instead of what the script
        says, as a phase called "collision". Until then, that time included, the flight is what
        it is without. A time at or after the end changes nothing.

    Returns
    -------
    Path

    Raises
    ------
    ParameterError
        If the script is empty or stands on the floor later on, or a number is out of its range.
    """
    _check(script, speed_m_s, jitter, contact_s)
    starts = [0.0]
    for each in script:
        starts.append(starts[-1] + each.seconds)
    phases = tuple(
        (phase.name, start, end)
        for phase, start, end in zip(script, starts[:-1], starts[1:], strict=True)
    )
    duration = starts[-1]
    n_steps = math.ceil(duration / STEP_S) + 2
    air = gusts(n_steps, STEP_S, seed, jitter)
    craft = _start(script[0], position_m, yaw_deg, speed_m_s)
    pilot = Pilot(craft)
    begins = {round(start / STEP_S): phase for start, phase in zip(starts, script, strict=False)}
    hits = contact_s is not None and contact_s < duration
    n_before = math.floor(contact_s / STEP_S) + 1 if contact_s is not None and hits else n_steps
    samples = [craft.sample()]
    for index in range(min(n_before, n_steps)):
        if index in begins:
            pilot.begin(begins[index], craft, index * STEP_S)
        _advance(craft, pilot.steer(craft, index * STEP_S, STEP_S), air[index])
        samples.append(craft.sample())
    first = Stretch(0.0, STEP_S, np.array(samples))
    if contact_s is None or not hits:
        return Path((first,), phases)
    after = _after(first, craft, contact_s, air[n_before:], seed)
    until = tuple((name, start, min(end, contact_s)) for name, start, end in phases)
    kept = tuple(phase for phase in until if phase[1] < contact_s)
    return Path((first, after), (*kept, ("collision", contact_s, duration)))


def _check(
    script: Sequence[Phase], speed_m_s: float, jitter: float, contact_s: float | None
) -> None:
    """Refuse what cannot be flown."""
    if not 0.0 <= speed_m_s <= MAX_SPEED_M_S:
        raise ParameterError("speed_m_s", f"{speed_m_s:g} is not 0 to {MAX_SPEED_M_S:g}")
    if not 0.0 <= jitter <= MAX_JITTER:
        raise ParameterError("jitter", f"{jitter:g} is not 0 to {MAX_JITTER:g}")
    if not script:
        raise ParameterError("the flight's script", "it has no phase")
    if contact_s is not None and not contact_s > 0.0:
        raise ParameterError("contact_s", f"{contact_s:g} is not above 0")
    first_in_air = next((i for i, p in enumerate(script) if p.forward != "stand"), len(script))
    if any(phase.forward == "stand" for phase in script[first_in_air:]):
        raise ParameterError("the flight's script", "it stands on the floor after having flown")
    if 0 < first_in_air < len(script) and not script[first_in_air].climb_m:
        raise ParameterError("the flight's script", "it does not take off from where it stands")


def _start(first: Phase, position_m: npt.ArrayLike, yaw_deg: float, speed_m_s: float) -> Craft:
    """The drone at time 0: on the floor, or in the air and balanced for its speed."""
    x, y, z = (float(each) for each in np.asarray(position_m, float))
    yaw = math.radians(yaw_deg)
    if first.forward == "stand" or first.climb_m:
        if speed_m_s:
            raise ParameterError("speed_m_s", f"{speed_m_s:g}, but the drone stands on the floor")
        return Craft(x, y, z, yaw=yaw, stands=True)
    vx, vy = speed_m_s * math.cos(yaw), speed_m_s * math.sin(yaw)
    pitch = -math.atan2(DRAG_1_S * speed_m_s, GRAVITY_M_S2)
    thrust = GRAVITY_M_S2 / math.cos(pitch)
    return Craft(x, y, z, vx, vy, pitch=pitch, yaw=yaw, thrust=thrust)


def _advance(craft: Craft, orders: Orders, gust: Gust) -> None:
    """Let a step of time pass."""
    wind_x, wind_y, wind_z, sway, nod, swing = gust
    (cr, sr), (cp, sp) = _cos_sin(craft.roll), _cos_sin(craft.pitch)
    cy, sy = _cos_sin(craft.yaw)
    thrust = craft.thrust
    asked = min(max((GRAVITY_M_S2 + orders.lift) / (cp * cr), 0.0), MAX_THRUST_M_S2)
    craft.thrust += (asked - thrust) / MOTOR_LAG_S * STEP_S
    ahead, left = -thrust * sp * cr, -thrust * sr
    lift = thrust * cp * cr - GRAVITY_M_S2
    if craft.stands:
        if lift <= 0.0:
            return
        craft.stands = False
    ax = cy * ahead - sy * left - DRAG_1_S * craft.vx + wind_x
    ay = sy * ahead + cy * left - DRAG_1_S * craft.vy + wind_y
    az = lift - DRAG_1_S * craft.vz + wind_z
    craft.x, craft.vx = _moved(craft.x, craft.vx, ax)
    craft.y, craft.vy = _moved(craft.y, craft.vy, ay)
    craft.z, craft.vz = _moved(craft.z, craft.vz, az)
    roll_pull = ATTITUDE_RAD_S * (orders.roll + sway - craft.roll) - 2.0 * craft.roll_rate
    pitch_pull = ATTITUDE_RAD_S * (orders.pitch + nod - craft.pitch) - 2.0 * craft.pitch_rate
    yaw_pull = (orders.yaw_rate + swing - craft.yaw_rate) / YAW_LAG_S
    craft.roll, craft.roll_rate = _moved(craft.roll, craft.roll_rate, ATTITUDE_RAD_S * roll_pull)
    craft.pitch, craft.pitch_rate = _moved(
        craft.pitch, craft.pitch_rate, ATTITUDE_RAD_S * pitch_pull
    )
    craft.yaw, craft.yaw_rate = _moved(craft.yaw, craft.yaw_rate, yaw_pull)


def _moved(value: float, rate: float, pull: float) -> tuple[float, float]:
    """A value and its rate a step later; the mean rate makes them agree along the path."""
    later = rate + pull * STEP_S
    return value + 0.5 * (rate + later) * STEP_S, later


def _cos_sin(angle: float) -> tuple[float, float]:
    """Both at once."""
    return math.cos(angle), math.sin(angle)


def _after(
    before: Stretch, craft: Craft, contact_s: float, air: Sequence[Gust], seed: int
) -> Stretch:
    """What follows a blow at `contact_s`, with what disturbs the drone from then on."""
    position, velocity, angles, rates = (part.tolist() for part in before.at(contact_s))
    craft.x, craft.y, craft.z = position
    craft.roll, craft.pitch, craft.yaw = angles
    speed = math.sqrt(sum(each * each for each in velocity))
    back = [-each / speed if speed else 0.0 for each in velocity]
    craft.vx, craft.vy, craft.vz = (RESTITUTION * speed * each for each in back)
    # A kick of the rate by w turns a critically damped attitude by w / (e W) at most.
    kick = min(_MAX_KICK_DEG, _KICK_DEG_PER_M_S * speed) * ATTITUDE_RAD_S * math.e
    aside, swing = np.random.default_rng([seed, 1]).uniform(-0.5, 0.5, 2).tolist()
    craft.roll_rate = rates[0] + math.radians(kick * aside)
    craft.pitch_rate = rates[1] + math.radians(kick)
    craft.yaw_rate = rates[2] + math.radians(kick * swing)
    pilot = Pilot(craft)
    pilot.recover(hover(1.0), craft, (_BACK_OFF_M * back[0], _BACK_OFF_M * back[1]))
    samples = [craft.sample()]
    for gust in air:
        _advance(craft, pilot.steer(craft, 0.0, STEP_S), gust)
        samples.append(craft.sample())
    return Stretch(contact_s, STEP_S, np.array(samples))
