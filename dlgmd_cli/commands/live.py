"""`dlgmd live`: a camera, a stream, a pipe or a file at its own pace; alarms as they are raised."""

import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli import cancel
from dlgmd_cli.commands.console import (
    EXIT_FAILED,
    Command,
    note,
    print_path,
    print_table,
    say,
    settings,
    warn,
)
from dlgmd_cli.commands.options import (
    SIZE,
    complete_file,
    complete_folder,
    live_input_options,
    model_options,
    overwrite_option,
)
from dlgmd_cli.commands.progress import is_lively
from dlgmd_cli.errors import ParameterError, SourceError, printable
from dlgmd_cli.video.base import PIXEL_FORMATS

if TYPE_CHECKING:
    from dlgmd_cli.live.hooks import Hook
    from dlgmd_cli.live.serve import Screen
    from dlgmd_cli.live.watch import Answer, Statistics
    from dlgmd_cli.runs.setup import Setup
    from dlgmd_cli.video.live import LiveSource
    from dlgmd_cli.video.options import InputOptions

_BAR, _DRAW_S = 12, 0.2


def alarm_option(*args: Any, **kwargs: Any) -> Callable[[Any], Any]:
    """An option in the section of the help about who hears the alarm."""

    def decorate(command: Any) -> Any:
        command = click.option(*args, **kwargs)(command)
        command.__click_params__[-1].section = "Alarm"
        return command

    return decorate


@click.command(cls=Command, epilog="Example: dlgmd live rtsp://10.0.0.2/video --udp 127.0.0.1:5005")
@click.argument("source", metavar="SOURCE", shell_complete=complete_file)
@model_options
@live_input_options
@click.option(
    "--input-size", type=SIZE, help="Size of the frames of a pipe, or asked of a camera, in px."
)
@click.option(
    "--pixel-format",
    type=click.Choice(list(PIXEL_FORMATS)),
    default="gray",
    show_default=True,
    help="Pixel format of the frames of a pipe, as FFmpeg names it.",
)
@click.option("--realtime", is_flag=True, help="Play a file at its own pace, to try things out.")
@alarm_option(
    "--jsonl", is_flag=True, help="Print a JSON object for every frame, each on a line of stdout."
)
@alarm_option(
    "--events", is_flag=True, help="With --jsonl and --udp: only where an alarm begins or ends."
)
@alarm_option(
    "--exec",
    metavar="CMD",
    help="Start a program where an alarm begins or ends. The event is in its environment: "
    "DLGMD_EVENT is begin or end.",
)
@alarm_option("--udp", metavar="HOST:PORT", help="Send the JSON objects as UDP datagrams.")
@alarm_option(
    "--mavlink",
    metavar="URL",
    help="Send MAVLink's COLLISION and STATUSTEXT to udp://HOST:PORT or "
    "serial:///dev/ttyACM0:57600; needs dlgmd[live].",
)
@alarm_option(
    "--serve",
    metavar="[HOST:]PORT",
    help="Serve a page with the picture and the curves; needs dlgmd[live]. Without HOST, only "
    "this machine can open it; with 0.0.0.0, whoever has the address that is printed.",
)
@click.option(
    "--record",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    shell_complete=complete_folder,
    help="Keep the result in DIR, as 'dlgmd run' writes it, but without figures.",
)
@overwrite_option
def live(
    source: str,
    setup: "Setup",
    given: dict[str, Any],
    record: Path | None,
    overwrite: bool,
    **asked: Any,
) -> None:
    """Watch a live source, and tell of alarms as they are raised.

    SOURCE is a camera (0, /dev/video0), a stream (rtsp://, udp://, http://), - for a pipe of raw
    frames, or a file with --realtime.

    The newest frame wins: where the model cannot keep up, frames are dropped and counted. A source
    that is lost is tried again. Ctrl-C ends the command.

    The JSON objects hold frame, time_s, mp, mp_abs, spike, alarm, g_x, g_y (where the active cells
    are, from -1 to 1), latency_ms (from capture to answer) and, where an alarm begins or ends,
    event.
    """
    from dlgmd_cli.live.hooks import join
    from dlgmd_cli.live.recording import Recording
    from dlgmd_cli.live.watch import Statistics, answers, warm_up
    from dlgmd_cli.models.detection import Alarm
    from dlgmd_cli.results import store
    from dlgmd_cli.runs.setup import input_options

    if asked["events"] and not (asked["jsonl"] or asked["udp"]):
        raise ParameterError("", "--events works only with --jsonl or --udp", "Add one of them.")
    options = input_options(setup, given)
    frames = _open(source, setup, options, asked)
    alarm = Alarm(setup.params, repeats=options.repeats or "skip", engine=setup.engine)
    statistics, status = Statistics(), Status(frames)
    with ExitStack() as stack:
        hooks = _hooks(asked, frames, status.tell)
        stack.callback(join, hooks)
        receivers: list[Any] = [*hooks, statistics]
        recording = screen = None
        if record is not None:
            store.check(record, store.RUN, {"path": frames.name}, overwrite=overwrite)
            stack.enter_context(store.locked(record))
            recording = Recording(record, frames, setup, options, alarm, status.tell)
            stack.callback(recording.close)
            receivers.append(recording)
        if asked["serve"]:
            threshold = setup.params.t_mp
            screen = stack.enter_context(_screen(asked["serve"], frames, statistics, threshold))
            receivers.append(screen)
        warm_up(alarm)
        with status.shown(), frames:
            for answer in answers(frames, alarm, lambda: frames.wants_images):
                for message in frames.messages():
                    status.tell(message)
                    if screen is not None:
                        screen.tell(message)
                if answer is not None:
                    for receiver in receivers:
                        receiver.put(answer)
                status.update(answer, statistics)
            for message in frames.messages():
                status.tell(message)
    if frames.n_frames == 0 and not cancel.requested():
        raise SourceError(frames.name, "it ended before its first frame", "Check what sends it.")
    _show(statistics, frames, record if recording and recording.has_begun else None, asked["jsonl"])
    if cancel.requested():
        say("Interrupted.")
        raise click.exceptions.Exit(cancel.EXIT_INTERRUPTED)
    if recording is not None and recording.has_failed:
        raise click.exceptions.Exit(EXIT_FAILED)


