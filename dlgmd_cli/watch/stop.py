"""The stop that the autopilot makes: what it is asked, what is told, and whether alarms suffice."""

import math
import time
from collections.abc import Callable
from dataclasses import replace

from dlgmd_cli import Rule
from dlgmd_cli.models.stopping import ARDUCOPTER, MARGIN_S, STANDING_M_S, Brake
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
        The rule that raises the alarms; None for no warning.
    react_s : float
        Time from the alarm to the first command.

    Attributes
    ----------
    brake : Brake or None
        The stop; None if it is unknown, or not known yet.
    """

    def __init__(
        self, pilot: Autopilot, ask: Callable[[str], None], rule: Rule | None, react_s: float
    ) -> None:
        self._pilot, self._ask, self._rule, self._react_s = pilot, ask, rule, react_s
        self.brake: Brake | None = None
        self._n_asked, self._asked_s, self._has_warned = 0, -math.inf, False

    def step(self) -> None:
        """Find out the stop; ArduCopter is asked whenever it is heard anew, until it answers."""
        pilot, now_s = self._pilot, time.monotonic()
        if not pilot.is_heard:
            self._n_asked, self._asked_s = 0, -math.inf
            return
        is_copter, jerk = pilot.who_brakes == ARDUCOPTER, pilot.jerk
        is_due = now_s - self._asked_s >= ASK_S and (jerk is None or self._n_asked == 0)
        if is_copter and is_due and self._n_asked < MAX_ASKED:
            self._n_asked, self._asked_s = self._n_asked + 1, now_s
            for name in JERKS:
                self._ask(name)
        elif is_copter and jerk is not None:
            self.brake = Brake(ARDUCOPTER, jerk[1], react_s=self._react_s)
        elif pilot.who_brakes and (is_due or not is_copter):
            self.brake = replace(Brake.parse(pilot.who_brakes), react_s=self._react_s)

    def facts(self) -> dict[str, Json]:
        """The entries of an event: the brake as an argument, and what told it."""
        if self.brake is None:
            return {}
        by, jerk = "default", self._pilot.jerk
        if self.brake.who == ARDUCOPTER:
            by = "default, no valid answer" if jerk is None else jerk[0]
        return {"brake": self.brake.text, "brake_by": by}

    def warning(self) -> str:
        """A line, once, if the drone flies too fast for an alarm at the threshold; else empty.

        The threshold is that of the parameter, also where it follows the speed.
        """
        pilot, brake, rule, speed_m_s = self._pilot, self.brake, self._rule, self._pilot.speed_m_s
        is_flying = pilot.is_heard and pilot.is_armed and speed_m_s >= STANDING_M_S
        if self._has_warned or rule is None or brake is None or not is_flying:
            return ""

        # A stop of no time needs no other thresholds than those of the parameters.
        usual = rule.thresholds_at(0.0)

        def lowered(jerk_m_s3: float) -> dict[str, float]:
            time_s = replace(brake, number=jerk_m_s3).stop_s(speed_m_s)
            needed = rule.thresholds_at(time_s + MARGIN_S)
            return {key: one for key, one in needed.items() if one != usual[key]}

        if not (needed := lowered(brake.number)):
            return ""
        self._has_warned, cure = True, ""
        if brake.who == ARDUCOPTER and brake.number < _JERKS_M_S3[-1]:
            jerk_m_s3 = next((one for one in _JERKS_M_S3 if not lowered(one)), _JERKS_M_S3[-1])
            name = (pilot.jerk or JERKS)[0]
            cure = f"set {name} to {jerk_m_s3:g}, which makes every change of speed harder, or "
        return (
            f"at {speed_m_s:.1f} m/s, {' and '.join(f'{key} {usual[key]:g}' for key in needed)} is "
            f"too late for a stop ({brake.stop_s(speed_m_s):.1f} s before contact: {brake}); "
            f"{cure}{' and '.join(f'{key} must be {one:.2g}' for key, one in needed.items())}, "
            "which has more false alarms"
        )
