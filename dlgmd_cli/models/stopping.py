"""The stop of whoever brakes, the time that an alarm needs for it, and thresholds by it."""

import math
from dataclasses import dataclass, replace

from dlgmd_cli.errors import ParameterError, argument, warn
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.parameters.checks import Spec, in_argument
from dlgmd_cli.parameters.keys import Parameters, changed

GRAVITY_M_S2 = 9.81
# A threshold that follows the speed adds this margin (s) to the time that a stop needs; it is
# never later than that of the parameters.
MARGIN_S = 0.2
# Below this speed (m/s), a drone counts as standing: the speed changes no threshold.
STANDING_M_S = 0.3
# Up to this speed (m/s), most rendered collisions are in time, see docs/lab/held-out.md.
_FASTEST_M_S = 3.0

# Who brakes, by name, or as a number.
ARDUCOPTER, PX4, TILT, DECELERATION, SECONDS = "arducopter", "px4", "tilt", "m/s²", "s"

# ArduCopter: BRAKE_MODE_DECEL_RATE, which is compiled in (m/s²), the default of PSC_JERK_XY
# (m/s³), and the greatest deceleration by the default of ANGLE_MAX, 30°.
ARDUCOPTER_DECEL_M_S2, ARDUCOPTER_JERK_M_S3 = 7.5, 5.0
_LEAN_M_S2 = GRAVITY_M_S2 * math.tan(math.radians(30.0))
# It limits the jerk to half the root of the deceleration times g times ATC_ACCEL_P_MAX (1100 °/s²).
_MOST_JERK_M_S3 = 0.5 * math.sqrt(ARDUCOPTER_DECEL_M_S2 * GRAVITY_M_S2 * math.radians(1100.0))
# What its attitude lags behind the shaped deceleration (s): the one number that was fitted.
_ATTITUDE_S = 0.08
# The tilt of a controller of one's own, unless given.
_TILT_DEG = 25.0
# PX4: the default of MPC_ACC_HOR (m/s²), and the time that its stop point allows for the jerk (s).
_PX4_M_S2, _PX4_S = 3.0, 0.6

_REACT, _SPEED = Spec(float, 0, 10), Spec(float, STANDING_M_S, 100)
_TILT, JERK = Spec(float, 5, 45), Spec(float, 0.1, 1000)
_DECELERATION, _SECONDS = Spec(float, 0.1, 100), Spec(float, 0, 30, low_open=True)
_HINT = "Write arducopter, arducopter:20, px4, tilt, a time as 1.7s, or a deceleration in m/s²."


