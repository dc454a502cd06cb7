"""The loop of `dlgmd live`: the newest frame, the model's answer, and events."""

import json
import logging
import math
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import Future, wait
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone

import numpy as np

from dlgmd_cli.errors import Once, argument, counted
from dlgmd_cli.frame import Flags, Frame, Image, resized
from dlgmd_cli.live.heading import Heading
from dlgmd_cli.live.rate import Rate
from dlgmd_cli.live.reports import Reports
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.threads import started_thread
from dlgmd_cli.models.detection import AlarmSpan, Detection, Episodes
from dlgmd_cli.models.health import BLIND_S, SOUND_S, Health
from dlgmd_cli.models.rules import rule_named
from dlgmd_cli.models.session import Session
from dlgmd_cli.models.windows import USUAL_FOV_DEG, Camera, Direction, outside
from dlgmd_cli.parameters.facts import Json, defined
from dlgmd_cli.results.csv import is_copy
from dlgmd_cli.tasks.camera import camera_of
from dlgmd_cli.video.live import LiveSource
from dlgmd_cli.video.source import opencv_threads

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
}
# How often the loop looks at the stop flag while no frame comes.
_WAIT_S = 0.1
# A source is lost after these seconds without a frame: between frames, and before the first one.
# With the time to notice the loss, the former is a second.
SILENT_S, _OPENING_S = 0.9, 5.0
# Half a second of frames, less than this apart in seconds, ends the loss.
_SOON_S = 0.3


@dataclass(frozen=True)
class Answer:
    """A model's answer to a frame, or an event between frames.

    Attributes
    ----------
    frame : Frame or None
        The frame; of an event between frames, the one before it, if there was one.
    detection : Detection
        The model's response, with spike and alarm.
    is_repeat : bool
        Whether the frame is a duplicate, which is skipped, after the warm-up.
    event : str
        `begin` or `end` where an alarm begins or ends, `blind` where the source shows nothing any
        more (or for another reason), `sees` where it does again, what a receiver reported, else
        empty. An alarm that comes back within 0.3 s is still the same one; its end is therefore
        reported 0.3 s late.
    latency_ms : float
        Time from the frame's arrival to the answer; NaN for an event between frames.
    reason : str
        Why the source shows nothing: `lost`, or see `Health`; empty if it does.
    span : AlarmSpan or None
        With `begin` and `end`, the alarm, as far as it is known.
    time_s, since_s : float
        Time of an event between frames, and with `blind` that from which on nothing was seen, in
        seconds since the first frame; NaN of others, and before the first frame.
    utc_s : float
        When the frame came, or the event, in seconds since 1970 by the system's clock.
    report : mapping
        Further entries of an event that a receiver reported.
    speed_m_s : float
        Speed of the drone by its autopilot; NaN if it is unknown.
    threshold : float
        Threshold of the rule where it follows the speed; else NaN.
    heading : (float, float) or None
        The direction of flight by the autopilot, if the expansion was measured around it.
    """

    frame: Frame | None
    detection: Detection
    is_repeat: bool = False
    event: str = ""
    latency_ms: float = math.nan
    reason: str = ""
    span: AlarmSpan | None = None
    time_s: float = math.nan
    since_s: float = math.nan
    utc_s: float = field(default_factory=time.time)
    report: Mapping[str, Json] = field(default_factory=dict)
    speed_m_s: float = math.nan
    threshold: float = math.nan
    heading: Direction | None = None

    @property
    def is_of_frame(self) -> bool:
        """Whether this is the answer to a frame."""
        return not math.isnan(self.latency_ms)

    def to_dict(self) -> dict[str, Json]:
        """The object for receivers; None where a number is not defined.

        With `begin`, it has the side of the alarm, see `side_of`; with `end`, also its duration and
        its peak.
        """
        frame, detection = self.frame, self.detection
        time_s = math.nan if frame is None else frame.time_s
        time_s = time_s if math.isnan(self.time_s) else self.time_s
        facts: dict[str, Json] = {
            "frame": None if frame is None else frame.index,
            "time_s": defined(round(time_s, 6)),
            "repeat": self.is_repeat,
            "utc": utc_text(self.utc_s),
            "mp": _number(detection.mp),
            "mp_abs": _number(detection.mp_abs),
            "spike": detection.spike,
            "alarm": detection.alarm,
            "g_x": _number(detection.g_x),
            "g_y": _number(detection.g_y),
            "expansion": _number(detection.expansion),
            "ttc_s": _number(detection.ttc_s),
            "rule": detection.rule,
            "latency_ms": _number(round(self.latency_ms, 2)),
        }
        if self.event:
            facts["event"] = self.event
        if self.span is not None:
            facts["side"] = self.span.side
        if self.span is not None and self.event == END:
            facts["duration_s"] = round(self.span.end_s - self.span.start_s, 6)
            facts["peak_mp_abs"] = _number(self.span.peak_mp_abs)
        if self.reason:
            facts["reason"] = self.reason
        key = rule_named(detection.rule).key
        known = ("since_s", self.since_s, 6), ("speed_m_s", self.speed_m_s, 3)
        for name, value, n_digits in (*known, (key, self.threshold, 3)):
            if not math.isnan(value):
                facts[name] = round(value, n_digits)
        return {**facts, **self.report}

    def to_json(self) -> str:
        """The same on one line."""
        return json.dumps(self.to_dict())


