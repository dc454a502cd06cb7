"""The time before contact at which an alarm is just in time for a stop, and thresholds by it."""

import math
from dataclasses import asdict, dataclass

from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.parameters.checks import Spec, in_argument
from dlgmd_cli.parameters.keys import Parameters, changed

GRAVITY_M_S2 = 9.81
# A threshold that follows the speed adds this margin (s) to the time that a stop needs.
MARGIN_S = 0.2
# Below this speed (m/s), a drone counts as standing: the speed changes no threshold.
STANDING_M_S = 0.3

_REACT, _BRAKE = Spec(float, 0, 10), Spec(float, 0.1, 100)
_TILT, _JERK = Spec(float, 5, 45), Spec(float, 0.1, 1000)
_SPEED = Spec(float, STANDING_M_S, 100)


def stop_s(
    speed_m_s: float,
    *,
    react_s: float = 0.1,
    tilt_deg: float = 25.0,
    jerk_m_s3: float = 8.0,
    brake_m_s2: float | None = None,
) -> float:
    """How long before contact an alarm must begin for a stop, in seconds.

    Parameters
    ----------
    speed_m_s : float
        Speed v towards the obstacle; 0 or more.
    react_s : float
        Time from the alarm to the first command, during which the drone keeps its speed.
    tilt_deg : float
        Largest tilt of a stabilised drone, which gives the deceleration a = g·tan(tilt).
    jerk_m_s3 : float
        Growth j of the deceleration per second.
    brake_m_s2 : float, optional
        Deceleration a from the start, instead of tilt and jerk.

    Returns
    -------
    float
        Reaction time plus d / v, with the braking distance d; NaN if the speed is NaN.

    Notes
    -----
    The deceleration is min(j·t, a) until the drone stands, so that d follows by two integrations:

        d = v²/(2a) + v·a/(2j) − a³/(24j²)   if v ≥ a²/(2j): the deceleration reaches a;
        d = ⅔·v·√(2v/j)                      if v < a²/(2j): the drone stands before that.

    With `brake_m_s2`, j is infinite and d = v²/(2a).
    """
    v, j = speed_m_s, jerk_m_s3
    if brake_m_s2 is not None:
        return react_s + v / (2.0 * brake_m_s2)
    a = GRAVITY_M_S2 * math.tan(math.radians(tilt_deg))
    if v < a**2 / (2.0 * j):
        return react_s + 2.0 / 3.0 * math.sqrt(2.0 * v / j)
    return react_s + v / (2.0 * a) + a / (2.0 * j) - a**3 / (24.0 * j**2 * v)


@dataclass(frozen=True)
class Brakes:
    """How a drone stops after an alarm: the arguments of `stop_s`."""

    react_s: float = 0.1
    tilt_deg: float = 25.0
    jerk_m_s3: float = 8.0
    brake_m_s2: float | None = None

    def stop_s(self, speed_m_s: float) -> float:
        """How long before contact an alarm must begin for a stop, in seconds."""
        return stop_s(speed_m_s, **asdict(self))

    def __str__(self) -> str:
        if self.brake_m_s2 is not None:
            return f"{self.react_s:g} s of reaction, {self.brake_m_s2:g} m/s² at once"
        how = f"{self.tilt_deg:g}° of tilt, {self.jerk_m_s3:g} m/s³ of jerk"
        return f"{self.react_s:g} s of reaction, {how}"


def brakes_of(
    react: float = 0.1,
    brake: float | None = None,
    tilt: float | None = None,
    jerk: float | None = None,
) -> Brakes:
    """The `Brakes` for a user's arguments; raises ParameterError."""
    if brake is not None and (tilt, jerk) != (None, None):
        why = f"{argument('brake')} does not work with {argument('tilt')} or {argument('jerk')}"
        raise ParameterError("", f"{why}: it is instant", "Leave one out.")
    with in_argument("react"):
        react_s = _REACT.check(react)
    with in_argument("tilt"):
        tilt_deg = _TILT.check(Brakes.tilt_deg if tilt is None else tilt)
    with in_argument("jerk"):
        jerk_m_s3 = _JERK.check(Brakes.jerk_m_s3 if jerk is None else jerk)
    with in_argument("brake"):
        brake_m_s2 = None if brake is None else _BRAKE.check(brake)
    return Brakes(react_s, tilt_deg, jerk_m_s3, brake_m_s2)


def speed_of(speed: float | str | None, *words: str) -> float | str | None:
    """A checked speed in m/s, or one of the allowed `words` as is; raises ParameterError."""
    if speed is None or speed in words:
        return speed
    with in_argument("speed_m_s"):
        return float(_SPEED.parse(str(speed)))


def require_followed(params: Parameters, threshold: float | None = None) -> None:
    """Raise ParameterError if the threshold cannot follow a speed, or is given as well."""
    speed = argument("speed_m_s")
    if threshold is not None:
        why = f"{speed} and {argument('threshold')} exclude each other"
        raise ParameterError("", why, "Give one of them.")
    if not rule_of(params).follows_speed:
        why = f"{speed} works only with the rules expansion and ttc"
        raise ParameterError("", why, f"Add {argument('alarm', 'expansion')}.")


def following(params: Parameters, brakes: Brakes, speed_m_s: float) -> Parameters:
    """Parameters whose threshold leaves time for a stop at this speed plus `MARGIN_S`.

    They are unchanged if the drone stands (below `STANDING_M_S`), or its speed is NaN. No speed
    that an autopilot reports causes an error, see `Rule.threshold_at`.
    """
    if not speed_m_s >= STANDING_M_S:
        return params
    rule = rule_of(params)
    return changed(params, **{rule.key: rule.threshold_at(brakes.stop_s(speed_m_s) + MARGIN_S)})


def threshold_for(params: Parameters, brakes: Brakes, speed_m_s: float) -> float:
    """The threshold of a rule that is in time for a stop at a speed, see `following`."""
    return rule_of(following(params, brakes, speed_m_s)).threshold
