"""The loop of `dlgmd live`: takes the newest frame, and yields the model's answer and events."""

import json
import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone

from dlgmd_cli import Alarm, Detection, Parameters, Rule
from dlgmd_cli.errors import Once, argument, counted
from dlgmd_cli.frame import Frame
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.threads import opencv_threads
from dlgmd_cli.models.columns import MP
from dlgmd_cli.models.corridor import Motion
from dlgmd_cli.models.detection import COLUMNS, AlarmSpan, Episodes
from dlgmd_cli.models.health import BLIND_S, SOUND_S, UNMEASURED
from dlgmd_cli.models.stopping import too_fast
from dlgmd_cli.models.windows import USUAL_FOV_DEG, Camera, beside, outside
from dlgmd_cli.parameters.facts import Json, finite
from dlgmd_cli.tasks.camera import camera_of
from dlgmd_cli.video.live_source import LiveSource
from dlgmd_cli.watch.heading import Heading
from dlgmd_cli.watch.load import RATE, Load, in_words
from dlgmd_cli.watch.reports import Reports

_log = logging.getLogger(__name__)

NO_ENTRIES: Mapping[str, Json] = {}
BEGIN, END, BLIND, SEES = "begin", "end", "blind", "sees"
OUTPUT_LOST = "output-lost"
LOST = "lost"
BLIND_WORDS = {
    LOST: "the source is lost, or sends no frames",
    "black": "its frames are black",
    "flat": "its frames have no contrast",
    "noise": "its frames are noise",
    "frozen": "its image is frozen",
    UNMEASURED: "the expansion cannot be measured",
}
# Interval (s) between checks of the stop flag while no frame comes.
_WAIT_S = 0.1
# A source is lost after SILENT_S seconds without a frame, also before its first frame. SILENT_S and
# the time to notice the loss together are 1 s.
SILENT_S = 0.9
# Frames for half a second, less than this many seconds apart, end the loss.
_SOON_S = 0.3


# The columns of mp.csv that are known at a frame.
_COLUMNS = tuple(one.name for one in COLUMNS if MP in one.tables)


@dataclass(frozen=True)
class Answer:
    """A model's answer to a frame, or an event between frames.

    Attributes
    ----------
    frame : Frame or None
        The frame; for an event between frames, the previous frame, if any.
    detection : Detection
        What the frame gave; for an event between frames, only the rule, the reason, and whether an
        alarm is on.
    event : str
        `begin` or `end` of an alarm; `blind` when the source begins to show nothing (also when the
        reason changes); `sees` when the source shows something again; an event that a receiver
        reported; else empty. An alarm that returns within 0.3 s is the same alarm, so that an end
        is reported 0.3 s late.
    latency_ms : float
        Time from the frame's arrival to the answer; NaN for an event between frames.
    reason : str
        Why a collision may raise no alarm: `lost`, or a reason of `Detection.blind`; or empty.
    span : AlarmSpan or None
        For `begin` and `end`, the alarm as known so far.
    time_s, since_s : float
        Time of an event between frames; for `blind`, the time since when nothing was seen. Both in
        seconds since the first frame; NaN for other answers, and before the first frame.
    utc_s : float
        Time of the frame or event, in seconds since 1970 by the system's clock.
    report : mapping
        Further entries of an event that a receiver reported.
    speed_m_s : float
        Speed of the drone by its autopilot; NaN if unknown.
    threshold : mapping of str to float
        The parameter and its value that hold the rule's threshold, if it follows the speed.
    motion : Motion
        The motion by the autopilot.
    left_out : str
        What a busy computer left out of the answer, see `Load`; empty for nothing.
    """

    frame: Frame | None
    detection: Detection
    event: str = ""
    latency_ms: float = math.nan
    reason: str = ""
    span: AlarmSpan | None = None
    time_s: float = math.nan
    since_s: float = math.nan
    utc_s: float = field(default_factory=time.time)
    report: Mapping[str, Json] = field(default_factory=dict)
    speed_m_s: float = math.nan
    threshold: Mapping[str, float] = field(default_factory=dict)
    motion: Motion = field(default_factory=Motion)
    left_out: str = ""

    @property
    def is_of_frame(self) -> bool:
        """Whether this is the answer to a frame."""
        return not math.isnan(self.latency_ms)

    def to_dict(self) -> dict[str, Json]:
        """The JSON object for receivers; None for undefined numbers.

        It has the columns of mp.csv that are known at the frame. For `begin`, it also has the side
        of the alarm, see `side_of`; for `end`, also the alarm's duration and peaks.
        """
        frame, detection = self.frame, self.detection
        time_s = math.nan if frame is None else frame.time_s
        time_s = time_s if math.isnan(self.time_s) else self.time_s
        facts: dict[str, Json] = {
            **{name: _json(getattr(detection, name)) for name in (*_COLUMNS, "spike", "rule")},
            "frame": None if frame is None else frame.index,
            "time_s": finite(round(time_s, 6)),
            "utc": utc_text(self.utc_s),
            "latency_ms": _json(round(self.latency_ms, 2)),
        }
        if self.event:
            facts["event"] = self.event
        if self.span is not None:
            facts["side"] = self.span.side
        if self.span is not None and self.event == END:
            facts["duration_s"] = round(self.span.end_s - self.span.start_s, 6)
            facts["peak_signal"] = _json(self.span.peak_signal)
            facts["peak_mp_abs"] = _json(self.span.peak_mp_abs)
        for name, text in (("reason", self.reason), ("left_out", self.left_out)):
            if text:
                facts[name] = text
        known = ("since_s", self.since_s, 6), ("speed_m_s", self.speed_m_s, 3)
        of_rule = ((name, value, 3) for name, value in self.threshold.items())
        for name, value, n_digits in (*known, *of_rule):
            if not math.isnan(value):
                facts[name] = round(value, n_digits)
        return {**facts, **self.report}

    def to_json(self) -> str:
        """The JSON object as text on one line."""
        return json.dumps(self.to_dict())