def utc_text(utc_s: float) -> str:
    """A time in UTC by ISO 8601, to the millisecond: ``2026-05-01T09:30:00.125Z``."""
    return f"{datetime.fromtimestamp(utc_s, timezone.utc):%Y-%m-%dT%H:%M:%S.%f}"[:-3] + "Z"


def _number(value: float) -> float | None:
    """A number with the digits that float32 has."""
    return defined(float(f"{value:.9g}"))


class Events:
    """The alarms of a source, as they begin and end.

    Attributes
    ----------
    span : AlarmSpan or None
        The alarm that has begun and not ended, up to now.
    """

    def __init__(self) -> None:
        self.span: AlarmSpan | None = None
        self._episodes = Episodes()

    def over(self) -> AlarmSpan | None:
        """End the alarm, if there is one, and return it."""
        span, self.span = self.span, None
        self._episodes.reset()
        return span

    def step(self, detection: Detection, frame: Frame) -> list[tuple[str, AlarmSpan | None]]:
        """What the response to a frame reports: the `end` of an alarm, the `begin` of one, or both.

        The end of one and the begin of the next come together if no frame came in between at
        which 0.3 s were over.
        """
        index, time_s = frame.index, frame.time_s
        changes: list[tuple[str, AlarmSpan | None]] = []
        has_ended, begins = self._episodes.step(time_s, detection.alarm)
        if has_ended:
            changes.append((END, self.span))
            self.span = None
        if begins:
            self.span = AlarmSpan(
                start_frame=index,
                start_s=time_s,
                end_frame=index,
                end_s=time_s,
                peak_mp_abs=detection.mp_abs,
                g_x=detection.g_x,
                g_y=detection.g_y,
                ttc_s=detection.ttc_s,
                rule=detection.rule,
                expansion_x=detection.expansion_x,
                expansion_y=detection.expansion_y,
            )
            changes.append((BEGIN, self.span))
        elif detection.alarm and self.span is not None:
            peak = max(self.span.peak_mp_abs, detection.mp_abs)
            self.span = self.span._replace(end_frame=index, end_s=time_s, peak_mp_abs=peak)
        return changes


