"""`dlgmd live`: alarms from a camera, a stream, a pipe, or a file at its own pace."""

import math
import os
import sys
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager, redirect_stdout
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from dlgmd_cli.commands import console, options, thresholds
from dlgmd_cli.errors import ParameterError, SourceError, argument
from dlgmd_cli.machine import cancel
from dlgmd_cli.video.base import PIXEL_FORMATS, without_password

if TYPE_CHECKING:
    from dlgmd_cli.live.outputs import Receiver
    from dlgmd_cli.live.recording import Recording
    from dlgmd_cli.live.reports import Reports
    from dlgmd_cli.live.serve import PageServer
    from dlgmd_cli.live.service import Service
    from dlgmd_cli.live.statistics import Statistics
    from dlgmd_cli.live.watch import Answer, SourceState
    from dlgmd_cli.models.rules import Rule
    from dlgmd_cli.models.session import Session
    from dlgmd_cli.video.input_options import InputOptions
    from dlgmd_cli.video.live_source import LiveSource

_BAR = 12
# The options of a stop.
_STOP = ("react", "brake", "tilt", "jerk")


# The sections of the help, in this order.
source_option, alarm_option, receiver_option, autopilot_option, recording_option = (
    partial(click.option, cls=options.SectionOption, section=section)
    for section in ("Source", "Alarm", "Receivers", "Autopilot", "Recording")
)


