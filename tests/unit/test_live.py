"""`dlgmd live`: the newest frame wins, what hears the alarm, and what is recorded."""

import io
import json
import math
import os
import socket
import sys
import threading
import time
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from conftest import looming_frames, write_video

from dlgmd_cli import Alarm, load_set, read_result
from dlgmd_cli.errors import MissingExtraError, ParameterError, SourceError
from dlgmd_cli.live import hooks, watch
from dlgmd_cli.live.recording import Recording
from dlgmd_cli.live.watch import Answer, Events, Statistics, answers
from dlgmd_cli.models.detection import onsets
from dlgmd_cli.runs.setup import choose
from dlgmd_cli.video import live
from dlgmd_cli.video.base import Unreadable
from dlgmd_cli.video.live import LiveFrame, LiveSource, Pace, Shot
from dlgmd_cli.video.options import InputOptions

SOON_S = 5.0
UNDEFINED = Alarm().step(np.zeros((9, 9), np.uint8))


@pytest.fixture(autouse=True)
def unstopped(stop):
    """The stop flag is clear, before and after."""


def until(condition):
    """Wait for something that happens on another thread."""
    end = time.monotonic() + SOON_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def source_of(open_shots, options=None, **more):
    given = {"width_px": 240, "model_fps": 1e6} | more
    return LiveSource("camera", open_shots, options or InputOptions(), **given)


def shot(value, size_wh=(40, 30), captured_s=0.0):
    return Shot(np.full(size_wh[::-1], value, np.uint8), None, captured_s)


# Sources.


def test_the_newest_frame_wins():
    go_on = threading.Event()

    def shots(tell):
        yield shot(0)
        assert go_on.wait(SOON_S)
        for value in range(1, 6):
            yield shot(value)

    with source_of(shots) as source:
        assert source.take(SOON_S).grey[0, 0] == 0
        assert source.take(0.01) is None and not source.is_over
        go_on.set()
        until(lambda: source.is_over)
        newest = source.take(SOON_S)
        assert (newest.index, newest.grey[0, 0]) == (5, 5) and source.take(0.0) is None
    assert (source.n_frames, source.n_dropped, source.n_left_out) == (6, 4, 0)