class Watch:
    """Prepares a session, and answers to the newest frame of a source, again and again.

    Parameters
    ----------
    source : LiveSource
        Already reading. While it `wants_pictures`, answers have the layers.
    session : Session
        Of one model, with the expansion.
    state : SourceState
        Of the source.
    reports : Reports, optional
        Events that receivers report, sent with the next frame, or within a tenth of a second.
    threshold_at : callable, optional
        The threshold of the rule at a speed in m/s, which may be NaN: with it, the threshold
        follows the speed in `reports`.
    heading : Heading, optional
        The direction of flight, around which the expansion is measured.
    """

    def __init__(
        self,
        source: LiveSource,
        session: Session,
        state: "SourceState",
        reports: Reports | None = None,
        threshold_at: Callable[[float], float] | None = None,
        heading: Heading | None = None,
    ) -> None:
        self._source, self._session, self._state = source, session, state
        self._reports = Reports() if reports is None else reports
        self._threshold_at, self._heading = threshold_at, heading
        (self._rule,), self._told = session.rules, Once()
        self._events, self._rate = Events(), Rate(source, self._rule)
        self._latest: Frame | None = None  # that has its answer

    def answers(self) -> Iterator[Answer | None]:
        """The answers and events as they come, until the source is over or the user stops it.

        Yields
        ------
        Answer or None
            None where no frame has come for a tenth of a second. Where a source is lost, silent, or
            shows nothing, the event `blind` comes within a second, and `sees` half a second after
            it shows something again. An alarm that is on when the source is over, or silent, ends
            with an event. Events that are reported with a frame have its times, so that all are in
            their order.

        Raises
        ------
        SourceError
            If the source cannot be read, and is not tried again.
        ParameterError
            If the options do not fit its images.
        """
        # The decoder is busy on the other processor.
        with opencv_threads(1):
            if not (yield from self._prepared()):
                return
            self._source.begin()
            while not cancel.requested():
                frame = self._source.take(_WAIT_S)
                if frame is None and self._source.is_over:
                    break
                answer = None if frame is None else self._step(frame)
                yield from self._reported(frame)
                if frame is None or answer is None:
                    yield None
                    continue
                *earlier, (event, span) = self._events.step(answer.detection, frame) or [("", None)]
                for name, over in earlier:
                    yield self._event(name, frame, span=over)
                self._latest = frame
                yield replace(answer, event=event, reason=self._state.reason, span=span)
        if span := self._events.over():
            yield self._event(END, span=span)

    def _step(self, frame: Frame) -> Answer:
        """The answer to a frame, without the events that come with it."""
        if self._threshold_at is not None:
            self._follow(self._threshold_at)
        direction = self._head()
        began_s, busy_s = time.monotonic(), time.process_time()
        (detection,) = self._session.step(frame, layers=self._source.wants_pictures)
        now_s = time.monotonic()
        self._rate.step(frame, (now_s - began_s, time.process_time() - busy_s))
        return Answer(
            frame,
            detection,
            is_copy(frame, detection),
            latency_ms=1e3 * (now_s - frame.captured_s),
            utc_s=_utc_s(frame.captured_s),
            speed_m_s=self._reports.speed_m_s,
            threshold=math.nan if self._threshold_at is None else self._rule.threshold,
            heading=direction,
        )

    def _follow(self, threshold_at: Callable[[float], float]) -> None:
        """Set the threshold to that of the speed; it stays where there is none, told once a reason.

        An error of it must not end a watch.
        """
        speed_m_s, before = self._reports.speed_m_s, self._rule.threshold
        try:
            self._rule.threshold = threshold_at(speed_m_s)
        except Exception as error:
            if self._told.is_new(why := str(error) or type(error).__name__):
                _log.warning("no threshold at %g m/s (%s); it stays %g", speed_m_s, why, before)

    def _head(self) -> Direction | None:
        """Measure the expansion around the direction of flight, which is returned if known."""
        expansion = self._session.expansion
        if self._heading is None or expansion is None:
            return None
        direction = self._heading.direction()
        expansion.head(direction)
        self._state.n_headed += direction is not None
        return direction

    def _reported(self, frame: Frame | None = None) -> Iterator[Answer]:
        """What the source and receivers report, at the time of a frame, or now."""
        event, reports = self._state.step(frame), self._reports
        if self._state.is_silent:
            self._rate.reset()
            if span := self._events.over():
                yield self._event(END, frame, span=span)
        if event:
            yield self._event(event, frame, alarm=self._events.span is not None)
        while reports:
            name, report = reports.popleft()
            yield self._event(name, frame, alarm=self._events.span is not None, report=report)

    def _prepared(self) -> Generator[Answer | None, None, bool]:
        """Prepare the session for the images of the source; yields as `answers` does meanwhile.

        Returns whether it is ready, and not over or cancelled.
        """
        ready: Future[None] | None = None
        while ready is None or not ready.done():
            if ready is not None:
                wait([ready], _WAIT_S)
            elif (sample := self._source.sample(_WAIT_S)) is not None:
                self._look()
                ready = _warming_up(self._session, sample, self._source.small_wh)
            elif self._source.is_over:
                return False
            if cancel.requested():
                return False
            yield from self._reported()
            yield None
        ready.result()
        return True

    def _look(self) -> None:
        """Tell all that judge images what the mask hides, and through which camera they see."""
        source, session = self._source, self._session
        hidden, hidden_small = source.hidden()
        (model,) = session.models
        model.ignore(hidden)
        self._state.ignore(hidden)
        if session.expansion is not None:
            camera = _camera_of(source)
            session.expansion.look(camera)
            session.expansion.ignore(hidden_small)  # as the camera's images are reduced
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
        """An event at the time of a frame, just before its answer; or between frames, now."""
        now_s, latest = time.monotonic(), frame or self._latest
        at_s = now_s if frame is None else frame.captured_s
        # When the first frame came, by the same clock.
        first_s = math.nan if latest is None else latest.captured_s - latest.time_s
        return Answer(
            latest,
            Detection(alarm=alarm, rule=self._rule.name),
            event=event,
            reason=self._state.reason,
            span=span,
            time_s=at_s - first_s,
            since_s=self._state.since_s - first_s if event == BLIND else math.nan,
            utc_s=_utc_s(at_s),
            report=report,
        )