@click.command(cls=console.Command)
@click.argument("source", metavar="SOURCE", shell_complete=options.complete_file)
@options.model_options(options.alarm_option, thresholds.threshold_option)
@options.input_options("size", "fps", "crop", "mask", "fov", "camera_tilt", argument="given")
@source_option(
    "--input-size",
    type=options.SIZE,
    help="Size in px of a pipe's frames, or the size requested from a camera.",
)
@source_option(
    "--pixel-format",
    type=click.Choice(list(PIXEL_FORMATS)),
    default="gray",
    show_default=True,
    help="Pixel format of the frames of a pipe, as FFmpeg names it.",
)
@source_option(
    "--rotate",
    type=click.Choice(["90", "180", "270"]),
    help="Turn the frames clockwise by this angle; 180 for a camera that hangs upside down.",
)
@source_option("--flip", is_flag=True, help="Mirror the frames, left for right.")
@source_option(
    "--lockstep",
    is_flag=True,
    help="With a pipe: answer every frame and drop none, for a simulator that waits. Times are "
    "counted by --input-fps; a pause of the pipe is not a lost source.",
)
@options.input_option(
    "input_fps",
    "With --lockstep: frames per second of the pipe.  [default: the rate of the model]",
)
@source_option("--realtime", is_flag=True, help="Play a file at its frame rate, for trials.")
@source_option("--loop", is_flag=True, help="With --realtime: play the file again and again.")
@receiver_option(
    "--jsonl", is_flag=True, help="Print a JSON object for every frame, each on a line of stdout."
)
@receiver_option(
    "--events", is_flag=True, help="With --jsonl and --udp: only the objects with an event."
)
@receiver_option(
    "--exec",
    metavar="CMD",
    help="Start a program at each event. The object is in its environment: DLGMD_EVENT is begin, "
    "end, blind, sees and so on, DLGMD_REASON is lost, black, flat, noise or frozen.",
)
@receiver_option("--udp", metavar="HOST:PORT", help="Send the JSON objects as UDP datagrams.")
@autopilot_option(
    "--mavlink",
    metavar="URL",
    help="Send MAVLink's COLLISION, named values and STATUSTEXT to udp://HOST:PORT, to "
    "serial:///dev/ttyACM0:57600, or, with udpin://PORT, to any program that sends to this port; "
    "needs dlgmd[live].",
)
@autopilot_option(
    "--mavlink-brake",
    is_flag=True,
    help="Experimental, with --mavlink: command the autopilot to brake, if it is armed and in one "
    "of --mavlink-modes: BRAKE in ArduCopter, HOLD in ArduRover, Hold in PX4. The end of the alarm "
    "does not release it.",
)
@autopilot_option(
    "--mavlink-modes",
    metavar="LIST",
    help="Modes in which --mavlink-brake, which requires them, may act: names or numbers, such as "
    "GUIDED,AUTO.",
)
@autopilot_option(
    "--mavlink-brake-mode",
    metavar="LIST",
    help="With --mavlink-brake: modes that brake, in order, such as BRAKE,ALT_HOLD,LAND. Each mode "
    "is tried if the mode before is refused, or not reported.  [default: the vehicle's own]",
)
@autopilot_option(
    "--mavlink-signing",
    metavar="KEYFILE",
    help="With --mavlink: sign messages by the passphrase in this file, as ground stations do.",
)
@autopilot_option(
    "--mavlink-system",
    type=options.numeric(int, 1, 255),
    default=1,
    show_default=True,
    help="With --mavlink: number of the vehicle, shared by the autopilot and this program.",
)
@autopilot_option(
    "--mavlink-component",
    type=options.numeric(int, 2, 255),
    default=196,
    show_default=True,
    help="With --mavlink: number of this program; 196 is obstacle avoidance.",
)
@alarm_option(
    "--speed-m-s",
    metavar="M/S|autopilot",
    help="With the rule expansion or ttc: alarm in time for a stop from this speed, instead of at "
    "expansion_alarm or ttc_alarm. 'autopilot' takes the speed that --mavlink receives; without a "
    "speed, or at a standstill, expansion_alarm or ttc_alarm apply.",
)
@options.stopping_options
@receiver_option(
    "--serve",
    metavar="[HOST:]PORT",
    help="Serve a page with the frames and the curves; needs dlgmd[live]. Without HOST, only "
    "this machine can open it; with 0.0.0.0, everyone who has the address that is printed.",
)
@options.folder_option(
    "--record",
    cls=options.SectionOption,
    section="Recording",
    help="Keep the result in DIR, as 'dlgmd run' writes it, but without figures.",
)
@recording_option(
    "--keep-video",
    is_flag=True,
    help="With --record: also keep the frames that the model processed, for 'dlgmd view'.",
)
@recording_option(
    "--keep-last",
    type=options.numeric(low_open=True, high=3600),
    metavar="S",
    help="With --record: at each alarm, keep the frames of the last S seconds and of the alarm, "
    "in a result of its own: DIR/alarm-1, DIR/alarm-2 …",
)
@options.overwrite_option
def live(
    source: str,
    model: "options.Setup",
    given: dict[str, Any],
    overwrite: bool,
    **chosen: Any,
) -> None:
    """Process a live source, and raise alarms as they occur.

    \b
    Examples:
      dlgmd live 0 --serve 8000                            # a camera, and a page
      dlgmd live rtsp://10.0.0.2/video --udp 127.0.0.1:5005
      dlgmd live flight.mp4 --realtime --jsonl             # a file; JSON lines

    SOURCE is a camera (0, /dev/video0), a stream (rtsp://, udp://, http://, stream.sdp for RTP), -
    for a pipe of raw frames, or a file with --realtime.

    A busy computer first leaves out what the rule does not use (left_out names it). If that is not
    enough, only every second, third ... frame is answered, and the event rate reports how many. A
    lost source is opened again. Ctrl-C ends the command; SIGTERM and SIGHUP end it with exit code
    0.

    The JSON objects hold frame, time_s (since the first frame), repeat (a duplicate frame), utc
    (when the frame came, by this machine's clock, as 2026-05-01T09:30:00.125Z), mp, mp_abs, spike,
    alarm, g_x, g_y (the centroid of the active cells, from -1 to 1), expansion and expansion_across
    (1/s), expansion_quality, ttc_s (the estimated time to contact; null where the image does not
    expand), rule and latency_ms (from capture to answer).

    Objects with the key event report events. begin: an alarm begins; side is its image region
    (left, ahead or right third, with high or low). end: the alarm has ended, with side, duration_s
    and peak_mp_abs. Pauses under 0.3 s do not end an alarm: end is reported 0.3 s late. blind: the
    source is lost or its frames show nothing (reason: lost, black, flat, noise or frozen; since_s:
    the time of the first such frame). sees: the source has recovered for half a second.
    output-lost: stdout is closed.
    """
    from dlgmd_cli.live.heading import Heading
    from dlgmd_cli.live.outputs import finish
    from dlgmd_cli.live.recording import VIDEO, Recording
    from dlgmd_cli.live.reports import Reports
    from dlgmd_cli.live.service import Service
    from dlgmd_cli.live.statistics import Statistics
    from dlgmd_cli.live.watch import SourceState, Watch
    from dlgmd_cli.tasks.call import options_for

    _check(source, chosen)
    setup, threshold_at = _at_speed(model, chosen)
    reading = options_for(setup, given)
    frames, reports = _source(source, setup, reading, chosen), Reports()
    session, statistics, state = _session(setup), Statistics(), SourceState(frames)
    recorded = partial(Recording, frames, setup, reading, session.models[0], state)
    frames.keeps_pictures, recording = chosen["keep_last"] is not None, None
    with ExitStack() as stack:
        outputs = _outputs(chosen, reports, recorded)
        stack.callback(finish, outputs)
        receivers: list[Any] = [*outputs, statistics]
        if chosen["record"] is not None:
            film = VIDEO if chosen["keep_video"] else ""
            context = recorded(chosen["record"], film=film, overwrite=overwrite)
            recording = stack.enter_context(context)
            receivers.append(recording)
        if chosen["serve"] is not None:
            page = _page(chosen["serve"], frames, statistics, session.rules[0])
            receivers.append(stack.enter_context(page))
        import rich.table  # noqa: F401, which takes long on a busy machine: not after Ctrl-C

        if chosen["jsonl"]:  # stdout is for JSON alone: other output goes to stderr
            stack.enter_context(redirect_stdout(sys.stderr))
        with _status_line(frames, statistics), frames:
            heading = None if chosen["mavlink"] is None else Heading(reports)
            watch = Watch(frames, session, state, reports, threshold_at, heading)
            has_others = len(outputs) > 1 or chosen["serve"] is not None
            with closing(Service(statistics)) as service:
                answers = _told(watch.answers(), service)
                is_heard = _deliver(answers, receivers, recording, has_others=has_others)
    _end(frames, statistics, state, recording, chosen)
    if not is_heard or (recording is not None and recording.has_failed):
        raise click.exceptions.Exit(console.EXIT_FAILED)