def test_a_lost_source_is_tried_again_after_growing_pauses(monkeypatch):
    monkeypatch.setattr(live, "FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr(live, "MAX_PAUSE_S", 0.03)
    opened = []

    def shots(tell):
        opened.append(time.monotonic())
        if len(opened) == 5:
            yield shot(9)
        raise Unreadable("the source was lost")

    with source_of(shots, tries_again=True) as source:
        assert source.take(SOON_S).index == 0
        until(lambda: len(opened) == 7)
        told = list(source.messages())
    pauses = [float(line.split()[-2]) for line in told[:6]]
    assert pauses == [0.01, 0.02, 0.03, 0.03, 0.01, 0.02]  # a frame that comes begins anew
    assert told[0] == "camera: the source was lost; trying again in 0.01 s"
    assert all(b - a >= pause for a, b, pause in zip(opened, opened[1:], pauses, strict=False))


@pytest.mark.parametrize("again", [{}, {"tries_again": True, "must_open": True}])
def test_a_source_that_cannot_be_opened_is_an_error(again):
    def shots(tell):
        raise Unreadable("it is not there")
        yield

    with source_of(shots, **again) as source, pytest.raises(SourceError, match="it is not there"):
        source.take(SOON_S)


def test_a_camera_that_is_unplugged_is_tried_again(monkeypatch, tmp_path):
    """Its device goes with it; one that never was there is an error."""
    monkeypatch.setattr(live, "FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr(live, "is_camera", lambda source: True)
    device = tmp_path / "video0"
    shots = partial(live.shots_of_capture, str(device), None)
    again = {"tries_again": True, "must_open": True}
    with source_of(shots, **again) as source, pytest.raises(SourceError, match="no such camera"):
        source.take(SOON_S)
    device.touch()
    captures = [FakeCapture(1), FakeCapture(2, breaks=True), FakeCapture(1)]

    def opened(_):
        if len(captures) < 3:
            device.unlink(missing_ok=True)
        return captures.pop(0)

    monkeypatch.setattr(live.cv2, "VideoCapture", opened)
    with source_of(shots, **again) as source:
        until(lambda: source.n_frames == 1)
        told = []
        until(lambda: (told.extend(source.messages()), len(told) >= 1)[1])
        until(lambda: source.n_frames == 2)
        until(lambda: (told.extend(source.messages()), "no such camera" in told[-1])[1])
        device.touch()
        until(lambda: source.n_frames == 3)
    assert "the source was lost" in told[0] and "cannot be decoded" in "".join(told)


class FakeCapture:
    """Sends some pictures; at the last one, OpenCV fails."""

    def __init__(self, n_pictures, breaks=False):
        self._left, self._breaks = n_pictures, breaks

    def isOpened(self):  # noqa: N802
        return True

    def set(self, *_): ...
    def release(self): ...

    def grab(self):
        self._left -= 1
        return self._left >= 0

    def retrieve(self, image):
        if self._breaks and self._left == 0:
            raise cv2.error("a damaged picture")
        return True, np.zeros((30, 40, 3), np.uint8)


def test_frames_keep_their_size_when_the_pictures_change():
    def shots(tell):
        yield shot(10, (80, 60))
        until(lambda: source._newest is None)
        yield shot(20, (50, 90))

    source = source_of(shots, InputOptions(scale=0.5))
    with source:
        assert source.take(SOON_S).grey.shape == (30, 40)
        second = source.take(SOON_S)
    assert second.grey.shape == (30, 40) and second.grey[0, 0] == 20
    assert source.picture_wh == (80, 60) and source.size_wh == (40, 30)
    assert list(source.messages()) == ["camera: its pictures are 50x90 now, and are scaled"]


def test_crop_and_mask(tmp_path):
    mask = np.full((20, 20), 255, np.uint8)
    mask[:10] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    picture = np.zeros((60, 80), np.uint8)
    picture[30:50, 10:30] = 200

    def shots(tell):
        yield Shot(picture, None, 0.0)

    options = InputOptions(crop="20x20+10+30", mask=tmp_path / "mask.png")
    with source_of(shots, options) as source:
        assert (source.take(SOON_S).grey == 200).all() and source.size_wh == (20, 20)
        assert source.hidden().sum() == 200 and source.hidden()[:10].all()

    def changing(tell):
        yield Shot(picture, None, 0.0)
        yield Shot(picture[:40], None, 0.1)

    with source_of(changing, options, tries_again=True) as source:
        until(lambda: source.n_frames == 2)  # and not the end
        told = []
        until(lambda: (told.extend(source.messages()), told)[1])
        assert "reaches outside" in told[0] and "trying again" in told[0] and not source.is_over
    with (
        source_of(shots, InputOptions(crop="20x20+70+30")) as source,
        pytest.raises(SourceError, match="reaches outside its pictures of 80x60"),
    ):
        source.take(SOON_S)


def test_pictures_to_look_at_come_only_when_they_are_wanted():
    def shots(tell):
        for _ in range(2):
            until(lambda: source._newest is None)
            yield Shot(np.full((360, 1280, 3), (10, 20, 30), np.uint8), None, 0.0)

    source = source_of(shots)
    with source:
        assert source.take(SOON_S).image is None
    source = source_of(shots)
    source.wants_images = True
    with source:
        image = source.take(SOON_S).image
    assert image.shape == (180, 640, 3) and (image == (10, 20, 30)).all()


@pytest.mark.parametrize(
    ("fps", "max_fps", "taken_fps"),
    [(30, 30, 30), (30.3, 30, 30.3), (60, 30, 30), (50, 30, 25), (120, 30, 30), (60, math.inf, 60)],
)
def test_every_kth_frame_is_taken(fps, max_fps, taken_fps):
    """Even where the times jitter by a quarter of a frame."""
    jitter = np.random.default_rng(1).uniform(-0.25, 0.25, 400)
    pace = Pace(max_fps)
    taken = [t for t, moved in enumerate(jitter) if pace.is_due((t + moved) / fps)]
    late = [t for t in taken if t >= 60]
    assert set(np.diff(late)) == {round(fps / taken_fps)}
    assert pace.fps == pytest.approx(fps, rel=0.02)


def test_a_pause_does_not_alter_the_rate():
    pace, times = Pace(30.0), [n / 60 for n in range(120)]
    taken = [pace.is_due(t) for t in times]
    assert sum(taken[60:]) == 30
    assert sum(pace.is_due(t + 12.0) for t in times) == 60 and pace.fps == pytest.approx(60)


GREY = np.random.default_rng(2).integers(30, 220, (24, 32), dtype=np.uint8)


def raw(pixel_format):
    """The bytes of `GREY`, as FFmpeg would write them."""
    limited = np.rint(GREY * (219 / 255) + 16).astype(np.uint8)
    if pixel_format == "gray":
        return GREY.tobytes()
    if pixel_format == "yuyv422":
        return np.stack([limited, np.full_like(limited, 77)], axis=2).tobytes()
    if pixel_format in ("bgr24", "rgb24"):
        return np.repeat(GREY[:, :, None], 3, axis=2).tobytes()
    return limited.tobytes() + bytes([77]) * (GREY.size // 2)


@pytest.mark.parametrize("pixel_format", live.PIXEL_FORMATS)
def test_raw_frames(pixel_format):
    read_end, write_end = os.pipe()
    with os.fdopen(read_end, "rb") as pipe, os.fdopen(write_end, "wb") as writer:
        writer.write(3 * raw(pixel_format) + b"rest")
        writer.close()
        told = []
        shots = live.shots_of_pipe(pipe, (32, 24), pixel_format, told.append)
        greys = [live.to_grey(one.image, (32, 24), one.levels) for one in shots]
    assert len(greys) == 3 and "ended within a frame, after 4 of" in told[0]
    assert np.abs(np.array(greys, int) - GREY).max() <= 1


@pytest.mark.parametrize(
    ("size", "pixel_format", "is_refused"),
    [
        ((41, 30), "yuv420p", True),
        ((40, 31), "nv12", True),
        ((41, 30), "yuyv422", True),
        ((40, 31), "yuyv422", False),
        ((41, 31), "gray", False),
        ((41, 31), "bgr24", False),
    ],
)
def test_odd_sizes(size, pixel_format, is_refused):
    """FFmpeg rounds the size of colour planes up, or writes another number of bytes."""
    shots = live.shots_of_pipe(io.BytesIO(bytes(41 * 31 * 3)), size, pixel_format, print)
    if is_refused:
        with pytest.raises(ParameterError, match="is odd"):
            next(shots)
    else:
        assert next(shots).image.shape[:2] == size[::-1]


def test_colours_of_raw_frames_are_in_their_order():
    pixel = np.zeros((1, 1, 3), np.uint8)
    pixel[..., 0] = 255
    levels = {}
    for pixel_format in ("bgr24", "rgb24"):
        image, _ = live._unpacked(pixel.ravel(), (1, 1), pixel_format)
        levels[pixel_format] = int(live.to_grey(image, (1, 1))[0, 0])
    assert levels == {"bgr24": 29, "rgb24": 76}  # BT.601: 0.114 and 0.299


def test_a_file_plays_at_its_own_pace(tmp_path):
    write_video(tmp_path / "a.avi", looming_frames(6), fps=20.0)
    video = InputOptions(repeats="keep").open(tmp_path / "a.avi")
    begin = time.monotonic()
    shots = [(time.monotonic() - begin, one) for one in live.shots_at_their_pace(video, print)]
    for number, (now_s, one) in enumerate(shots):
        assert one.index == number and one.time_s == pytest.approx(number / 20)
        assert now_s >= number / 20 - 0.001


def test_a_file_that_decodes_too_slowly_plays_slower(monkeypatch):
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(live.time, "monotonic", lambda: clock.now)
    monkeypatch.setattr(live.time, "sleep", lambda s: setattr(clock, "now", clock.now + s))

    def pictures():
        for number in range(40):
            clock.now += 0.1  # to decode what lasts 0.05 s
            yield SimpleNamespace(image=None, levels=None, index=number, time_s=0.05 * number)

    told = []
    shots = list(live.shots_at_their_pace(SimpleNamespace(pictures=pictures), told.append))
    lateness = [100.1 + 0.1 * number - one.captured_s for number, one in enumerate(shots)]
    assert 0.2 < max(lateness) <= live._MAX_LATE_S + 1e-9 and len(told) == 1


@pytest.mark.parametrize(
    ("source", "more", "why"),
    [
        ("-", {}, "needs --input-size"),
        ("gopher://x", {}, "no kind of stream called gopher://"),
        ("nothing.mp4", {}, "there is no such source"),
        (__file__, {}, "is a file, not a live source"),
        ("0", {"is_realtime": True}, "works only with files"),
        ("rtsp://x", {"is_realtime": True}, "works only with files"),
        ("/dev/video0", {"is_realtime": True}, "works only with files"),
        ("rtsp://x", {"has_size": True}, "only with a pipe or a camera"),
    ],
)
def test_what_is_no_source(source, more, why):
    with pytest.raises(ParameterError, match=why):
        live.check_source(source, **{"is_realtime": False, "has_size": False} | more)


def test_passwords_are_not_shown():
    assert live.without_password("rtsp://me:secret@host/a@b") == "rtsp://host/a@b"
    assert live.without_password("rtsp://me:p@ss@host/x") == "rtsp://host/x"
    assert live.without_password("rtsp://host/a@b") == "rtsp://host/a@b"
    with pytest.raises(ParameterError) as caught:
        live.check_source("gopher://me:secret@host", is_realtime=False, has_size=False)
    assert "secret" not in str(caught.value)


# Answers.


def answer(alarm=False, *, index=0, event="", time_s=0.0, level=0.5):
    """An answer of an alarm that saw nothing, changed."""
    said = replace(UNDEFINED, mp=1.0, mp_abs=level, alarm=alarm)
    return Answer(LiveFrame(index, time_s, 0.0, np.zeros((9, 9))), said, False, event, 1.5)


def test_events_are_the_onsets_of_a_result():
    rng = np.random.default_rng(5)
    for _ in range(50):
        on = np.repeat(rng.random(40) < 0.4, rng.integers(1, 6, 40))
        time_s = np.arange(len(on)) / 25
        events = Events()
        told = [events.step(bool(flag), t) for flag, t in zip(on, time_s, strict=True)]
        assert np.array_equal(np.flatnonzero(np.array(told) == "begin"), onsets(on, time_s))
        assert "end,end" not in ",".join(event for event in told if event)
        for place in np.flatnonzero(np.array(told) == "end"):
            assert 0.3 <= time_s[place] - time_s[np.flatnonzero(on[:place])[-1]] < 0.3 + 0.041


def test_answers_are_those_of_the_alarm():
    frames = looming_frames(n_frames=30, width=64, height=48)

    def shots(tell):
        for number, frame in enumerate(frames):
            until(lambda: source._newest is None)
            yield Shot(frame, None, 50.0 + number / 30)

    source = source_of(shots)
    alarm, expected = Alarm(load_set(3)), Alarm(load_set(3))
    with source:
        found = [one for one in answers(source, alarm) if one is not None]
    assert len(found) == 31 and found[-2].said.alarm
    for number, (one, frame) in enumerate(zip(found, frames, strict=False)):
        said = expected.step(frame, number / 30)
        assert one.frame.index == number and one.frame.time_s == pytest.approx(number / 30)
        assert (one.said.mp == said.mp or math.isnan(said.mp)) and one.said.alarm == said.alarm
    *found, last = found
    assert [one.event for one in found if one.event] == ["begin"]
    # The alarm is on when the source is over: its end is told.
    assert (last.event, last.said.alarm, last.is_repeat) == ("end", False, True)
    facts = json.loads(found[-1].to_json())
    assert facts.pop("event") == "begin"
    assert list(facts) == [
        *("frame", "time_s", "mp", "mp_abs", "spike", "alarm", "g_x", "g_y", "latency_ms")
    ]
    assert facts["frame"] == 29 and facts["alarm"] is True and abs(facts["g_x"]) < 0.1
    assert json.loads(found[0].to_json())["mp"] is None  # and not NaN


def test_an_alarm_ends_when_its_source_is_silent(monkeypatch):
    monkeypatch.setattr(watch, "_SILENT_S", 0.2)
    frames, go_on = looming_frames(n_frames=30, width=64, height=48), threading.Event()

    def shots(tell):
        for number, frame in enumerate(frames):
            until(lambda: source._newest is None)
            yield Shot(frame, None, 50.0 + number / 30)
        assert go_on.wait(SOON_S)

    source, events = source_of(shots), []
    with source:
        for one in answers(source, Alarm(load_set(3))):
            if one is not None and one.event:
                events.append(one.event)
            if len(events) == 2:
                go_on.set()  # and it is not told again at the end
    assert events == ["begin", "end"]


def test_the_alarm_ignores_what_the_mask_hides():
    frames = looming_frames(n_frames=30, width=64, height=48)
    hidden = np.zeros((48, 64), bool)
    hidden[10:38, 15:49] = True
    alarm = Alarm()
    alarm.ignore(hidden)
    # What still grows beyond the mask at the end is seen.
    assert not any(alarm.step(frame, t / 30).alarm for t, frame in enumerate(frames[:28]))
    assert alarm.model.n_cells == 48 * 64 - 28 * 34


def test_statistics():
    statistics = Statistics()
    assert all(map(math.isnan, (*statistics.latency_ms(), statistics.fps)))
    for number in range(1000):
        one = replace(answer(event="begin" if number == 7 else ""), latency_ms=number + 1)
        statistics.put(one)
    assert statistics.n_frames == 1000 and statistics.n_alarms == 1
    assert statistics.latency_ms() == pytest.approx((500.5, 990.01))
    assert statistics.latency_ms(lately=True) == pytest.approx((850.5, 997.01))


# Hooks.


def test_a_hook_that_hangs_delays_nothing(monkeypatch):
    release, got, told = threading.Event(), [], []

    def deliver(one):
        release.wait(SOON_S)
        got.append(one.frame.index)

    hook = hooks.Hook("--udp", deliver, told.append)
    begin = time.monotonic()
    for number in range(500):
        hook.put(answer(index=number))
    assert time.monotonic() - begin < 1.0
    monkeypatch.setattr(hooks, "_PATIENCE_S", 0.05)
    hooks.join([hook])
    assert told == [
        "--udp: the receiver is too slow; answers are dropped",
        "--udp: the receiver did not take everything in time",
    ]
    release.set()
    hook._thread.join(SOON_S)
    assert got[-1] == 499 and len(got) <= hooks._MAX_WAITING + 1


def test_a_hook_that_fails_is_told_of_once_and_tried_again():
    got, told = [], []

    def deliver(one):
        got.append(one.frame.index)
        raise OSError("the cable is out")

    hook = hooks.Hook("--mavlink", deliver, told.append)
    for number in range(5):
        hook.put(answer(index=number))
    until(lambda: len(got) == 5)
    hook.close()
    assert told == ["--mavlink: the cable is out"] and got == [0, 1, 2, 3, 4]


def test_only_events():
    got = []
    hook = hooks.Hook("--exec", got.append, print, only_events=True)
    for event in ("", "begin", "", "end"):
        hook.put(answer(event=event))
    until(lambda: len(got) == 2)
    hook.close()
    assert [one.event for one in got] == ["begin", "end"]


@pytest.mark.parametrize(
    ("family", "host"), [(socket.AF_INET, "127.0.0.1"), (socket.AF_INET6, "::1")]
)
def test_datagrams(family, host):
    with socket.socket(family, socket.SOCK_DGRAM) as receiver:
        try:
            receiver.bind((host, 0))
        except OSError:
            pytest.skip("this machine has no such address")
        receiver.settimeout(SOON_S)
        address = f"[{host}]:{receiver.getsockname()[1]}"
        hooks.datagrams(address)(answer(True, index=7, event="begin"))
        facts = json.loads(receiver.recv(4096))
    assert facts["frame"] == 7 and facts["event"] == "begin" and facts["alarm"] is True


@pytest.mark.parametrize("text", ["", "host", "host:", ":5", "host:0", "host:70000", "host:x"])
def test_addresses_that_are_none(text):
    with pytest.raises(ParameterError, match="is not HOST:PORT"):
        hooks.split_address(text, "--udp")


@pytest.mark.parametrize("host", ["no-such-host.invalid", "a..b"])
def test_hosts_that_are_not_there(host):
    with pytest.raises(ParameterError, match="cannot be found"):
        hooks.datagrams(f"{host}:5005")


def test_an_address_may_be_a_port_alone():
    assert hooks.split_address("8000", "--serve", "127.0.0.1") == ("127.0.0.1", 8000)
    assert hooks.split_address("0.0.0.0:80", "--serve", "127.0.0.1") == ("0.0.0.0", 80)


def wait_for(*started):
    for one in started:
        for process in one._running:
            process.kill()
            process.wait()


def test_a_program_gets_the_event_in_its_environment(tmp_path):
    script = "import os, sys; open(sys.argv[1], 'w').write(repr(sorted(os.environ.items())))"
    command = f"{sys.executable} -c \"{script}\" '{tmp_path}/$HOME; x'"
    told = []
    start = hooks.Programs(command, told.append)
    start(answer(True, index=7, event="begin"))
    file = tmp_path / "$HOME; x"  # no shell has looked at it
    until(lambda: file.exists() and file.read_text())
    found = dict(eval(file.read_text()))
    assert (found["DLGMD_EVENT"], found["DLGMD_FRAME"]) == ("begin", "7")
    wait_for(start)
    assert found["DLGMD_ALARM"] == "True" and found["DLGMD_G_X"] == "" and not told


def test_programs_that_hang_or_fail():
    told = []
    start = hooks.Programs(f"{sys.executable} -c 'raise SystemExit(3)'", told.append)
    start(answer())
    start._running[0].wait()
    start(answer())
    assert told[0] == "--exec: the program ended with exit code 3"
    hanging = hooks.Programs("sleep 30", told.append)
    for _ in range(hooks._MAX_RUNNING):
        hanging(answer())
    with pytest.raises(RuntimeError, match="no more are started"):
        hanging(answer())
    wait_for(start, hanging)


@pytest.mark.parametrize(("command", "why"), [("no-such-program x", "no program"), ("'a", "quot")])
def test_programs_that_are_not_there(command, why):
    with pytest.raises(ParameterError, match=why):
        hooks.Programs(command, print)


def test_mavlink_arrives_at_a_receiver():
    mavutil = pytest.importorskip("pymavlink.mavutil", reason="pymavlink is not installed")
    receiver = mavutil.mavlink_connection("udpin:127.0.0.1:0")
    port = receiver.port.getsockname()[1]
    send = hooks.Mavlink(f"udp://127.0.0.1:{port}")
    spike = replace(answer(), said=replace(answer().said, spike=True))
    for one in (answer(), spike, answer(True, event="begin"), answer(), answer(event="end")):
        send(one)
    found = []
    while len(found) < 6:
        message = receiver.recv_match(blocking=True, timeout=SOON_S)
        assert message is not None, found
        found.append(message)
    kinds = [message.get_type() for message in found]
    assert kinds == ["HEARTBEAT", *["COLLISION"] * 2, "STATUSTEXT", "COLLISION", "STATUSTEXT"]
    assert [one.threat_level for one in found if one.get_type() == "COLLISION"] == [1, 2, 0]
    texts = [(one.severity, one.text) for one in found if one.get_type() == "STATUSTEXT"]
    assert texts == [(2, "dlgmd: collision alarm"), (5, "dlgmd: collision alarm over")]
    assert found[0].get_srcComponent() == 196  # obstacle avoidance
    receiver.close()
    send._link.close()


def test_mavlink_addresses():
    assert hooks._connection("udp://a:5") == {"device": "udpout:a:5"}
    with pytest.raises(ValueError, match="only udp:// and serial://"):
        hooks._connection("tcp://a:5")
    serial = {"device": "/dev/ttyACM0", "baud": 115200}
    assert hooks._connection("serial:///dev/ttyACM0:115200") == serial
    assert hooks._connection("serial:///dev/ttyS1") == {"device": "/dev/ttyS1", "baud": 57600}


def test_mavlink_needs_its_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "pymavlink", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'dlgmd\[live\]'"):
        hooks.Mavlink("udp://127.0.0.1:1")


# Recordings.


def watched(frames, folder, told):
    """Every answer to frames, recorded; yields the recording after each."""

    def shots(tell):
        for number, frame in enumerate(frames):
            until(lambda: source._newest is None)
            yield Shot(frame, None, 50.0 + number / 30)

    source, setup = source_of(shots), choose(set=3)
    alarm = Alarm(setup.params)
    recording = Recording(folder, source, setup, InputOptions(), alarm, told.append)
    with source:
        for one in answers(source, alarm):
            if one is not None:
                recording.put(one)
                if one.event != "end":  # of no frame
                    yield recording
    recording.close()


def test_a_recording_is_a_result_at_every_moment(tmp_path):
    frames = looming_frames(n_frames=40, width=64, height=48)
    frames[10:10] = [frames[9]]  # a repeat, which the model does not see
    for number, _ in enumerate(watched(frames, tmp_path / "r", [])):
        result = read_result(tmp_path / "r")
        assert len(result) == number + (number < 10) and not result.record["complete"]
    result = read_result(tmp_path / "r")
    assert result.record["complete"] and 10 not in result.frame
    alarm, expected = Alarm(load_set(3)), []
    for number, frame in enumerate(frames):
        expected.append(alarm.step(frame, number / 30))
    del expected[10]
    for name in ("mp", "p_sum", "s_sum", "attenuation_db", "mp_abs", "g_x", "g_y"):
        values = [getattr(one, name) for one in expected]
        np.testing.assert_allclose(getattr(result, name), values, rtol=1e-8)
    assert result.alarms.tolist() == [one.alarm for one in expected] and result.alarms.any()
    stored = yaml.safe_load((tmp_path / "r/run.yaml").read_text())["summary"]
    assert stored == pytest.approx(result.summary, rel=1e-8)
    columns = np.genfromtxt(tmp_path / "r/mp.csv", delimiter=",", names=True)
    np.testing.assert_allclose(columns["mp_seq"], result.mp_seq, rtol=1e-7, atol=1e-9)
    spikes = np.genfromtxt(tmp_path / "r/spikes.csv", delimiter=",", names=True)
    assert np.array_equal(spikes["spike"], result.spikes)
    assert np.array_equal(spikes["alarm"], result.alarms)
    assert set(os.listdir(tmp_path / "r")) == {
        *("mp.csv", "attenuation.csv", "spikes.csv", "run.yaml")
    }


def test_a_recording_that_cannot_be_written_ends_alone(tmp_path, monkeypatch):
    told, n_answers = [], 0
    frames = looming_frames(n_frames=20, width=64, height=48)
    for recording in watched(frames, tmp_path / "r", told):
        n_answers += 1
        if n_answers == 10:

            def full(cells):
                raise OSError(28, "No space left on device")

            monkeypatch.setattr(recording, "_write_rows", full)
    assert n_answers == 20 and recording.has_failed
    with open(tmp_path / "r/mp.csv", "a", encoding="ascii") as file:
        file.write("10,1,0,0,,,\n")  # as of a process that is killed between two files
    assert len(told) == 1 and "No space left on device" in told[0]
    result = read_result(tmp_path / "r")
    assert len(result) == 10 and not result.record["complete"]


# The command.


def call(*arguments, data=b""):
    from dlgmd_cli.commands.app import cli

    return CliRunner().invoke(cli, ["live", *map(str, arguments)], input=data, prog_name="dlgmd")


def test_a_pipe_to_lines_of_json_and_a_recording(tmp_path):
    frames = looming_frames(n_frames=12, width=64, height=48)
    data = b"".join(frame.tobytes() for frame in frames)
    recorded = ("--record", tmp_path / "r", "--fps", "all")
    result = call("-", "--input-size", "64x48", "--jsonl", *recorded, data=data)
    assert result.exit_code == 0, result.output
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    assert lines and lines[-1]["frame"] == 11  # a pipe is read as fast as it fills
    assert f"{len(lines)} answered" in result.stderr
    assert read_result(tmp_path / "r").frame.tolist() == [line["frame"] for line in lines]
    again = call("-", "--input-size", "64x48", *recorded, data=data)
    assert again.exit_code == 2 and "Add --overwrite to replace it" in again.stderr
    again = call("-", "--input-size", "64x48", *recorded, "--overwrite", data=data)
    assert again.exit_code == 0 and again.stdout.splitlines()[-1] == str(tmp_path / "r")
    assert "12 came" in again.stdout


def test_a_file_at_its_own_pace_gives_what_run_gives(dlgmd, tmp_path):
    frames = looming_frames(n_frames=20, width=64, height=48)
    write_video(tmp_path / "a.avi", frames, fps=30.0)
    model = ("--set", 3, "--repeats", "keep")
    result = dlgmd("live", "a.avi", *model, "--realtime", "--jsonl", "--events", "--record", "live")
    assert result.exit_code == 0, result.output
    events = [json.loads(line) for line in result.stdout.splitlines()]
    assert [one["event"] for one in events] == ["begin", "end"]  # it is told that all is over
    assert dlgmd("run", "a.avi", "--no-plots", *model).exit_code == 0
    seen, expected = read_result("live"), read_result("dlgmd-out/a")
    if len(seen) == 20:  # nothing was dropped on a busy machine
        np.testing.assert_array_equal(seen.mp, expected.mp)
        assert seen.summary == expected.summary
    assert set(seen.frame) <= set(expected.frame) and seen.params == expected.params


@pytest.mark.parametrize(
    ("arguments", "code", "why"),
    [
        (("0", "--events"), 2, "works only with --jsonl or --udp"),
        (("-", "--input-size", "8x8"), 1, "it ended before its first frame"),
        (("9999",), 1, "the camera cannot be opened"),
        (("/dev/video9999",), 1, "there is no such camera"),
        (("0", "--set", "77"), 2, "77"),
    ],
)
def test_errors(arguments, code, why):
    result = call(*arguments)
    assert result.exit_code == code and why in result.stderr, result.output
    assert not result.stdout