def utc_text(utc_s: float) -> str:
    """A time in UTC by ISO 8601, to the millisecond: ``2026-05-01T09:30:00.125Z``."""
    return f"{datetime.fromtimestamp(utc_s, timezone.utc):%Y-%m-%dT%H:%M:%S.%f}"[:-3] + "Z"


def _json(value: float | str) -> Json:
    """A flag or a text as it is; a number with nine digits, as float32 needs; None for NaN."""
    return finite(float(f"{value:.9g}")) if isinstance(value, float) else value


class Events:
    """Tells when the alarms of a source, by a rule, begin and end.

    Attributes
    ----------
    span : AlarmSpan or None
        The present alarm, as known so far; None without an alarm.
    """

    def __init__(self, rule: Rule) -> None:
        self.span: AlarmSpan | None = None
        self._episodes, self._at_most = Episodes(), rule.at_most

    def over(self) -> AlarmSpan | None:
        """End the present alarm, if any, and return it."""
        span, self.span = self.span, None
        self._episodes.reset()
        return span

    def step(self, row: Detection) -> list[tuple[str, AlarmSpan | None]]:
        """The events at a frame: the `end` of an alarm, the `begin` of an alarm, both, or none.

        An end and the next begin come together if no frame came between the two alarms 0.3 s or
        more after the first alarm.
        """
        changes: list[tuple[str, AlarmSpan | None]] = []
        has_ended, begins = self._episodes.step(row.time_s, row.alarm)
        if has_ended:
            changes.append((END, self.span))
            self.span = None
        if begins:
            self.span = AlarmSpan.at(row, row.rule, row.side)
            changes.append((BEGIN, self.span))
        elif row.alarm and self.span is not None:
            self.span = self.span.until(row, at_most=self._at_most)
        return changes