def _open(
    source: str, setup: "Setup", options: "InputOptions", asked: dict[str, Any]
) -> "LiveSource":
    """The source, not yet reading."""
    from dlgmd_cli.video.live import (
        LiveSource,
        check_source,
        is_camera,
        shots_at_their_pace,
        shots_of_capture,
        shots_of_pipe,
        without_password,
    )

    size = asked["input_size"]
    made_for: Any = {"width_px": setup.width_px, "model_fps": setup.model_fps}
    check_source(source, is_realtime=asked["realtime"], has_size=size is not None)
    name = without_password(source)
    shots: Any
    if source == "-":
        shots = partial(shots_of_pipe, sys.stdin.buffer, size, asked["pixel_format"])
        return LiveSource("standard input", shots, options, **made_for)
    if not asked["realtime"]:
        shots = partial(shots_of_capture, source, size)
        again = {"tries_again": True, "must_open": is_camera(source)}
        return LiveSource(name, shots, options, **made_for, **again)
    plain = replace(options, scale=None, size=None, crop=None, mask=None, repeats="keep")
    video = plain.open(source, **made_for)
    shots = partial(shots_at_their_pace, video)
    return LiveSource(os.path.abspath(source), shots, options, **made_for)


def _hooks(
    asked: dict[str, Any], frames: "LiveSource", tell: Callable[[str], None]
) -> "list[Hook]":
    """What was asked to hear the alarm."""
    from dlgmd_cli.live import hooks

    makers: dict[str, Callable[[], Any]] = {
        "jsonl": lambda: hooks.lines_on_stdout(frames.end),
        "udp": lambda: hooks.datagrams(asked["udp"]),
        "exec": lambda: hooks.Programs(asked["exec"], tell),
        "mavlink": lambda: hooks.Mavlink(asked["mavlink"]),
    }
    only_events = {"jsonl": asked["events"], "udp": asked["events"], "exec": True}
    return [
        hooks.Hook(f"--{name}", make(), tell, only_events=only_events.get(name, False))
        for name, make in makers.items()
        if asked[name]
    ]