@dataclass(frozen=True)
class Brake:
    """Who brakes after an alarm, and how the drone then stops; `Brake.parse` reads it from text.

    Attributes
    ----------
    who : str
        `arducopter`, its mode BRAKE; `px4`, its mode Hold; `tilt`, a controller of one's own;
        `m/s²`, a deceleration; `s`, a stop whose distance is proportional to the speed.
    number : float
        In this order: PSC_JERK_XY in m/s³; unused; the largest tilt in degrees; the deceleration in
        m/s²; distance over speed in s.
    jerk_m_s3 : float
        Growth of the deceleration per second; only for `tilt`.
    react_s : float
        Time from the alarm to the first command, during which the drone keeps its speed.

    Notes
    -----
    *ArduCopter* shapes its velocity v (`shape_vel_accel_xy` in AP_Math/control.cpp): the
    deceleration aims at v/τ, with τ = A/j, A = 7.5 m/s² (BRAKE_MODE_DECEL_RATE) and
    j = `PSC_JERK_XY`, and grows by at most j. It therefore grows for t = 2v / (√(A² + 2jv) + A),
    then the speed decays exponentially. With the lag of the attitude, T = 0.08 s, the distance is

        d = v·T + v·t − j·t³/6 + A·τ·t.

    If j·t exceeds the deceleration a that a lean of 30° (ANGLE_MAX) gives, the deceleration stays
    at a until v is a·τ: to the d of a tilt (below), v·T + a·τ²/2 is added. AC_PosControl limits
    j to 18.8 m/s³ (by ATC_ACCEL_P_MAX), however large `PSC_JERK_XY` is. T is the one number that
    was fitted: it brings the distances of six stops of ArduCopter 4.7-dev in its simulator, at 1 to
    5 m/s and a jerk of 5, 10 and 20, within 7 %.

    *PX4*, by its source alone, was not flown: its Navigator (`preproject_stop_point`) puts the
    point of Hold at d = v²/(2·MPC_ACC_HOR) + 0.6 s·v ahead, with MPC_ACC_HOR = 3 m/s². The jerk
    MPC_JERK_AUTO cancels out.

    *A tilt* decelerates by min(j·t, a) until the drone stands, with a = g·tan(tilt):

        d = v²/(2a) + v·a/(2j) − a³/(24j²)   if v ≥ a²/(2j): the deceleration reaches a;
        d = ⅔·v·√(2v/j)                      if v < a²/(2j): the drone stands before that.

    *A deceleration* a has d = v²/(2a).
    """

    who: str = ARDUCOPTER
    number: float = 20.0
    jerk_m_s3: float = 8.0
    react_s: float = 0.1

    @classmethod
    def parse(cls, how: str | float) -> "Brake":
        """The brake in a text as `arducopter:20`, `px4` or `1.7s`; raises ParameterError."""
        text = str(how).strip().lower()
        name, colon, jerk = text.partition(":")
        try:
            if name == ARDUCOPTER:
                return cls(name, JERK.parse(jerk) if colon else ARDUCOPTER_JERK_M_S3)
            if text in (PX4, TILT):
                return cls(text, _TILT_DEG)
            if text.endswith("s"):
                return cls(SECONDS, _SECONDS.parse(text[:-1]))
            return cls(DECELERATION, _DECELERATION.parse(text))
        except ParameterError as error:
            raise ParameterError("", error.why, _HINT) from None

    @property
    def text(self) -> str:
        """The brake as `parse` reads it."""
        number = f"{self.number:g}"
        if self.who == ARDUCOPTER:
            return ARDUCOPTER if self.number == ARDUCOPTER_JERK_M_S3 else f"{ARDUCOPTER}:{number}"
        return {DECELERATION: number, SECONDS: f"{number}s"}.get(self.who, self.who)

    def __str__(self) -> str:
        number = f"{self.number:g}"
        how = {
            ARDUCOPTER: f"BRAKE of ArduCopter with PSC_JERK_XY {number}",
            PX4: "Hold of PX4, by its source",
            TILT: f"{number}° of tilt, {self.jerk_m_s3:g} m/s³ of jerk",
            DECELERATION: f"{number} m/s² at once",
            SECONDS: f"{number} s times the speed",
        }
        return f"{self.react_s:g} s of reaction, {how[self.who]}"

    def distance_m(self, speed_m_s: float) -> float:
        """The distance in m from the first command to the stop; NaN if the speed is NaN."""
        return speed_m_s * self._travel_s(speed_m_s)

    def stop_s(self, speed_m_s: float) -> float:
        """How long before contact an alarm must begin: the reaction, and distance over speed."""
        return self.react_s + self._travel_s(speed_m_s)

    def _travel_s(self, v: float) -> float:
        """The distance over the speed `v`, in s."""
        if self.who == ARDUCOPTER:
            return _arducopter_s(v, min(self.number, _MOST_JERK_M_S3))
        if self.who == PX4:
            return v / (2.0 * _PX4_M_S2) + _PX4_S
        if self.who == TILT:
            return _ramp_s(v, GRAVITY_M_S2 * math.tan(math.radians(self.number)), self.jerk_m_s3)
        return self.number if self.who == SECONDS else v / (2.0 * self.number)


def _ramp_s(v: float, a: float, j: float) -> float:
    """Distance over speed of a stop with the deceleration min(j·t, a)."""
    if v < a**2 / (2.0 * j):
        return 2.0 / 3.0 * math.sqrt(2.0 * v / j)
    return v / (2.0 * a) + a / (2.0 * j) - a**3 / (24.0 * j**2 * v)


