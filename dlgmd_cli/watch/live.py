"""`live`: watch a camera, a stream, a pipe, or a file at its own pace, and raise alarms."""

import math
import os
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from dlgmd_cli import Alarm, Parameters, Rule
from dlgmd_cli.errors import ParameterError, SourceError, argument
from dlgmd_cli.machine import cancel
from dlgmd_cli.models import stopping
from dlgmd_cli.parameters.checks import refuse
from dlgmd_cli.parameters.facts import Json, Value, finite, stating
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.tasks.call import RULE_ARGUMENTS, ModelName, Request, Setup, fold
from dlgmd_cli.video import live_source
from dlgmd_cli.video.base import without_password
from dlgmd_cli.video.input_options import InputOptions
from dlgmd_cli.video.live_source import LiveSource, Shot
from dlgmd_cli.watch import mavlink, outputs
from dlgmd_cli.watch.autopilot import braking_modes, known_modes
from dlgmd_cli.watch.heading import Heading
from dlgmd_cli.watch.recording import VIDEO, LastSeconds, Recording
from dlgmd_cli.watch.reports import Reports
from dlgmd_cli.watch.service import Service
from dlgmd_cli.watch.statistics import Statistics
from dlgmd_cli.watch.watch import OUTPUT_LOST, Answer, SourceState, Watch

# The speed of --speed-m-s that the autopilot reports.
AUTOPILOT = "autopilot"
# The options of a stop, of an autopilot, and of a recording.
_STOP = ("react", "brake", "tilt", "jerk")
_OF_MAVLINK = ("mavlink_signing", "mavlink_system", "mavlink_component")
_OF_RECORD = ("keep_video", "keep_last", "overwrite")
_PIPE = "Write - as the source."


# The options of an input that apply to live ones; the others apply to files alone.
_OF_INPUT = ["size", "scale", "fps", "crop", "mask", "repeats", "fov", "camera_tilt", "alarm"]


@dataclass(frozen=True)
class LiveOptions:
    """The options of `live`, beside those of its input; `dlgmd live --help` explains each.

    Attributes
    ----------
    input_size, pixel_format : (int, int), str
        Width and height of a pipe's frames in px, or of the frames requested from a camera; name of
        a pipe's pixel format in FFmpeg.
    rotate, flip : int, bool
        Turn the frames clockwise by 0, 90, 180 or 270 degrees, and mirror them.
    lockstep, input_fps : bool, float
        Answer every frame of a pipe, at this rate.
    realtime, loop : bool
        Play a file at its frame rate, again and again.
    jsonl, events, exec, udp : bool, bool, str, str
        Lines of JSON on stdout; only events; a program for each event; HOST:PORT for datagrams.
    serve : str, optional
        [HOST:]PORT of the page.
    mavlink, mavlink_… : str and others
        The autopilot's URL, and whether and how it is told to brake.
    threshold : float, optional
        Threshold of the rule, in its unit.
    speed_m_s : float or "autopilot", optional
        Speed (m/s) for whose stop the alarm is in time; react, brake, tilt and jerk describe it.
    record, keep_video, keep_last, overwrite
        The folder of a recording; whether frames are kept; the seconds before an alarm (s).
    """

    input_size: tuple[int, int] | None = None
    pixel_format: str = "gray"
    rotate: int = 0
    flip: bool = False
    lockstep: bool = False
    input_fps: float | None = None
    realtime: bool = False
    loop: bool = False
    jsonl: bool = False
    events: bool = False
    exec: str | None = None
    udp: str | None = None
    serve: str | None = None
    mavlink: str | None = None
    mavlink_brake: bool = False
    mavlink_modes: str | None = None
    mavlink_brake_mode: str | None = None
    mavlink_signing: str | None = None
    mavlink_system: int = 1
    mavlink_component: int = 196
    threshold: float | None = None
    speed_m_s: float | str | None = None
    react: float = stopping.Brake.react_s
    brake: str | float | None = None
    tilt: float | None = None
    jerk: float | None = None
    record: Path | None = None
    keep_video: bool = False
    keep_last: float | None = None
    overwrite: bool = False

    def check(self, source: str) -> None:
        """Raise ParameterError for options that need another option, or work only with a pipe."""
        speaks = self.jsonl or self.udp
        may_brake = self.mavlink and self.mavlink_modes
        modes = "Name the modes in which it may act: GUIDED,AUTO."
        either = f"{argument('jsonl', True)} or {argument('udp')}"
        brake_modes = ("mavlink_modes", "mavlink_brake_mode")
        needs: tuple[tuple[tuple[str, ...], str, object, str], ...] = (
            (("events",), either, speaks, "Add one of them."),
            (("mavlink_brake",), _both("mavlink", "mavlink_modes"), may_brake, modes),
            (brake_modes, argument("mavlink_brake", True), self.mavlink_brake, ""),
            (_OF_MAVLINK, argument("mavlink"), self.mavlink, ""),
            (_OF_RECORD, argument("record"), self.record, ""),
            (("loop",), argument("realtime", True), self.realtime, ""),
            (("lockstep", "pixel_format"), "a pipe", source == "-", _PIPE),
            (("input_fps",), argument("lockstep", True), self.lockstep, ""),
            (_STOP, argument("speed_m_s"), self.speed_m_s, ""),
        )
        changed = {one.name: getattr(self, one.name) != one.default for one in fields(self)}
        for names, what, is_there, hint in needs:
            if not is_there:
                given = {name: changed[name] for name in names}
                refuse(given, f"works only with {what}", hint or f"Add {what}.")
        if self.keep_video and self.keep_last:
            both = f"{argument('keep_video')} and {argument('keep_last')}"
            raise ParameterError("", f"{both} exclude each other", "Give one.")