class Watch:
    """Steps an alarm over the newest frames of a source, again and again.

    Parameters
    ----------
    source : LiveSource
        A source that is already reading. While it `wants_pictures`, answers have the layers.
    alarm : Alarm
        The alarm that is stepped.
    state : SourceState
        The state of the source.
    reports : Reports, optional
        Events that receivers report, sent with the next frame, or within 0.1 s.
    params_at : callable, optional
        Speed in m/s, possibly NaN -> parameters with the thresholds of the rule. If given, they
        follow the speed in `reports`.
    heading : Heading, optional
        The direction of flight around which the expansion is measured.
    """

    def __init__(
        self,
        source: LiveSource,
        alarm: Alarm,
        state: "SourceState",
        reports: Reports | None = None,
        params_at: Callable[[float], Parameters] | None = None,
        heading: Heading | None = None,
    ) -> None:
        self._source, self._alarm, self._state = source, alarm, state
        self._reports = Reports() if reports is None else reports
        self._params_at, self._heading = params_at, heading
        self._events, self._told = Events(alarm.rule), Once()
        self.load, self._due = Load(alarm.spare), (math.nan, math.nan)
        self._latest: Frame | None = None  # the last answered frame

    def answers(self) -> Iterator[Answer | None]:
        """The answers and events as they come, until the source ends or the user stops it.

        Yields
        ------
        Answer or None
            None after 0.1 s without a frame. If a source is lost, silent, or shows nothing, the
            event `blind` comes within 1 s, and `sees` 0.5 s after it shows something again. An
            alarm that is on when the source ends or falls silent ends with an event. Events at a
            frame have the times of the frame, so that all answers are in order.

        Raises
        ------
        SourceError
            If the source cannot be read, and is not tried again.
        ParameterError
            If the options do not fit the source's images.
        """
        # One thread: the decoder needs another processor.
        with opencv_threads(1):
            while not cancel.requested():
                self._balance()
                frame = self._source.take(_WAIT_S)
                if frame is None:
                    if self._source.is_over:
                        break
                    yield from self._reported()
                    yield None
                    continue
                answer = self._step(frame)
                yield from self._reported(frame, answer.detection)
                *earlier, (event, span) = self._events.step(answer.detection) or [("", None)]
                for name, over in earlier:
                    yield self._event(name, frame, span=over)
                self._latest = frame
                yield replace(answer, event=event, reason=self._state.reason, span=span)
        if span := self._events.over():
            yield self._event(END, span=span)

    def _step(self, frame: Frame) -> Answer:
        """The answer to a frame, without the events at the frame."""
        if self._latest is None:
            self._look()
        if self._params_at is not None:
            self._follow(self._params_at)
        motion, alarm, rule = self._head(), self._alarm, self._alarm.rule
        began_s, left_out = time.monotonic(), self.load.left_out
        alarm.left_out = left_out
        row = alarm.step(frame, layers=self._source.wants_pictures)
        if not frame.is_repeat:
            self._due = began_s - frame.captured_s, began_s
            self._state.n_without += bool(left_out)
        return Answer(
            frame,
            row,
            latency_ms=1e3 * (time.monotonic() - frame.captured_s),
            utc_s=_utc_s(frame.captured_s),
            speed_m_s=self._reports.speed_m_s,
            threshold={} if self._params_at is None else {rule.key: rule.threshold},
            motion=motion,
            left_out=left_out,
        )

    def _balance(self) -> None:
        """Leave out as much as the last answer shows, which its receivers have by now."""
        (delay_s, began_s), source, now_s = self._due, self._source, time.monotonic()
        self._due = math.nan, math.nan
        if math.isnan(began_s) or not source.drops:
            return
        fps = source.taken_fps if source.taken_fps > 0.0 else source.model_fps
        if not self.load.step(now_s, delay_s, now_s - began_s, 1.0 / fps):
            return
        source.take_every(self.load.every)
        self._reports.append((RATE, facts := self.load.to_dict()))
        _log.warning("%s: %s", source.name, in_words(facts) or "every frame is answered in full")

    def _follow(self, params_at: Callable[[float], Parameters]) -> None:
        """Set the thresholds for the present speed.

        If `params_at` fails, they stay, with one warning per reason, and no error.
        """
        speed_m_s, rule = self._reports.speed_m_s, self._alarm.rule
        if (line := too_fast(speed_m_s)) and self._told.is_new(line):
            _log.warning("%s", line)
        try:
            rule.follow(params_at(speed_m_s))
        except Exception as error:
            if self._told.is_new(why := str(error) or type(error).__name__):
                stays = rule.threshold
                _log.warning("no threshold at %g m/s (%s); it stays %g", speed_m_s, why, stays)

    def _head(self) -> Motion:
        """Measure by the reported motion; returns it."""
        motion = Motion() if self._heading is None else self._heading.motion()
        self._alarm.heading(*motion.direction, *motion[1:])
        return motion

    def _reported(
        self, frame: Frame | None = None, row: Detection | None = None
    ) -> Iterator[Answer]:
        """The events of the source and of receivers, at the time of a frame, or now."""
        event, reports = self._state.step(row), self._reports
        if self._state.is_silent:
            self.load.reset()
            if span := self._events.over():
                yield self._event(END, frame, span=span)
        if event:
            yield self._event(event, frame, alarm=self._events.span is not None)
        while reports:
            name, report = reports.popleft()
            yield self._event(name, frame, alarm=self._events.span is not None, report=report)

    def _look(self) -> None:
        """Pass the hidden cells and the camera of the first frame to the alarm; log its rule."""
        if self._params_at is None:
            _log.info("Note: the alarm rule is %s.", self._alarm.rule.text)
        source, camera = self._source, _camera_of(self._source)
        self._alarm.ignore(*source.hidden())
        self._alarm.look(camera)
        if self._heading is not None:
            self._heading.look(camera, source.small_wh)

    def _event(
        self,
        event: str,
        frame: Frame | None = None,
        *,
        alarm: bool = False,
        span: AlarmSpan | None = None,
        report: Mapping[str, Json] = NO_ENTRIES,
    ) -> Answer:
        """An event at the time of a frame, just before the frame's answer; without a frame, now."""
        now_s, latest = time.monotonic(), frame or self._latest
        at_s = now_s if frame is None else frame.captured_s
        # Arrival time of the first frame, by the same clock.
        first_s = math.nan if latest is None else latest.captured_s - latest.time_s
        return Answer(
            latest,
            Detection(alarm=alarm, rule=self._alarm.rule.name, blind=self._state.reason),
            event=event,
            reason=self._state.reason,
            span=span,
            time_s=at_s - first_s,
            since_s=self._state.since_s - first_s if event == BLIND else math.nan,
            utc_s=_utc_s(at_s),
            report=report,
        )


