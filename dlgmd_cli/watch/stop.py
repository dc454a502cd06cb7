"""The stop that the autopilot makes: what it is asked, what is told, and whether alarms suffice."""

import math
import time
from collections.abc import Callable
from dataclasses import replace

from dlgmd_cli import Rule
from dlgmd_cli.models.stopping import ARDUCOPTER, MARGIN_S, PX4, STANDING_M_S, Brake
from dlgmd_cli.parameters.facts import Json
from dlgmd_cli.watch.autopilot import JERKS, Autopilot

# How many times ArduCopter is asked for its parameter, and the time (s) between two tries.
MAX_ASKED, ASK_S = 3, 1.0
# Values of the parameter (m/s³) that a warning may recommend: more has no effect.
_JERKS_M_S3 = 10.0, 15.0, 20.0


class Stop:
    """Knows the stop of the first mode that brakes, `BRAKE` of ArduCopter or Hold of PX4.

    ArduCopter is asked for the parameter on which its stop depends. If it does not answer three
    times, the parameter's default is assumed. No parameter is ever written.

    Parameters
    ----------
    pilot : Autopilot
        The state of the autopilot.
    ask : callable
        Asks the autopilot for the parameter of a name.
    rule : Rule or None
        The rule that raises the alarms; None if its threshold follows the speed.
    react_s : float
        Time from the alarm to the first command.
    """

    def __init__(
        self, pilot: Autopilot, ask: Callable[[str], None], rule: Rule | None, react_s: float
    ) -> None:
        self._pilot, self._ask, self._rule, self._react_s = pilot, ask, rule, react_s
        self._n_asked, self._asked_s, self._has_warned = 0, -math.inf, False

    def step(self) -> None:
        """Ask if due: whenever ArduCopter is heard anew, until it answers."""
        if not self._pilot.is_heard:
            self._n_asked = 0
        elif self._pilot.who_brakes == ARDUCOPTER and self._may_ask():
            self._n_asked, self._asked_s = self._n_asked + 1, time.monotonic()
            for name in JERKS:
                self._ask(name)

    def _may_ask(self) -> bool:
        if self._n_asked == 0:
            return True
        is_due = time.monotonic() - self._asked_s >= ASK_S
        return self._pilot.jerk is None and is_due and self._n_asked < MAX_ASKED

    @property
    def brake(self) -> Brake | None:
        """The stop; None if it is unknown, or not known yet."""
        pilot = self._pilot
        if pilot.who_brakes == ARDUCOPTER and pilot.jerk is not None:
            return Brake(ARDUCOPTER, pilot.jerk[1], react_s=self._react_s)
        is_silent = self._n_asked == MAX_ASKED and time.monotonic() - self._asked_s >= ASK_S
        if pilot.who_brakes == PX4 or (pilot.who_brakes == ARDUCOPTER and is_silent):
            return replace(Brake.parse(pilot.who_brakes), react_s=self._react_s)
        return None

    def facts(self) -> dict[str, Json]:
        """The entries of an event: the brake as an argument, and the parameter that told it."""
        if self.brake is None:
            return {}
        jerk = self._pilot.jerk
        by = jerk[0] if jerk is not None else "default, no answer"
        known: dict[str, Json] = {"brake_by": by if self.brake.who == ARDUCOPTER else "default"}
        return {"brake": self.brake.text, **known}

    def stop_s(self) -> float:
        """How long before contact an alarm must begin at the present speed, in s; or NaN."""
        return math.nan if self.brake is None else self.brake.stop_s(self._pilot.speed_m_s)

    def warning(self) -> str:
        """A line, once, if the drone flies too fast for an alarm at the threshold; else empty."""
        pilot, brake, speed_m_s = self._pilot, self.brake, self._pilot.speed_m_s
        is_flying = pilot.is_heard and pilot.is_armed and speed_m_s >= STANDING_M_S
        if self._has_warned or self._rule is None or brake is None or not is_flying:
            return ""
        if not (needed := self._needed(brake, speed_m_s)):
            return ""
        self._has_warned, rule = True, self._rule
        enough = (j for j in _JERKS_M_S3 if not self._needed(replace(brake, number=j), speed_m_s))
        cure = ""
        if brake.who == ARDUCOPTER and brake.number < _JERKS_M_S3[-1]:
            jerk_m_s3, name = next(enough, _JERKS_M_S3[-1]), (pilot.jerk or JERKS)[0]
            cure = f"set {name} to {jerk_m_s3:g}, which makes every change of speed harder, or "
        return (
            f"at {speed_m_s:.1f} m/s, {rule.key} {rule.threshold:g} is too late for a stop "
            f"({brake.stop_s(speed_m_s):.1f} s before contact: {brake}); {cure}"
            f"set {rule.key} to {needed:.2g}, which has more false alarms"
        )

    def _needed(self, brake: Brake, speed_m_s: float) -> float:
        """The threshold for a stop from this speed; 0 if that in use suffices."""
        assert self._rule is not None
        needed, used = self._rule.threshold_at(brake.stop_s(speed_m_s) + MARGIN_S), self._rule
        is_too_late = needed > used.threshold if used.at_most else needed < used.threshold
        return needed if is_too_late else 0.0