def _both(*names: str) -> str:
    return " and ".join(map(argument, names))


@dataclass(eq=False)
class LiveOutcome(Outcome):
    """What became of a live source.

    Attributes
    ----------
    n_frames, n_answered, n_dropped, n_left_out, n_alarms : int
        Numbers of frames that came, of answers, of frames dropped, and left out because of the
        rate; of alarms.
    latency_ms : (float, float)
        Median and 99th percentile of the time from arrival to answer; NaN without frames.
    warnings : list of str
        What is doubtful, one line each.
    is_cut : bool
        Whether a signal ended a recording.
    is_heard : bool
        Whether the receivers and the recording got all they should.
    """

    n_frames: int
    n_answered: int
    n_dropped: int
    n_left_out: int
    n_alarms: int
    latency_ms: tuple[float, float]
    warnings: list[str] = field(default_factory=list)
    is_cut: bool = False
    is_heard: bool = True
    paths: tuple[Path, ...] = ()

    def rows(self) -> list[tuple[str, str]]:
        """The numbers as names and texts."""
        median, high = self.latency_ms
        latency = f"{median:.1f} ms, 99th percentile {high:.1f} ms" if self.n_answered else "none"
        rows = [
            ("frames", f"{self.n_frames} came, {self.n_answered} answered"),
            ("dropped", f"{self.n_dropped}"),
            ("latency", latency),
            ("alarms", f"{self.n_alarms}"),
            *(("warning", line) for line in self.warnings),
        ]
        if self.n_left_out:
            rows.insert(2, (f"left out by {argument('fps')}", f"{self.n_left_out}"))
        if self.is_cut:
            rows.append(("complete", "no, a signal ended it"))
        return rows

    def shown(self) -> Iterator[Shown]:
        """The numbers, and the folder of the recording."""
        yield ("", ""), self.rows()
        yield from self.paths

    def facts(self) -> dict[str, Json]:
        """The JSON object."""
        names = ("n_frames", "n_answered", "n_dropped", "n_left_out", "n_alarms", "warnings")
        latencies: list[Json] = [finite(value) for value in self.latency_ms]
        return {
            **{name: getattr(self, name) for name in names},
            "latency_ms": latencies,
            **super().facts(),
        }


@dataclass(frozen=True)
class Watching:
    """A watch that begins: its source, rule, numbers so far, and the page's address, if any."""

    source: LiveSource
    rule: Rule
    statistics: Statistics
    page_url: str = ""


