"""The loop of `dlgmd live`: the newest frame, the model's answer, and what became of the alarm."""

import json
import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from dlgmd_cli import cancel
from dlgmd_cli.models.detection import MERGE_S, ROUNDING_S, Alarm, Detection
from dlgmd_cli.video.live import LiveFrame, LiveSource
from dlgmd_cli.video.prefetch import opencv_threads

BEGIN, END = "begin", "end"
# How often the loop looks at the stop flag while no frame comes.
_WAIT_S = 0.1
# An alarm is over when no frame has come for so long.
_SILENT_S = 1.0
# Latencies that percentiles are taken over: those of the last hour at 30 frames a second.
_N_LATENCIES = 108_000
_N_LATELY = 300
_N_WARM = 8


@dataclass(frozen=True)
class Answer:
    """What the model said about a frame.

    Attributes
    ----------
    frame : LiveFrame
        The frame.
    said : Detection
        The answer.
    is_repeat : bool
        Whether the frame repeats the one before, so that the model did not see it.
    event : str
        `begin` or `end` where an alarm begins or ends, else empty. An alarm that comes back within
        0.3 s is still the same one; its end is therefore told 0.3 s late.
    latency_ms : float
        Time from the frame's capture to the answer.
    """

    frame: LiveFrame
    said: Detection
    is_repeat: bool
    event: str
    latency_ms: float

    def to_dict(self) -> dict[str, object]:
        """What receivers are told; None where a number is not defined."""
        said = self.said
        facts: dict[str, object] = {
            "frame": self.frame.index,
            "time_s": round(self.frame.time_s, 6),
            "mp": _number(said.mp),
            "mp_abs": _number(said.mp_abs),
            "spike": said.spike,
            "alarm": said.alarm,
            "g_x": _number(said.g_x),
            "g_y": _number(said.g_y),
            "latency_ms": _number(round(self.latency_ms, 2)),
        }
        return facts | ({"event": self.event} if self.event else {})

    def without_alarm(self) -> "Answer":
        """What to tell of an alarm that is on when no more frames come; it is of no frame."""
        said = replace(self.said, spike=False, alarm=False)
        return replace(self, said=said, is_repeat=True, event=END, latency_ms=math.nan)

    def to_json(self) -> str:
        """The same on one line."""
        return json.dumps(self.to_dict())


def _number(value: float) -> float | None:
    """A number with the digits that float32 has."""
    return None if math.isnan(value) else float(f"{value:.9g}")


class Events:
    """Tells from the alarm of each frame where one begins, as `onsets` has it, and has ended."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the alarm."""
        self.is_on = self._was_on = False
        self._last_on_s = math.nan

    def step(self, alarm: bool, time_s: float) -> str:
        """`begin`, `end` or nothing, at the frame of this time."""
        is_over = not self._was_on and time_s - self._last_on_s >= MERGE_S - ROUNDING_S
        is_new, self._was_on = alarm and (not self.is_on or is_over), alarm
        if alarm:
            self.is_on, self._last_on_s = True, time_s
            return BEGIN if is_new else ""
        if self.is_on and time_s - self._last_on_s >= MERGE_S - ROUNDING_S:
            self.is_on = False
            return END
        return ""


def answers(
    source: LiveSource, alarm: Alarm, wants_layers: Callable[[], bool] = lambda: False
) -> Iterator[Answer | None]:
    """Answer to the newest frame of a source, again and again.

    Parameters
    ----------
    source : LiveSource
        Already reading.
    alarm : Alarm
        Begins anew where frames were lost.
    wants_layers : callable
        Whether somebody wants the layers of the next frame.

    Yields
    ------
    Answer or None
        None where no frame has come for a tenth of a second. An alarm that is on when the source is
        over, or silent for a second, ends with an answer of no frame.

    Raises
    ------
    SourceError
        If the source cannot be read, and is not tried again.
    ParameterError
        If the options do not fit its pictures.
    """
    events, last, answered_s = Events(), None, math.nan
    # The decoder is busy on the other processor.
    with opencv_threads(1):
        while not cancel.requested():
            frame = source.take(_WAIT_S)
            if frame is None:
                if source.is_over:
                    break
                if last is not None and events.is_on and time.monotonic() - answered_s > _SILENT_S:
                    events.reset()
                    yield last.without_alarm()
                yield None
                continue
            if last is None:
                alarm.ignore(source.hidden())
            said = alarm.step(frame.grey, frame.time_s, layers=wants_layers())
            answered_s = time.monotonic()
            is_repeat = last is not None and said is last.said
            event = events.step(said.alarm, frame.time_s)
            last = Answer(frame, said, is_repeat, event, 1e3 * (answered_s - frame.captured_s))
            yield last
    if last is not None and events.is_on:
        yield last.without_alarm()


def warm_up(alarm: Alarm) -> None:
    """Let a model load what it needs, which takes longer than a frame lasts; it forgets all."""
    for frame in np.random.default_rng(0).integers(0, 256, (_N_WARM, 60, 80), np.uint8):
        alarm.step(frame)
    alarm.reset()


class Statistics:
    """Numbers of a session, in memory that does not grow."""

    def __init__(self) -> None:
        self.n_frames = self.n_alarms = 0
        self._latencies_ms: deque[float] = deque(maxlen=_N_LATENCIES)
        self._lately_ms: deque[float] = deque(maxlen=_N_LATELY)
        self._lately: deque[float] = deque(maxlen=60)

    def put(self, answer: Answer) -> None:
        """Take in an answer to a frame."""
        if math.isnan(answer.latency_ms):
            return
        self.n_frames += 1
        self.n_alarms += answer.event == BEGIN
        self._latencies_ms.append(answer.latency_ms)
        self._lately_ms.append(answer.latency_ms)
        self._lately.append(time.monotonic())

    @property
    def fps(self) -> float:
        """Answers a second, over the last 60; NaN before there are two."""
        if len(self._lately) < 2:
            return math.nan
        # Up to now, so that a source that stalls shows.
        return (len(self._lately) - 1) / max(time.monotonic() - self._lately[0], 1e-6)

    def latency_ms(self, *, lately: bool = False) -> tuple[float, float]:
        """Median and 99th percentile of the last hour, or of ten seconds; NaN for no frames."""
        values = list(self._lately_ms if lately else self._latencies_ms)
        if not values:
            return math.nan, math.nan
        median, high = np.percentile(values, (50, 99))
        return float(median), float(high)