def _told(watched: "Iterable[Answer | None]", service: "Service") -> "Iterator[Answer | None]":
    """Tell the service manager of each answer once its receivers have it."""
    for answer in watched:
        yield answer
        service.put(answer)


def _deliver(
    watched: "Iterable[Answer | None]",
    receivers: list[Any],
    recording: "Recording | None",
    *,
    has_others: bool,
) -> bool:
    """Send answers to the receivers; False once stdout is closed and no other receiver is left."""
    from dlgmd_cli.live.watch import OUTPUT_LOST

    is_unread = False
    for answer in watched:
        for receiver in receivers if answer is not None else ():
            receiver.put(answer)
        is_unread = is_unread or (answer is not None and answer.event == OUTPUT_LOST)
        is_kept = recording is not None and not recording.has_failed
        if is_unread and not (is_kept or has_others):
            return False
    return True


def _check(source: str, chosen: dict[str, Any]) -> None:
    """Raise ParameterError for options that need another option, or work only with a pipe."""
    speaks, brakes = chosen["jsonl"] or chosen["udp"], chosen["mavlink_brake"]
    may_brake = chosen["mavlink"] and chosen["mavlink_modes"]
    modes = "Name the modes in which it may act: GUIDED,AUTO."
    needs = (
        ("events", "--jsonl or --udp", speaks, "Add one of them."),
        ("mavlink_brake", "--mavlink and --mavlink-modes", may_brake, modes),
        ("mavlink_modes", "--mavlink-brake", brakes, "Add --mavlink-brake."),
        ("mavlink_brake_mode", "--mavlink-brake", brakes, "Add --mavlink-brake."),
        ("mavlink_signing", "--mavlink", chosen["mavlink"], "Add --mavlink URL."),
        ("keep_video", "--record", chosen["record"], "Add --record DIR."),
        ("keep_last", "--record", chosen["record"], "Add --record DIR."),
        ("loop", "--realtime", chosen["realtime"], "Add --realtime."),
        ("lockstep", "a pipe", source == "-", "Write - as the source."),
        ("input_fps", "--lockstep", chosen["lockstep"], "Add --lockstep."),
        *((name, "--speed-m-s", chosen["speed_m_s"], "Add --speed-m-s.") for name in _STOP),
    )
    given = click.get_current_context().get_parameter_source
    for name, what, is_there, hint in needs:
        is_given = given(name) is not ParameterSource.DEFAULT
        if is_given and chosen[name] not in (None, False) and not is_there:
            raise ParameterError("", f"{argument(name)} works only with {what}", hint)
    if chosen["keep_video"] and chosen["keep_last"]:
        raise ParameterError("", "--keep-video and --keep-last exclude each other", "Give one.")