@stating({name: RULE_ARGUMENTS[name] for name in _OF_INPUT})
@stating(LiveOptions)
def live(
    source: int | str,
    model: ModelName | None = None,
    *,
    on_answer: Callable[[Answer], object] | None = None,
    param: Mapping[str, Value] | None = None,
    watching: Callable[[Watching], AbstractContextManager[Any]] = nullcontext,
    **options: Any,
) -> LiveOutcome:
    """Raise alarms from a live source as they occur, until it ends or the user stops it.

    Parameters
    ----------
    source : str
        A camera (``"0"``, ``/dev/video0``), a stream (``rtsp://…``), ``-`` for raw frames on
        standard input, or a file with ``realtime=True``.
    model, param
        The model, as in `run`.
    on_answer : callable, optional
        Called with each answer to a frame and each event, in order; it may stop the watch by an
        exception.
    watching : callable, optional
        Called with a `Watching`; returns a context around the watch.
    options
        Options of the input, the rule and the receivers, named as those of `dlgmd live`.

    Returns
    -------
    LiveOutcome
        The numbers of the watch.

    Raises
    ------
    ParameterError
        If an option is not valid.
    SourceError
        If the source cannot be opened, or ends before its first frame.
    MissingExtraError
        If a receiver needs a package that is not installed.

    Examples
    --------
    >>> live("0", 9, serve="8000", on_answer=print)  # doctest: +SKIP
    """
    source, own = str(source), {one.name for one in fields(LiveOptions)}
    chosen = LiveOptions(**{name: options.pop(name) for name in own & options.keys()})
    chosen.check(source)
    if not chosen.realtime:
        others = {
            name: options[name] for name in RULE_ARGUMENTS.keys() & options.keys() - {*_OF_INPUT}
        }
        refuse(others, f"works only with {argument('realtime')}, which plays a file")
    given = {**options, "threshold": chosen.threshold}
    request = fold(model, None, param, given, knows_motion=chosen.mavlink is not None)
    reports = Reports()
    setup, params_at = _at_speed(request.setup, chosen, reports)
    frames = _source(source, setup, request.options, chosen)
    alarm, statistics, state = _alarm(setup), Statistics(), SourceState(frames)
    recorded = partial(Recording, frames, setup, request.options, alarm.model, state)
    frames.keeps_pictures, recording, url = chosen.keep_last is not None, None, ""
    with ExitStack() as stack:
        receivers = _outputs(chosen, reports, recorded, alarm.rule)
        has_others = len(receivers) > 1 or chosen.serve is not None or bool(on_answer)
        stack.callback(outputs.finish, receivers)
        puts: list[Callable[[Answer], object]] = [one.put for one in receivers]
        puts.append(statistics.put)
        if chosen.record is not None:
            film = VIDEO if chosen.keep_video else ""
            context = recorded(chosen.record, film=film, overwrite=chosen.overwrite)
            recording = stack.enter_context(context)
            puts.append(recording.put)
        if chosen.serve is not None:
            page = stack.enter_context(_page(str(chosen.serve), frames, statistics, alarm))
            puts.append(page.put)
            url = page.url
        puts += [] if on_answer is None else [on_answer]
        with watching(Watching(frames, alarm.rule, statistics, url)), frames:
            heading = None if chosen.mavlink is None else Heading(reports)
            watch = Watch(frames, alarm, state, reports, params_at, heading)
            with closing(Service(statistics)) as service:
                answers = _told(watch.answers(), service)
                is_heard = _deliver(answers, puts, recording, has_others=has_others)
    if frames.n_frames == 0 and not cancel.requested():
        raise SourceError(frames.name, "it ended before its first frame", "Check what sends it.")
    has_rows = recording is not None and recording.n_rows > 0
    return LiveOutcome(
        frames.n_frames,
        statistics.n_frames,
        frames.n_dropped,
        frames.n_left_out,
        statistics.n_alarms,
        statistics.latency_ms(),
        state.warnings(),
        is_cut=recording is not None and cancel.requested(),
        is_heard=is_heard and not (recording is not None and recording.has_failed),
        paths=(chosen.record,) if has_rows and chosen.record is not None else (),
    )


def _told(watched: Iterable[Answer | None], service: Service) -> Iterator[Answer | None]:
    """Tell the service manager of each answer once its receivers have it."""
    for answer in watched:
        yield answer
        service.put(answer)


def _deliver(
    watched: Iterable[Answer | None],
    puts: Iterable[Callable[[Answer], object]],
    recording: Recording | None,
    *,
    has_others: bool,
) -> bool:
    """Send answers to the receivers; False once stdout is closed and no other receiver is left."""
    is_unread = False
    for answer in watched:
        if answer is None:
            continue
        for put in puts:
            put(answer)
        is_unread = is_unread or answer.event == OUTPUT_LOST
        is_kept = recording is not None and not recording.has_failed
        if is_unread and not (is_kept or has_others):
            return False
    return True


