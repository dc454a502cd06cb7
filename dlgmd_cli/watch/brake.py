"""The command that makes an autopilot brake: when it is sent and repeated, and in which mode."""

import math
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

from dlgmd_cli.parameters.facts import Json
from dlgmd_cli.watch.autopilot import HEARD_S, Autopilot, Mode

# Events: a command is sent, withheld, answered; a heartbeat confirms the mode, or a mode that only
# holds the height; the command failed.
BRAKE, WITHHELD, ANSWERED = "brake", "brake-withheld", "brake-answer"
CONFIRMED, HELD, FAILED = "brake-confirmed", "height-held", "brake-failed"
# How many times a command is sent, and the time (s) between two tries.
MAX_TRIES, REPEAT_S = 10, 0.1
# Seconds without answer and heartbeat before the next mode is tried, and after the last try.
SILENT_S, LAST_S = 1.5, 0.5
# The least time (s) between the commands of two alarms.
LEAST_APART_S = 2.0
_NOT_ONE = "is not one of the modes"


@dataclass
class _Command:
    """A commanded mode, and the progress of the command so far."""

    mode: Mode
    first_s: float
    sent_s: float = -math.inf
    n_sent: int = 0
    answer: str = ""
    answered_s: float = math.inf

    @property
    def is_accepted(self) -> bool:
        """Whether the autopilot has accepted the command, or is executing it."""
        return self.answer in ("ACCEPTED", "IN_PROGRESS")


