"""What a busy computer leaves out: parts of the answers first, then whole frames, evenly."""

import math
from collections import deque
from collections.abc import Mapping
from itertools import takewhile
from statistics import median
from typing import NamedTuple

from dlgmd_cli.parameters.facts import Json

# Event: something else is left out, or the watch begins or ceases to protect.
RATE = "rate"
# Below this number of answers per second, an approach is not noticed in time.
LEAST_FPS = 6.0
# Seconds over which the delay of frames is judged, before a part and before frames are left out,
# and the rate of answers. Frames may wait for _PATIENCE_S (s): a short stall drops none.
_PART_S, _FRAMES_S, RATE_S, _PATIENCE_S = 0.3, 0.5, 2.0, 0.1
# Least number of answers to judge by.
_N_AT_LEAST = 3
# Answers may take this share of the time between frames: when frames are left out, and for leaving
# out less again.
_FULL, _EASY = 0.9, 0.6
# The interval grows at most by this factor at once: a larger one would look like lost frames.
_MOST_AT_ONCE = 3
# Seconds until less is left out again; doubled each time that it was too early.
_HOLD_S, _MAX_HOLD_S = 1.0, 16.0


class _Spent(NamedTuple):
    """When an answer was done, by `time.monotonic`, how long its frame waited, what it took (s)."""

    done_s: float
    delay_s: float
    busy_s: float


class Load:
    """Decides what is left out, so that answers keep up with the frames.

    The watch is behind if the latest frames all waited for more than 0.1 s, longer than the time
    between two answers, and ever longer. Then the part that the rule does not use is left out, and
    if that is not enough, all frames but one in `every`. Once answers take less than 0.6 of the
    available time, less is left out again.

    Parameters
    ----------
    spare : str
        The part that the rule does not use, see `Alarm.spare`.

    Attributes
    ----------
    every : int
        One in `every` frames is answered.
    left_out : str
        The part that is left out of the answers: `spare`, or empty.
    fps : float
        Answers per second over the last 2 s; NaN before.
    protects : bool
        Whether `fps` is at least `LEAST_FPS`, or not yet known.
    """

    def __init__(self, spare: str) -> None:
        self.every, self.left_out, self.protects = 1, "", True
        self._spare = spare
        self._changed_s, self._eased_s, self._hold_s = -math.inf, -math.inf, _HOLD_S
        self.reset()

    def reset(self) -> None:
        """Forget the earlier answers, as after a silence."""
        self.fps, self._begin_s = math.nan, math.nan
        self._answers: deque[_Spent] = deque()

    def step(self, done_s: float, delay_s: float, busy_s: float, interval_s: float) -> bool:
        """Count an answer; returns whether what is left out, or `protects`, has changed.

        `interval_s` is the time between the source's frames.
        """
        before, answers = (self.every, self.left_out, self.protects), self._answers
        answers.append(_Spent(done_s, delay_s, busy_s))
        while done_s - answers[0].done_s >= RATE_S:
            answers.popleft()
        if math.isnan(self._begin_s):
            self._begin_s = self._changed_s = done_s
        if done_s - self._begin_s >= RATE_S:
            self.fps = len(answers) / RATE_S
            self.protects = self.fps >= LEAST_FPS
        latest = [*takewhile(lambda one: one.done_s > self._changed_s, reversed(answers))]
        if len(latest) >= _N_AT_LEAST:
            # The median: a stall says nothing about the next answers.
            n_intervals = median(one.busy_s for one in latest) / interval_s
            if self._is_behind(latest, interval_s):
                self._leave_out(done_s, n_intervals)
            elif done_s - self._changed_s >= self._hold_s:
                self._take_back(done_s, n_intervals)
        return before != (self.every, self.left_out, self.protects)

    def _is_behind(self, latest: list[_Spent], interval_s: float) -> bool:
        """Whether frames wait, ever longer; `latest` has the newest answer first."""
        now_s, within_s = latest[0].done_s, _FRAMES_S
        if self._spare and not self.left_out:
            within_s = _PART_S
        if now_s - self._changed_s < within_s:
            return False
        n_recent = sum(now_s - one.done_s < within_s for one in latest)
        recent = latest[: max(_N_AT_LEAST, n_recent)]
        least_s = min(one.delay_s for one in recent)
        is_long = least_s > max(self.every * interval_s, _PATIENCE_S)
        return is_long and recent[0].delay_s >= recent[-1].delay_s

    def _leave_out(self, now_s: float, n_intervals: float) -> None:
        """Leave out more, for answers that take `n_intervals` intervals of the source."""
        if now_s - self._eased_s < 2.0 * self._hold_s:
            self._hold_s = min(2.0 * self._hold_s, _MAX_HOLD_S)
        self._changed_s = now_s
        if self._spare and not self.left_out:
            self.left_out = self._spare
            return
        enough = max(self.every + 1, math.ceil(n_intervals / _FULL))
        self.every = min(enough, _MOST_AT_ONCE * self.every)

    def _take_back(self, now_s: float, n_intervals: float) -> None:
        """Leave out less if that leaves time: fewer frames, then no part (which takes half)."""
        if self.every > 1 and n_intervals < _EASY * (self.every - 1):
            self.every = max(1, math.ceil(n_intervals / _EASY))
        elif self.every == 1 and self.left_out and n_intervals < 0.5 * _EASY:
            self.left_out = ""
        else:
            return
        self._changed_s = self._eased_s = now_s

    def to_dict(self) -> dict[str, Json]:
        """The entries of the event."""
        fps = None if math.isnan(self.fps) else round(self.fps, 1)
        facts: dict[str, Json] = {"answered_fps": fps, "every": self.every}
        if self.left_out:
            facts["left_out"] = self.left_out
        return {**facts, "protects": self.protects}


def in_words(facts: Mapping[str, Json]) -> str:
    """What is left out, by the entries of the event; empty for nothing."""
    every, left_out = facts.get("every", 1), facts.get("left_out", "")
    parts = [] if every == 1 else [f"1 of {every} frames is answered"]
    parts += [f"the {left_out} is left out"] if left_out else []
    if not facts.get("protects", True):
        parts.append(f"only {facts['answered_fps']} answers a second: it protects no more")
    return "; ".join(parts)