def _at_speed(
    setup: Setup, chosen: LiveOptions, reports: Reports
) -> tuple[Setup, Callable[[float], Parameters] | None]:
    """The model with the thresholds for a speed; or, for the autopilot's, speed -> parameters.

    By the autopilot's speed, the stop is the one that the autopilot told, unless one is given.
    """
    speed, params = chosen.speed_m_s, setup.params
    if speed is None:
        return setup, None
    stopping.require_followed(params, chosen.threshold)
    brake = stopping.brake_of(chosen.brake, chosen.react, chosen.tilt, chosen.jerk)
    is_given = (chosen.brake, chosen.tilt, chosen.jerk) != (None, None, None)
    if speed != AUTOPILOT:
        speed_m_s = stopping.followed_speed(speed)
        if chosen.mavlink_brake and not is_given:
            # The default is an ArduCopter with PSC_JERK_XY 20: others need a longer stop.
            why = "which autopilot will brake is not known yet"
            hint = f"Add {argument('brake')}, or give {argument('speed_m_s', AUTOPILOT)}."
            raise ParameterError("", why, hint)
        params = stopping.following(params, brake, speed_m_s)
        return replace(setup, params=params), None
    by_autopilot = argument("speed_m_s", AUTOPILOT)
    if chosen.mavlink is None:
        raise ParameterError("", f"{by_autopilot} works only with {argument('mavlink')}", "Add it.")
    if chosen.record is not None:
        why = f"{argument('record')} does not work with {by_autopilot}: a result has one threshold"
        raise ParameterError("", why, "Leave one out.")
    given = brake if is_given else None
    return setup, lambda m_s: stopping.following(params, given or reports.brake or brake, m_s)


def _alarm(setup: Setup) -> Alarm:
    """The alarm of a model; its source says which frames it takes, and its options the camera."""
    return Alarm(setup.params, model_fps=setup.config.model_fps)


def _source(source: str, setup: Setup, reading: InputOptions, chosen: LiveOptions) -> LiveSource:
    """The source, not yet reading; raises ParameterError if there is none of this name."""
    size, name = chosen.input_size, without_password(source)
    if math.isinf(setup.model_fps) and reading.fps is None:
        reading = replace(reading, fps="all")
    shots: Callable[[], Generator[Shot, None, None]]
    is_played = source == "-" or chosen.realtime
    live_source.check_source(source, is_realtime=chosen.realtime, has_size=size is not None)
    if source == "-":
        assert size is not None  # `check_source` says so
        name = "standard input"
        fps = chosen.input_fps or setup.config.model_fps if chosen.lockstep else None
        shots = partial(live_source.shots_of_pipe, sys.stdin.buffer, size, chosen.pixel_format, fps)
    elif chosen.realtime:
        plain = replace(reading, scale=None, size=None)
        if chosen.rotate or chosen.flip:  # the source crops and masks after turning
            plain = replace(plain, crop=None, mask=None)
        opened = partial(Request((setup,), plain).open, source)
        name = os.path.abspath(source)
        shots = partial(live_source.shots_at_their_pace, opened, loops=chosen.loop)
    else:
        shots = partial(live_source.shots_of_capture, source, size)
    return live_source.LiveSource(
        name,
        shots,
        reading,
        width_px=setup.width_px,
        model_fps=setup.config.model_fps,
        tries_again=not is_played,
        must_open=live_source.is_camera(source),
        rotate=chosen.rotate,
        flip=chosen.flip,
        drops=not chosen.lockstep,
        may_pause=chosen.lockstep,
    )


def _outputs(
    chosen: LiveOptions,
    reports: Reports,
    recorded: Callable[..., Recording],
    rule: Rule,
) -> list[outputs.Receiver]:
    """The requested receivers with a thread of their own."""
    makers: dict[str, Callable[[], Any]] = {
        "jsonl": lambda: outputs.lines_on_stdout(reports),
        "udp": lambda: outputs.Datagrams(str(chosen.udp)),
        "exec": lambda: outputs.Programs(str(chosen.exec)),
        "mavlink": lambda: mavlink.Mavlink(
            str(chosen.mavlink),
            reports,
            system=chosen.mavlink_system,
            component=chosen.mavlink_component,
            modes=known_modes(str(chosen.mavlink_modes)) if chosen.mavlink_brake else (),
            braking=braking_modes(chosen.mavlink_brake_mode),
            signing=chosen.mavlink_signing,
            rule=rule,
            react_s=chosen.react,
        ),
        "keep_last": lambda: LastSeconds(
            float(chosen.keep_last or 0.0), Path(chosen.record or ""), recorded
        ),
    }
    only_events = {"jsonl": chosen.events, "udp": chosen.events, "exec": True}
    return [
        outputs.Receiver(argument(name), make(), only_events=only_events.get(name, False))
        for name, make in makers.items()
        if getattr(chosen, name) not in (None, False)
    ]


def _page(address: str, frames: LiveSource, statistics: Statistics, alarm: Alarm) -> Any:
    """The server of the page, a context manager."""
    from dlgmd_cli.watch.serve import PageServer  # needs an extra

    host, port = outputs.split_address(address, argument("serve"), "127.0.0.1")
    return PageServer(host, port, frames, statistics, alarm.rule)