def _at_speed(
    setup: "options.Setup", chosen: dict[str, Any]
) -> "tuple[options.Setup, Callable[[float], float] | None]":
    """The model with the threshold for --speed-m-s; or, for autopilot, speed -> threshold."""
    from dlgmd_cli.models import stopping
    from dlgmd_cli.models.rules import rule_of

    speed, params = stopping.speed_of(chosen["speed_m_s"], "autopilot"), setup.params
    if speed is None:
        return setup, None
    stopping.require_followed(params, click.get_current_context().meta.get("threshold"))
    brakes = stopping.brakes_of(*(chosen[name] for name in _STOP))
    if speed != "autopilot":
        return replace(setup, params=stopping.following(params, brakes, float(speed))), None
    if chosen["mavlink"] is None:
        raise ParameterError("", "--speed-m-s autopilot works only with --mavlink", "Add it.")
    if chosen["record"] is not None:
        why = "--record does not work with --speed-m-s autopilot: a result has one threshold"
        raise ParameterError("", why, "Leave one out.")
    return setup, lambda m_s: rule_of(stopping.following(params, brakes, m_s)).threshold


def _session(setup: "options.Setup") -> "Session":
    """The session of a model, with the expansion beside it."""
    from dlgmd_cli.models.base import create_model
    from dlgmd_cli.models.expansion import Expansion
    from dlgmd_cli.models.session import Session

    model = create_model(setup.params, engine=setup.engine)
    return Session([model], Expansion())


def _source(
    source: str, setup: "options.Setup", reading: "InputOptions", chosen: dict[str, Any]
) -> "LiveSource":
    from dlgmd_cli.tasks.call import Request
    from dlgmd_cli.video import live_source

    size, name = chosen["input_size"], without_password(source)
    shots: Callable[[], Generator[live_source.Shot, None, None]]
    is_played = source == "-" or chosen["realtime"]
    live_source.check_source(source, is_realtime=chosen["realtime"], has_size=size is not None)
    if source == "-":
        name = "standard input"
        fps = chosen["input_fps"] or setup.config.model_fps if chosen["lockstep"] else None
        pipe, pixels = sys.stdin.buffer, chosen["pixel_format"]
        shots = partial(live_source.shots_of_pipe, pipe, size, pixels, fps)
    elif chosen["realtime"]:
        plain = replace(reading, scale=None, size=None)
        if chosen["rotate"] or chosen["flip"]:  # the source crops and masks after turning
            plain = replace(plain, crop=None, mask=None)
        opened = partial(Request((setup,), plain).open, source)
        name = os.path.abspath(source)
        shots = partial(live_source.shots_at_their_pace, opened, loops=chosen["loop"])
    else:
        shots = partial(live_source.shots_of_capture, source, size)
    return live_source.LiveSource(
        name,
        shots,
        reading,
        width_px=setup.config.width_px,
        model_fps=setup.config.model_fps,
        waits=is_played,
        tries_again=not is_played,
        must_open=live_source.is_camera(source),
        rotate=int(chosen["rotate"] or 0),
        flip=chosen["flip"],
        drops=not chosen["lockstep"],
        may_pause=chosen["lockstep"],
    )


def _outputs(
    chosen: dict[str, Any],
    reports: "Reports",
    recorded: "Callable[..., Recording]",
) -> "list[Receiver]":
    """The requested receivers, except the page and the recording."""
    from dlgmd_cli.live import mavlink, outputs
    from dlgmd_cli.live.autopilot import braking_modes, known_modes
    from dlgmd_cli.live.recording import LastSeconds

    makers: dict[str, Callable[[], Any]] = {
        "jsonl": lambda: outputs.lines_on_stdout(reports),
        "udp": lambda: outputs.Datagrams(chosen["udp"]),
        "exec": lambda: outputs.Programs(chosen["exec"]),
        "mavlink": lambda: mavlink.Mavlink(
            chosen["mavlink"],
            reports,
            system=chosen["mavlink_system"],
            component=chosen["mavlink_component"],
            modes=known_modes(chosen["mavlink_modes"]) if chosen["mavlink_brake"] else (),
            braking=braking_modes(chosen["mavlink_brake_mode"]),
            signing=chosen["mavlink_signing"],
        ),
        "keep_last": lambda: LastSeconds(chosen["keep_last"], chosen["record"], recorded),
    }
    only_events = {"jsonl": chosen["events"], "udp": chosen["events"], "exec": True}
    return [
        outputs.Receiver(argument(name), make(), only_events=only_events.get(name, False))
        for name, make in makers.items()
        if chosen[name] not in (None, False)
    ]