def _screen(
    place: str, frames: "LiveSource", statistics: "Statistics", threshold: float
) -> "Screen":
    """The server of the page."""
    from dlgmd_cli.live.hooks import split_address
    from dlgmd_cli.live.serve import Screen

    host, port = split_address(place, "--serve", "127.0.0.1")
    screen = Screen(host, port, frames, statistics, threshold)
    # With --quiet too: nobody could guess the token. Without a full stop, which would be copied.
    say(f"The page is at {screen.url}")
    return screen


class Status:
    """The line on a terminal that says how it goes, drawn by a thread of its own."""

    def __init__(self, source: "LiveSource") -> None:
        self._source, self._line = source, "waiting for the first frame"
        self._live: Any = None
        self._said: Any = None
        self._drawn_s = -math.inf

    @contextmanager
    def shown(self) -> Iterator[None]:
        """A context in which the line is there, if stderr is a terminal."""
        if settings().quiet or not is_lively():
            yield
            return
        from rich.console import Console
        from rich.live import Live
        from rich.text import Text

        console = Console(stderr=True)
        line = Live(
            console=console,
            get_renderable=lambda: Text(self._line, no_wrap=True, overflow="crop"),
            refresh_per_second=5,
            transient=True,
        )
        with line:
            self._live = line
            yield
        self._live = None

    def tell(self, message: str) -> None:
        """A warning above the line; may be called from any thread."""
        if self._live is None:
            warn(message)
        else:
            self._live.console.print(f"Warning: {printable(message)}.", markup=False)

    def update(self, answer: "Answer | None", statistics: "Statistics") -> None:
        """Take in what came last: an answer, or that none came."""
        if answer is not None:
            self._said = answer.said
        now_s = time.monotonic()
        if self._live is None or statistics.n_frames < 2 or now_s - self._drawn_s < _DRAW_S:
            return
        self._drawn_s = now_s
        median, high = statistics.latency_ms(lately=True)
        said, source = self._said, self._source
        level = 0.0 if math.isnan(said.mp_abs) else said.mp_abs
        n_full = round(level * _BAR)
        parts = [
            "ALARM" if said.alarm else "     ",
            f"MP {'█' * n_full}{'░' * (_BAR - n_full)} {level:.2f}",
            f"{statistics.fps:.1f} frames/s",
            f"{median:.1f} ms (99 %: {high:.1f})",
            f"{source.n_dropped} dropped",
        ]
        self._line = "  ".join(parts)


def _show(
    statistics: "Statistics", source: "LiveSource", record: Path | None, as_note: bool
) -> None:
    """What the session came to: a table on stdout, or a note where stdout has the lines of JSON."""
    median, high = statistics.latency_ms()
    latency = f"{median:.1f} ms, 99th percentile {high:.1f} ms" if statistics.n_frames else "none"
    rows = [
        ("frames", f"{source.n_frames} came, {statistics.n_frames} answered"),
        ("dropped", f"{source.n_dropped}"),
        ("latency", latency),
        ("alarms", f"{statistics.n_alarms}"),
    ]
    if source.n_left_out:
        rows.insert(2, ("left out by --fps", f"{source.n_left_out}"))
    if as_note:
        note("; ".join(f"{name}: {value}" for name, value in rows))
        return
    print_table(("", ""), rows)
    if record is not None:
        print_path(record)