def _camera_of(source: LiveSource) -> Camera:
    """The camera of a source that has a first image; a note says what is assumed."""
    camera, entry = camera_of(source.options, source.picture_wh, source.name)
    if entry and entry["camera"]["known_by"] == "assumed":
        _log.info(
            "Note: the camera is taken to be %g° wide, unless %s says otherwise.",
            USUAL_FOV_DEG,
            argument("fov"),
        )
    if camera is not None and (why := outside(camera, source.small_wh)):
        _log.warning("%s", why)
    return camera


def _utc_s(monotonic_s: float) -> float:
    """A time of `time.monotonic` in seconds since 1970, by the system's clock."""
    return time.time() - (time.monotonic() - monotonic_s)


def _warming_up(session: Session, sample: Image, small_wh: tuple[int, int]) -> "Future[None]":
    """`warm_up` in a thread that does not delay Ctrl-C, for compiling may take long."""
    done: Future[None] = Future()

    def work() -> None:
        try:
            warm_up(session, sample, small_wh)
            done.set_result(None)
        except BaseException as error:
            done.set_exception(error)

    started_thread(work, "dlgmd-warm-up")
    return done


def warm_up(session: Session, sample: Image, small_wh: tuple[int, int]) -> None:
    """Let a model load and compile what it needs for frames like this one; it forgets them."""
    rng, (model,) = np.random.default_rng(0), session.models
    for number in range(model.first_valid_frame + 2):
        noise = rng.integers(0, 256, sample.shape, np.uint8)
        grey = noise if sample.dtype == np.uint8 else np.float32(noise / 255.0)
        session.step(Frame(number, math.nan, grey, small=resized(grey, small_wh)))
    session.reset()


class SourceState:
    """Whether a source shows something, and for how long it did not.

    Attributes
    ----------
    reason : str
        Why it shows nothing, see `Answer`; empty if it does.
    since_s : float
        From when on, by `time.monotonic`; NaN at first.
    is_silent : bool
        Whether no frame has come for so long that the source counts as lost.
    n_headed : int
        Frames that were measured around the direction of flight that an autopilot reported.
    """

    def __init__(self, source: LiveSource) -> None:
        self._source, self.reason, self.is_silent, self.n_headed = source, "", False, 0
        self._health, self._back_s = Health(), math.nan
        self.since_s, self._before = math.nan, dict[str, tuple[int, float]]()

    def ignore(self, hidden: Flags | None) -> None:
        """Judge only what is not hidden, (H, W), from now on."""
        self._health.ignore(hidden)

    def step(self, frame: Frame | None = None) -> str:
        """`blind` where it begins, or for another reason, `sees` where it ends, or nothing.

        To be called with each frame, and some ten times a second while none comes. Each event is
        logged as a warning.
        """
        now_s, source = time.monotonic(), self._source
        usual_s = 2.5 / source.fps if source.fps > 0.0 else 0.0
        silent_s = now_s - source.heard_s
        limit_s = max(SILENT_S, usual_s) if source.n_frames else _OPENING_S
        self.is_silent = silent_s > limit_s and not source.may_pause
        if frame is not None:
            self._health.step(frame.grey, frame.time_s)
        is_lost = source.is_lost or self.is_silent
        if is_lost or silent_s > max(_SOON_S, usual_s) or not source.n_frames:
            self._back_s = math.nan
        elif math.isnan(self._back_s):
            self._back_s = source.heard_s
        is_back = source.heard_s - self._back_s >= SOUND_S
        is_lost = is_lost or (self.reason == LOST and not is_back)
        reason = LOST if is_lost else self._health.reason or ""
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
        elif not source.is_lost:  # otherwise the source itself says why
            _log.warning("%s: blind, no frame for %.1f s", source.name, silent_s)
        return BLIND

    def _so_far(self) -> dict[str, tuple[int, float]]:
        """How often, and for how many seconds in all, it showed nothing, for each reason."""
        if not self.reason:
            return self._before
        n_times, total_s = self._before.get(self.reason, (0, 0.0))
        now = n_times + 1, total_s + time.monotonic() - self.since_s
        return {**self._before, self.reason: now}

    def warnings(self) -> list[str]:
        """Whether it followed a heading, and how long it showed nothing, a line for each reason."""
        lines = []
        if self.n_headed:
            frames = counted(self.n_headed, "frame")
            lines.append(f"{frames} measured around the autopilot's heading")
        for reason, (n_times, total_s) in self._so_far().items():
            times = counted(n_times, "time")
            lines.append(f"blind {times}, {total_s:.1f} s: {BLIND_WORDS[reason]}")
        return lines