def _page(
    address: str, frames: "LiveSource", statistics: "Statistics", rule: "Rule"
) -> "PageServer":
    from dlgmd_cli.live.outputs import split_address
    from dlgmd_cli.live.serve import PageServer

    host, port = split_address(address, "--serve", "127.0.0.1")
    page = PageServer(host, port, frames, statistics, rule)
    # Printed even with --quiet: the URL has a secret token. No full stop, which would be copied.
    console.say(f"The page is at {page.url}")
    return page


@contextmanager
def _status_line(source: "LiveSource", statistics: "Statistics") -> Iterator[None]:
    """A context in which a line on the terminal shows the latest numbers, below all messages."""
    if console.settings().quiet or not console.is_lively():
        yield
        return
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    with Live(
        console=Console(stderr=True),
        get_renderable=lambda: Text(_status(source, statistics), no_wrap=True, overflow="crop"),
        refresh_per_second=5,
        transient=True,
    ):
        yield


def _status(source: "LiveSource", statistics: "Statistics") -> str:
    newest = statistics.newest
    if newest is None or statistics.n_frames < 2:
        return f"{'BLIND  ' if newest else ''}waiting for the first frame"
    median, high = statistics.latency_ms(lately=True)
    detection = newest.detection
    level = 0.0 if math.isnan(detection.mp_abs) else detection.mp_abs
    n_full = round(level * _BAR)
    parts = [
        "BLIND" if newest.reason else "ALARM" if detection.alarm else "     ",
        f"MP {'█' * n_full}{'░' * (_BAR - n_full)} {level:.2f}",
        f"{statistics.fps:.1f} frames/s",
        f"{median:.1f} ms (99 %: {high:.1f})",
        f"{source.n_dropped} dropped",
        *([statistics.busy] if statistics.busy else []),
    ]
    return "  ".join(parts)


def _end(
    frames: "LiveSource",
    statistics: "Statistics",
    state: "SourceState",
    recording: "Recording | None",
    chosen: dict[str, Any],
) -> None:
    """Show the numbers and the folder of the recording; exits with code 130 after Ctrl-C."""
    if frames.n_frames == 0 and not cancel.requested():
        raise SourceError(frames.name, "it ended before its first frame", "Check what sends it.")
    is_cut = recording is not None and cancel.requested()
    _show(statistics, frames, state.warnings(), is_cut=is_cut, as_note=chosen["jsonl"])
    if recording is not None and recording.n_rows and not chosen["jsonl"]:
        console.print_path(str(chosen["record"]))
    if cancel.requested() and not cancel.terminated():
        console.say("Interrupted.")
        raise click.exceptions.Exit(cancel.EXIT_INTERRUPTED)


def _show(
    statistics: "Statistics",
    source: "LiveSource",
    warnings: list[str],
    *,
    is_cut: bool,
    as_note: bool,
) -> None:
    """Show the numbers of the session: a table on stdout; a note if stdout has lines of JSON.

    `is_cut` says whether a signal ended the recording.
    """
    median, high = statistics.latency_ms()
    latency = f"{median:.1f} ms, 99th percentile {high:.1f} ms" if statistics.n_frames else "none"
    rows = [
        ("frames", f"{source.n_frames} came, {statistics.n_frames} answered"),
        ("dropped", f"{source.n_dropped}"),
        ("latency", latency),
        ("alarms", f"{statistics.n_alarms}"),
        *(("warning", line) for line in warnings),
    ]
    if source.n_left_out:
        rows.insert(2, ("left out by --fps", f"{source.n_left_out}"))
    if is_cut:
        rows.append(("complete", "no, a signal ended it"))
    if as_note:
        console.tell(f"Note: {'; '.join(f'{name}: {value}' for name, value in rows)}.")
    else:
        console.print_table(("", ""), rows)