class Braking:
    """Commands an autopilot to brake while an alarm is on, until a heartbeat shows the mode.

    Only the mode counts, not the answer. The command is sent every 0.1 s, at most ten times; after
    ACCEPTED, the next try waits for a heartbeat. The next mode is tried after a refusal, after
    ACCEPTED and a later heartbeat with the old mode, or after 1.5 s without answer and heartbeat.
    If a condition does not hold, nothing is sent; conditions are checked as long as the alarm is
    on. A mode that is neither the mode before the command nor a commanded mode means that the pilot
    has taken over: nothing more is sent during this alarm. Nothing ever releases the brake.

    Parameters
    ----------
    pilot : Autopilot
        The state of the autopilot.
    modes : collection of str
        The modes, by name or number, in which the autopilot may be commanded.
    send : callable
        Sends the command of a mode, with the number of the try, from 0.
    report : callable
        Takes an event and its entries.
    say : callable
        Sends the pilot a text; takes the text and whether it is critical.
    """

    def __init__(
        self,
        pilot: Autopilot,
        modes: Collection[str],
        send: Callable[[Mode, int], None],
        report: Callable[..., None],
        say: Callable[[str, bool], None],
    ) -> None:
        self._pilot, self._modes = pilot, frozenset(modes)
        self._send, self._report, self._say = send, report, say
        self._is_on, self._is_over, self._withheld = False, False, ""
        self._command: _Command | None = None
        self._left: list[Mode] = []
        self._ours: dict[int, Mode] = {}
        self._number_before, self._begun_s = -1, -math.inf

    def begin(self) -> None:
        """Begin an alarm."""
        self._is_on, self._is_over, self._withheld = True, False, ""

    def end(self) -> None:
        """End the alarm; a command that was already sent is still completed."""
        self._is_on = False

    def answer(self, result: str) -> None:
        """Process the autopilot's answer to the command."""
        command = self._command
        if command is None:
            return
        if result != command.answer:
            self._report(ANSWERED, result=result, number=command.n_sent)
        is_refused = result not in ("ACCEPTED", "IN_PROGRESS")
        if is_refused and result != command.answer:
            self._say(f"{command.mode.name} REFUSED: {result}", True)
        command.answer, command.answered_s = result, time.monotonic()

    def step(self, objection: str = "") -> None:
        """Send a command that is due; `objection`, if not empty, is a reason to send none now."""
        if self._command is not None:
            self._go_on(self._command, objection)
        elif self._is_on and not self._is_over:
            self._begin(objection)

    def _begin(self, objection: str) -> None:
        now_s = time.monotonic()
        objection = self.objection() or objection
        if not objection and now_s - self._begun_s < LEAST_APART_S:
            objection = f"commanded less than {LEAST_APART_S:g} s ago"
        if objection:
            self._withhold(objection)
            return
        self._begun_s, self._number_before = now_s, self._pilot.number
        self._ours, self._left = {}, [*self._pilot.brakes]
        self._next()

    def objection(self) -> str:
        """The reason not to command the autopilot now; empty for none."""
        pilot = self._pilot
        is_braking = pilot.number in {mode.number for mode in pilot.brakes[:1]}
        reasons = {
            f"no heartbeat of the autopilot within {HEARD_S:g} s": not pilot.is_heard,
            "not armed": not pilot.is_armed,
            "no braking mode of this vehicle is known": not pilot.brakes,
            f"{pilot.mode} already": is_braking,
            f"{pilot.mode} {_NOT_ONE}": not pilot.is_in(self._modes),
        }
        return next((why for why, is_so in reasons.items() if is_so), "")

    def _withhold(self, why: str) -> None:
        """Report why no command is sent, once per reason."""
        if why == self._withheld:
            return
        self._withheld = why
        self._report(WITHHELD, why=why)
        mode = self._pilot.mode
        short = f"mode {mode}" if why == f"{mode} {_NOT_ONE}" else why
        self._say(f"not braking: {short}", False)

    def _next(self) -> None:
        """Command the next mode."""
        mode, now_s = self._left.pop(0), time.monotonic()
        self._ours[mode.number] = mode
        self._command = _Command(mode, now_s)
        self._say(f"braking ({mode.name})", True)
        self._repeat(self._command)
        self._report(BRAKE, mode=mode.name, number=1)

    def _repeat(self, command: _Command) -> None:
        self._send(command.mode, command.n_sent)
        command.n_sent, command.sent_s = command.n_sent + 1, time.monotonic()

    def _go_on(self, command: _Command, objection: str) -> None:
        """Continue a command by the present mode, then by the answer, then by the time."""
        pilot, now_s = self._pilot, time.monotonic()
        is_seen = pilot.heard_s > command.first_s
        if is_seen and pilot.number in self._ours:
            stops = self._ours[pilot.number].stops
            self._finish(CONFIRMED if stops else HELD, mode=pilot.mode, number=command.n_sent)
            if not stops:
                self._say(f"NOT BRAKING: {pilot.mode} holds the height alone", True)
        elif is_seen and pilot.number != self._number_before:
            self._command, self._is_over = None, True
            self._withhold(f"the pilot has taken over ({pilot.mode})")
        elif objection := self.objection() or objection:
            self._command = None
            self._withhold(objection)
        elif self._is_next_due(command, now_s):
            self._next()
        elif command.is_accepted and not self._is_unheeded(command):
            return
        elif command.n_sent < MAX_TRIES:
            if now_s - command.sent_s >= REPEAT_S:
                self._repeat(command)
        elif now_s - command.sent_s >= (SILENT_S if self._left else LAST_S):
            why = command.answer or "no answer (signing?)"
            why = f"{why}, but the mode stays {pilot.mode}" if command.is_accepted else why
            self._finish(FAILED, mode=command.mode.name, number=command.n_sent, why=why)
            self._say(f"BRAKE FAILED: {why}", True)

    def _is_unheeded(self, command: _Command) -> bool:
        """Whether a heartbeat 0.1 s or more after ACCEPTED still shows the old mode."""
        return command.is_accepted and self._pilot.heard_s >= command.answered_s + REPEAT_S

    def _is_next_due(self, command: _Command, now_s: float) -> bool:
        is_refused = bool(command.answer) and not command.is_accepted
        is_silent = not command.answer and self._pilot.heard_s <= command.first_s
        is_lost = is_silent and now_s - command.first_s >= SILENT_S
        return bool(self._left) and (is_refused or is_lost or self._is_unheeded(command))

    def _finish(self, event: str, **facts: Json) -> None:
        self._command, self._is_over = None, True
        self._report(event, **facts)