def _camera_of(source: LiveSource) -> Camera:
    """The camera of a source that has a first image; logs which angles are assumed."""
    camera, entry = camera_of(source.options, source.picture_wh, source.name)
    if entry and entry["camera"]["known_by"] == "assumed":
        _log.info(
            "Note: a lens of %g° is assumed. Give yours with %s.",
            USUAL_FOV_DEG,
            argument("fov"),
        )
    if camera is not None and (why := outside(camera, source.small_wh) or beside(camera)):
        _log.warning("%s", why)
    return camera


def _utc_s(monotonic_s: float) -> float:
    """A time of `time.monotonic` in seconds since 1970, by the system's clock."""
    return time.time() - (time.monotonic() - monotonic_s)


class SourceState:
    """Whether a source shows something, and the times without anything to see.

    Attributes
    ----------
    reason : str
        Why the source shows nothing, see `Answer`; empty if it shows something.
    since_s : float
        Time since when `reason` holds, by `time.monotonic`; NaN at first.
    is_silent : bool
        Whether the source counts as lost because no frame has come for too long.
    n_without : int
        Number of frames without a part that a busy computer left out.
    """

    def __init__(self, source: LiveSource) -> None:
        self._source, self.reason, self.is_silent = source, "", False
        self.n_without = 0
        self._blind, self._back_s = "", math.nan
        self.since_s, self._before = math.nan, dict[str, tuple[int, float]]()

    def step(self, row: Detection | None = None) -> str:
        """The event: `blind` at the start or for a new reason, `sees` at the end, or empty.

        To be called with the row of each frame, and about ten times per second without frames. Each
        event is logged as a warning.
        """
        now_s, source = time.monotonic(), self._source
        usual_s = 2.5 / source.fps if source.fps > 0.0 else 0.0
        silent_s = now_s - source.heard_s
        self.is_silent = silent_s > max(SILENT_S, usual_s) and not source.may_pause
        if row is not None:
            self._blind = row.blind
        is_lost = source.is_lost or self.is_silent
        if is_lost or silent_s > max(_SOON_S, usual_s) or not source.n_frames:
            self._back_s = math.nan
        elif math.isnan(self._back_s):
            self._back_s = source.heard_s
        is_back = source.heard_s - self._back_s >= SOUND_S
        is_lost = is_lost or (self.reason == LOST and not is_back)
        reason = LOST if is_lost else self._blind
        if reason == self.reason:
            return ""
        self._before, was_s = self._so_far(), now_s - self.since_s
        self.reason = reason
        if not reason:
            _log.warning("%s: recovered after %.1f s", source.name, was_s)
            return SEES
        self.since_s = source.heard_s if reason == LOST else now_s - BLIND_S
        if reason != LOST:
            _log.warning("%s: blind, %s", source.name, BLIND_WORDS[reason])
        elif not source.is_lost:  # a lost source itself logs the reason
            _log.warning("%s: blind, no frame for %.1f s", source.name, silent_s)
        return BLIND

    def _so_far(self) -> dict[str, tuple[int, float]]:
        """Reason -> how many times, and for how many seconds in all, the source showed nothing."""
        if not self.reason:
            return self._before
        n_times, total_s = self._before.get(self.reason, (0, 0.0))
        now = n_times + 1, total_s + time.monotonic() - self.since_s
        return {**self._before, self.reason: now}

    def warnings(self) -> list[str]:
        """A line per reason for the time without a view or a full answer."""
        lines = []
        if self.n_without:
            frames = counted(self.n_without, "frame")
            lines.append(f"{frames} not answered in full: the computer was too busy")
        for reason, (n_times, total_s) in self._so_far().items():
            times = counted(n_times, "time")
            lines.append(f"blind {times}, {total_s:.1f} s: {BLIND_WORDS[reason]}")
        return lines
