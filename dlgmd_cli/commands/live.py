"""`dlgmd live`: alarms from a camera, a stream, a pipe, or a file at its own pace."""

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands import console, options
from dlgmd_cli.machine import cancel
from dlgmd_cli.video.base import PIXEL_FORMATS

if TYPE_CHECKING:
    from dlgmd_cli.watch.live import Watching

_BAR = 12

# The sections of the help, in this order.
source_option, alarm_option, receiver_option, autopilot_option, recording_option = (
    partial(click.option, cls=options.SectionOption, section=section)
    for section in ("Source", "Alarm", "Receivers", "Autopilot", "Recording")
)


@click.command(cls=console.Command)
@click.argument("source", metavar="SOURCE", shell_complete=options.complete_file)
@options.model_options
@options.alarm_option
@options.threshold_option
@options.input_options("size", "fps", "crop", "mask", "fov", "camera_tilt")
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
    "end, blind, sees and so on, DLGMD_REASON is lost, black, flat, noise, frozen or unmeasured.",
)
@receiver_option("--udp", metavar="HOST:PORT", help="Send the JSON objects as UDP datagrams.")
@autopilot_option(
    "--mavlink",
    metavar="URL",
    help="Send MAVLink's COLLISION, named values and STATUSTEXT to udp://HOST:PORT, to "
    "tcp:HOST:PORT, to serial:///dev/ttyACM0:57600, or, with udpin://[HOST:]PORT, to any program "
    "that sends to this port; needs the extra live.",
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
    help="With --mavlink-brake: modes that brake, in order, such as BRAKE,LOITER,LAND. Each mode "
    "is tried if the mode before is refused, or not reported. ALT_HOLD may be named, too, but only "
    "holds the height.  [default: the vehicle's own]",
)
@autopilot_option(
    "--mavlink-signing",
    metavar="KEYFILE",
    help="With --mavlink: sign messages by the passphrase in this file, as ground stations do, and "
    "drop those that are not signed by it.",
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
    help="With the rule expansion, corridor or ttc: alarm as early as a stop from this speed "
    "needs, but not later than at the rule's threshold. 'autopilot' takes the speed that --mavlink "
    "receives; without a speed, or at a standstill, the rule's threshold applies. With "
    "--mavlink-brake, 'autopilot' also takes the stop that the autopilot tells, unless --brake is "
    "given; a speed in M/S needs --brake.",
)
@options.stopping_options
@receiver_option(
    "--serve",
    metavar="[HOST:]PORT",
    help="Serve a page with the frames and the curves; needs the extra live. Without HOST, only "
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
def live(source: str, **chosen: Any) -> None:
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

    The JSON objects hold the columns of mp.csv that are known at the frame, such as frame, time_s
    (since the first frame), mp, expansion (1/s), ttc_s, signal (what the rule compares with its
    threshold) and alarm; also spike, rule, utc (when the frame came, by this machine's clock, as
    2026-05-01T09:30:00.125Z) and latency_ms (from capture to answer). Undefined numbers are null.

    Objects with the key event report events. begin: an alarm begins; side is its image region
    (left, ahead or right third, with high or low). end: the alarm has ended, with side, duration_s,
    peak_signal and peak_mp_abs. Pauses under 0.3 s do not end an alarm: end is reported 0.3 s late.
    blind: the source is lost, its frames show nothing, or the expansion cannot be measured (reason:
    lost, black, flat, noise, frozen or unmeasured; since_s: the time of the first such frame).
    sees: the source has recovered, or the expansion is measured again.
    output-lost: stdout is closed.
    """
    import rich.table  # noqa: F401, which takes long on a busy machine: not after Ctrl-C

    from dlgmd_cli.watch import live as task

    is_taken, chosen["rotate"] = chosen["jsonl"], int(chosen["rotate"] or 0)
    watching = partial(_watching, is_taken=is_taken)
    outcome = task.live(source, watching=watching, **chosen)
    if is_taken:
        rows = "; ".join(f"{name}: {value}" for name, value in outcome.rows())
        console.tell(f"Note: {rows}.")
    else:
        console.print_table(("", ""), outcome.rows())
        for path in outcome.paths:
            console.print_path(str(path))
    if cancel.requested() and not cancel.terminated():
        console.say("Interrupted.")
        raise click.exceptions.Exit(cancel.EXIT_INTERRUPTED)
    if not outcome.is_heard:
        raise click.exceptions.Exit(console.EXIT_FAILED)


@contextmanager
def _watching(watch: "Watching", *, is_taken: bool) -> Iterator[None]:
    """A context in which a line on the terminal shows the latest numbers, below all messages.

    If stdout `is_taken` by lines of JSON, all other output goes to stderr.
    """
    if watch.page_url:
        # Printed even with --quiet: the URL has a secret token. No full stop, which would be
        # copied.
        console.say(f"The page is at {watch.page_url}")
    with redirect_stdout(sys.stderr) if is_taken else nullcontext(), _status_line(watch):
        yield


@contextmanager
def _status_line(watch: "Watching") -> Iterator[None]:
    if console.settings().quiet or not console.is_lively():
        yield
        return
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    with Live(
        console=Console(stderr=True),
        get_renderable=lambda: Text(_status(watch), no_wrap=True, overflow="crop"),
        refresh_per_second=5,
        transient=True,
    ):
        yield


def _status(watch: "Watching") -> str:
    """The numbers of a watch on one line."""
    statistics = watch.statistics
    newest = statistics.newest
    if newest is None or statistics.n_frames < 2:
        return f"{'BLIND  ' if newest else ''}waiting for the first frame"
    median, high = statistics.latency_ms(lately=True)
    rule, signal = watch.rule, newest.detection.signal
    # The bar is full at the threshold.
    shares = (rule.threshold, signal) if rule.at_most else (signal, rule.threshold)
    share = shares[0] / shares[1] if shares[1] else 1.0
    n_full = 0 if math.isnan(share) else round(min(max(share, 0.0), 1.0) * _BAR)
    value = "–" if math.isnan(signal) else rule.with_unit(f"{signal:.2f}")
    parts = [
        "BLIND" if newest.reason else "ALARM" if newest.detection.alarm else "     ",
        f"{rule.name} {'█' * n_full}{'░' * (_BAR - n_full)} {value}",
        f"{statistics.fps:.1f} frames/s",
        f"{median:.1f} ms (99 %: {high:.1f})",
        f"{watch.source.n_dropped} dropped",
        *([statistics.busy] if statistics.busy else []),
    ]
    return "  ".join(parts)