def _arducopter_s(v: float, j: float) -> float:
    """Distance over speed of a stop by ArduCopter's mode BRAKE with the jerk `j`."""
    decel, tau = ARDUCOPTER_DECEL_M_S2, ARDUCOPTER_DECEL_M_S2 / j
    share = 2.0 / (math.sqrt(decel**2 + 2.0 * j * v) + decel)  # t / v
    t = v * share
    if j * t > _LEAN_M_S2:
        return _ATTITUDE_S + _ramp_s(v, _LEAN_M_S2, j) + _LEAN_M_S2 * tau**2 / (2.0 * v)
    return _ATTITUDE_S + t + share * (decel * tau - j * t**2 / 6.0)


# Whose stops stand side by side in tables, by the end of the columns' names.
BRAKES = {
    brake.text.replace(":", "_"): brake
    for brake in map(Brake.parse, (ARDUCOPTER, f"{ARDUCOPTER}:20", TILT))
}


def brake_of(
    brake: str | float | None = None,
    react: float = Brake.react_s,
    tilt: float | None = None,
    jerk: float | None = None,
) -> Brake:
    """The `Brake` for a user's arguments, `arducopter:20` unless given; raises ParameterError."""
    with in_argument("react"):
        react_s = _REACT.check(react)
    with in_argument("brake"):
        chosen = Brake() if brake is None else Brake.parse(brake)
    if (tilt, jerk) != (None, None):
        if brake is not None and chosen.who != TILT:
            why = f"{argument('tilt')} and {argument('jerk')} exclude {argument('brake', brake)}"
            raise ParameterError("", why, f"Leave one out, or give {argument('brake', TILT)}.")
        chosen = Brake(TILT, _TILT_DEG)
    with in_argument("tilt"):
        number = chosen.number if tilt is None else _TILT.check(tilt)
    with in_argument("jerk"):
        jerk_m_s3 = chosen.jerk_m_s3 if jerk is None else JERK.check(jerk)
    return replace(chosen, number=number, jerk_m_s3=jerk_m_s3, react_s=react_s)


def speed_of(speed: float | str) -> float:
    """A checked speed in m/s; raises ParameterError."""
    with in_argument("speed_m_s"):
        return float(_SPEED.parse(str(speed)))


def too_fast(speed_m_s: float) -> str:
    """Why not to brake by the alarm at this speed; empty if it was measured, or is unknown."""
    if not speed_m_s > _FASTEST_M_S:
        return ""
    return (
        f"do not brake by the alarm above {_FASTEST_M_S:g} m/s: at 5 m/s, 4 of 12 rendered "
        "collisions were in time"
    )


def followed_speed(speed: float | str) -> float:
    """A speed for a threshold in m/s; warns if it is `too_fast`, and raises as `speed_of`."""
    speed_m_s = speed_of(speed)
    if line := too_fast(speed_m_s):
        warn(line)
    return speed_m_s


def require_followed(params: Parameters, threshold: float | None = None) -> None:
    """Raise ParameterError if the threshold cannot follow a speed, or is given as well."""
    speed = argument("speed_m_s")
    if threshold is not None:
        why = f"{speed} and {argument('threshold')} exclude each other"
        raise ParameterError("", why, "Give one of them.")
    if not rule_of(params).follows_speed:
        why = f"{speed} works only with the rules expansion, corridor and ttc"
        raise ParameterError("", why, f"Add {argument('alarm', 'expansion')}.")


def following(params: Parameters, brake: Brake, speed_m_s: float) -> Parameters:
    """Parameters whose thresholds leave time for a stop at this speed plus `MARGIN_S`, or more.

    They are unchanged if the drone stands (below `STANDING_M_S`), or its speed is NaN. No speed
    that an autopilot reports causes an error, see `Rule.threshold_at`.
    """
    if not speed_m_s >= STANDING_M_S:
        return params
    rule = rule_of(params)
    return changed(params, **rule.thresholds_at(brake.stop_s(speed_m_s) + MARGIN_S))
