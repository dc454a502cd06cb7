"""`dlgmd live`: the newest frame wins, receivers of alarms, blindness, and recordings."""

import io
import json
import math
import os
import socket
import sys
import threading
import time
import warnings
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import islice
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from conftest import full, looming_frames, read_video, until, write_video, yaml_of

import dlgmd_cli
from dlgmd_cli import Alarm, Detection, load_set, read_result, run
from dlgmd_cli.errors import DlgmdWarning, ParameterError, SourceError
from dlgmd_cli.frame import FULL, Frame
from dlgmd_cli.models.corridor import Motion
from dlgmd_cli.models.detection import spans
from dlgmd_cli.models.health import BLIND_S
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.parameters.keys import changed
from dlgmd_cli.results import csv
from dlgmd_cli.results.files import names_of
from dlgmd_cli.stream.clock import Pace
from dlgmd_cli.tasks.call import choose
from dlgmd_cli.video import live_source
from dlgmd_cli.video.base import Unreadable, without_password
from dlgmd_cli.video.input_options import InputOptions
from dlgmd_cli.video.live_source import LiveSource, Shot
from dlgmd_cli.video.luma import to_grey
from dlgmd_cli.video.opening import open_input, open_video
from dlgmd_cli.video.source import Picture, Video
from dlgmd_cli.watch import outputs, watch
from dlgmd_cli.watch.heading import Heading
from dlgmd_cli.watch.recording import KeptVideo, LastSeconds, Recording
from dlgmd_cli.watch.reports import Attitude, Reports
from dlgmd_cli.watch.statistics import Statistics
from dlgmd_cli.watch.watch import (
    BLIND_WORDS,
    Answer,
    Events,
    SourceState,
    Watch,
    utc_text,
)

SOON_S = 5.0
AGAIN = {"tries_again": True, "must_open": True}


@pytest.fixture(autouse=True)
def unstopped(stop):
    """The stop flag is clear, before and after."""


def source_of(shots, options=None, **more):
    """A source of shots: a function that yields them, or takes the source to wait for it."""
    given = {"width_px": 240, "model_fps": 1e6} | more
    return LiveSource("camera", shots, options or InputOptions(), **given)


def shot(value, size_wh=(40, 30), captured_s=0.0):
    return Shot(np.full(size_wh[::-1], value, np.uint8), FULL, captured_s)


def played(pictures, options=None, fps=30.0, **more):
    """A source of images, one after the other, as fast as they are taken."""

    def shots():
        yield Shot(pictures[0], FULL, 0.0)  # whose time is that of its being read
        for number, picture in enumerate(pictures[1:], 1):
            yield Shot(picture, FULL, source.first_s + number / fps)

    source = source_of(shots, options, drops=False, **more)
    return source


def alarm_of(model=None):
    """An alarm of a model."""
    setup = choose(model)
    return Alarm(setup.params, model_fps=setup.config.model_fps)


def answered(source, alarm=None, **more):
    """The answers to a source, and its sight."""
    sight = SourceState(source)
    with source:
        every = Watch(source, alarm or alarm_of(), sight, **more).answers()
        found = [one for one in every if one is not None]
    return found, sight


# Sources.


def test_frames_that_nobody_takes_in_time_are_dropped():
    """Those of the last 0.3 s wait."""
    go_on = threading.Event()

    def shots():
        yield shot(0)
        assert go_on.wait(SOON_S)
        for value in range(1, 6):
            yield shot(value, captured_s=time.monotonic() + value / 8.0)

    with source_of(shots) as source:
        assert source.take(SOON_S).grey[0, 0] == 0
        assert source.take(0.01) is None and not source.is_over
        go_on.set()
        until(lambda: source.is_over)
        taken = [source.take(0.0) for _ in range(3)]
        assert [frame.index for frame in taken] == [3, 4, 5] and source.take(0.0) is None
    assert (source.n_frames, source.n_dropped, source.n_left_out) == (6, 2, 0)


@pytest.mark.parametrize("n_late", [9, 27])
def test_the_frames_of_a_burst_are_taken_one_after_the_other(n_late):
    """Sixteen wait at most, with those that come in time behind them."""
    sent = np.arange(90 + n_late + 5) / 60
    came = np.where(np.arange(len(sent)) < 90, sent, np.maximum(sent, sent[90 + n_late]))
    came[90 : 90 + n_late] += 0.002 * np.arange(-n_late, 0)

    def shots():
        yield shot(0)  # whose time is that of its being read
        yield from (shot(0, captured_s=source.first_s + came_s) for came_s in came[1:])

    source = source_of(shots)
    with source:
        until(lambda: source.is_over)
        taken = [source.take(0.0).index for _ in range(len(source._waiting))]
    assert taken == [*range(len(sent) - 16, len(sent))]
    assert source.n_frames == len(sent) and len(taken) + source.n_dropped == len(sent)


def test_a_lost_source_is_opened_again_soon(monkeypatch, caplog):
    """Within two seconds in the first minute, later within 30."""
    now, pauses, opened = [100.0], [], []
    monkeypatch.setattr(live_source.time, "monotonic", lambda: now[0])

    def shots():
        opened.append(now[0])
        if len(opened) == 40:
            yield shot(9)
            return
        raise Unreadable("the source was lost")

    def wait(pause_s):
        pauses.append(pause_s)
        now[0] += pause_s
        if len(pauses) == 45:
            source._stop.set()

    source = source_of(shots, tries_again=True)
    monkeypatch.setattr(source._stop, "wait", wait)
    source._read()
    assert pauses[:4] == [0.5, 1.0, 2.0, 2.0]
    n_soon = np.searchsorted(np.cumsum(pauses[:39]), 60.0) + 1
    assert set(pauses[2:n_soon]) == {2.0} and set(pauses[n_soon:39]) == {30.0}
    assert pauses[39:41] == [0.5, 1.0]  # an image that comes begins anew
    # Each outage is told once.
    assert caplog.messages[0] == "camera: the source was lost; trying again"
    assert len(caplog.messages) == 3 and "has ended" in caplog.messages[1]


def test_a_shortage_of_threads_is_one_line(monkeypatch):
    def start(_):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", start)
    result = call("-", "--input-size", "8x8", "--jsonl")
    assert result.exit_code == 1 and "no more threads" in result.stderr


@pytest.mark.parametrize("again", [{}, AGAIN])
def test_a_source_that_cannot_be_opened_is_an_error(again):
    def shots():
        raise Unreadable("it is not there")
        yield

    with source_of(shots, **again) as source, pytest.raises(SourceError, match="it is not there"):
        source.take(SOON_S)


def test_a_camera_that_is_unplugged_is_opened_again(monkeypatch, tmp_path, caplog):
    """Its device goes with it; one that never was there is an error."""
    monkeypatch.setattr(live_source, "FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr(live_source, "is_camera", lambda source: True)
    device = tmp_path / "video0"
    shots = partial(live_source.shots_of_capture, str(device), None)
    with source_of(shots, **AGAIN) as source, pytest.raises(SourceError, match="no such camera"):
        source.take(SOON_S)
    device.touch()
    captures = [FakeCapture(1), FakeCapture(2, breaks=True), FakeCapture(1)]

    def opened(_):
        if len(captures) < 3:
            device.unlink(missing_ok=True)
        return captures.pop(0)

    monkeypatch.setattr(live_source.cv2, "VideoCapture", opened)
    with source_of(shots, **AGAIN) as source:
        until(lambda: source.n_frames == 2)
        until(lambda: "no such camera" in caplog.text)
        assert source.is_lost
        device.touch()
        until(lambda: source.n_frames == 3)
    assert "the source was lost" in caplog.text and "cannot be decoded" in caplog.text


class FakeCapture:
    """Sends some images; at the last one, OpenCV fails."""

    def __init__(self, n_pictures, breaks=False):
        self._left, self._breaks = n_pictures, breaks

    def isOpened(self):  # noqa: N802
        return True

    def set(self, *_): ...
    def get(self, *_):
        return 0.0

    def release(self): ...

    def grab(self):
        self._left -= 1
        return self._left >= 0

    def retrieve(self, image):
        if self._breaks and self._left == 0:
            raise cv2.error("a damaged image")
        return True, np.zeros((30, 40, 3), np.uint8)


@pytest.mark.parametrize(("n_undecoded", "is_opened"), [(30, True), (10**9, False)])
def test_a_stream_may_begin_long_before_a_key_frame(monkeypatch, clock, n_undecoded, is_opened):
    """What comes before it cannot be decoded; that is no reason to open the stream again, soon."""
    capture, left = FakeCapture(2), [n_undecoded]

    def grab(own_grab=capture.grab):
        clock.now += 0.3
        left[0] -= 1
        return left[0] < 0 and own_grab()

    monkeypatch.setattr(capture, "grab", grab, raising=False)
    monkeypatch.setattr(live_source.cv2, "VideoCapture", lambda *_: capture)
    shots = live_source.shots_of_capture("udp://127.0.0.1:5000", None)
    if is_opened:
        assert [next(shots).image.shape for _ in range(2)] == [(30, 40, 3)] * 2
        assert 9.0 < clock.now - 100.0 < 12.0
    with pytest.raises(Unreadable, match="the source was lost"):  # and later, at once
        next(shots)
    assert clock.now - 100.0 < 12.7


def test_frames_keep_their_size_when_the_pictures_change(caplog):
    pictures = [np.full(shape, 20, np.uint8) for shape in ((60, 80), (90, 50))]
    with played(pictures, InputOptions(scale=0.5)) as source:
        frames = [source.take(SOON_S) for _ in pictures]
    assert all(one.grey.shape == (30, 40) and one.grey[0, 0] == 20 for one in frames)
    assert source.picture_wh == (80, 60) and source.size_wh == (40, 30)
    assert caplog.messages == ["camera: its frames are 50x90 now, and are scaled"]


def test_crop_and_mask(tmp_path, caplog):
    mask = np.full((20, 20), 255, np.uint8)
    mask[:10] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    picture = np.zeros((60, 80), np.uint8)
    picture[30:50, 10:30] = 200
    options = InputOptions(crop="20x20+10+30", mask=tmp_path / "mask.png")
    with played([picture], options) as source:
        assert (source.take(SOON_S).grey == 200).all() and source.size_wh == (20, 20)
        hidden, _ = source.hidden()
        assert hidden.sum() == 200 and hidden[:10].all()
    alarm = alarm_of()
    answered(played([picture], options), alarm)
    assert alarm.model.n_cells == 200
    with played([picture, picture[:40]], options, tries_again=True) as source:
        source.take(SOON_S)
        source.take(SOON_S)
        until(lambda: "reaches outside" in caplog.text)  # and it is not the end
        assert "trying again" in caplog.text and not source.is_over
    with (
        played([picture], InputOptions(crop="20x20+70+30")) as source,
        pytest.raises(SourceError, match="reaches outside its frames of 80x60"),
    ):
        source.take(SOON_S)


@pytest.mark.parametrize(("crop", "is_told"), [("40x60+0+0", True), ("60x60+0+0", False)])
def test_one_image_of_a_stereo_pair_is_told(crop, is_told, caplog):
    picture = np.full((60, 80), 20, np.uint8)
    answered(played([picture], InputOptions(crop=crop)), alarm_of("flight"))
    assert ("lies beside the middle of the image" in caplog.text) == is_told


@pytest.mark.parametrize("is_wanted", [False, True])
def test_pictures_come_only_when_they_are_wanted(is_wanted):
    source = played([np.full((360, 1280, 3), (10, 20, 30), np.uint8)])
    source.wants_pictures = is_wanted
    with source:
        picture = source.take(SOON_S).picture
    assert (picture is not None) == is_wanted
    assert not is_wanted or (picture.shape == (180, 640, 3) and (picture == (10, 20, 30)).all())


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


@pytest.mark.parametrize("stall_s", [0.25, 0.9, 5.0])
def test_what_arrives_late_after_a_stall_is_not_left_out(stall_s):
    """A receiver hands on what was held up all at once; the source is no faster for it."""
    pace, sent = Pace(30.0), np.arange(600) / 30
    held = (sent > 5.0) & (sent < 5.0 + stall_s)
    came = np.where(held, 5.0 + stall_s + 0.002 * np.cumsum(held), sent)
    assert all(pace.is_due(t) for t in np.maximum.accumulate(came))
    assert pace.fps == pytest.approx(30)


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


@pytest.mark.parametrize("pixel_format", live_source.PIXEL_FORMATS)
def test_raw_frames(pixel_format, caplog):
    read_end, write_end = os.pipe()
    with os.fdopen(read_end, "rb") as pipe, os.fdopen(write_end, "wb") as writer:
        writer.write(3 * raw(pixel_format) + b"rest")
        writer.close()
        shots = live_source.shots_of_pipe(pipe, (32, 24), pixel_format)
        greys = [to_grey(one.image, (32, 24), one.levels) for one in shots]
    assert len(greys) == 3 and "ended within a frame, after 4 of" in caplog.text
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
    shots = live_source.shots_of_pipe(io.BytesIO(bytes(41 * 31 * 3)), size, pixel_format)
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
        image, _ = live_source.unpacked(pixel.ravel(), (1, 1), pixel_format)
        levels[pixel_format] = int(to_grey(image, (1, 1))[0, 0])
    assert levels == {"bgr24": 29, "rgb24": 76}  # BT.601: 0.114 and 0.299


@pytest.fixture
def clock(monkeypatch):
    """A clock of the live sources that only `sleep`, or the test, moves on."""
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(live_source.time, "monotonic", lambda: clock.now)
    monkeypatch.setattr(live_source.time, "sleep", lambda s: setattr(clock, "now", clock.now + s))
    return clock


def test_a_file_plays_at_its_own_pace_and_is_closed(tmp_path, monkeypatch, clock):
    closed = []
    monkeypatch.setattr(Video, "close", lambda video: closed.append(video))
    write_video(tmp_path / "a.avi", looming_frames(6), fps=20.0)
    shots = live_source.shots_at_their_pace(
        lambda: open_input(tmp_path / "a.avi", InputOptions(repeats="keep"))
    )
    for number, one in enumerate(shots):
        assert one.index == number and one.time_s == pytest.approx(number / 20)
        if number == 0:
            clock.now += 0.3  # while the model is prepared
            begin = clock.now
        else:
            assert clock.now == pytest.approx(begin + number / 20)
            clock.now += 0.01  # what the model takes
    assert len(closed) == 1


def test_a_file_that_decodes_too_slowly_plays_slower(clock, caplog):
    def pictures():
        for number in range(40):
            clock.now += 0.1  # to decode what lasts 0.05 s
            yield Picture(number, 0.05 * number, GREY, is_repeat=False, after_gap=False)

    @contextmanager
    def video():
        path = SimpleNamespace(path="a.mp4", levels=FULL)
        yield SimpleNamespace(pictures=pictures, info=path, region=None)

    shots = list(live_source.shots_at_their_pace(video))
    lateness = [100.1 + 0.1 * number - one.captured_s for number, one in enumerate(shots)]
    assert 0.2 < max(lateness) <= live_source.MAX_LATE_S + 1e-9
    assert len(caplog.messages) == 1 and "plays slower" in caplog.text


def test_a_file_that_loops_goes_on_after_a_gap(tmp_path, clock):
    frames = looming_frames(5, width=64, height=48)
    write_video(tmp_path / "a.avi", frames, fps=25.0)
    video = open_input(tmp_path / "a.avi", InputOptions(repeats="keep"))
    shots = list(islice(live_source.shots_at_their_pace(lambda: video, loops=True), 10))
    video.close()
    assert [one.index for one in shots] == list(range(10))
    lap_s = 4 / 25 + live_source.SEAM_S
    times = [number // 5 * lap_s + number % 5 / 25 for number in range(10)]
    assert [one.time_s for one in shots] == pytest.approx(times)
    # In true time, too; and what the model then sees is what it saw at first.
    assert shots[-1].captured_s - shots[0].captured_s == pytest.approx(times[-1])
    alarm = Alarm(load_set(9), resize=False, repeats="keep")
    found = [alarm.step(to_grey(one.image, (64, 48)), one.time_s).mp for one in shots]
    np.testing.assert_array_equal(found[5:10], found[:5])


@pytest.mark.parametrize(
    ("source", "shown"),
    [
        ("rtsp://me:secret@host/a@b", "rtsp://host/a@b"),
        ("rtsp://me:s@secret@host/x", "rtsp://host/x"),
        ("rtsp://host/a@b", "rtsp://host/a@b"),
        ("rtsp://host/p?user=a&password=secret&ch=1", "rtsp://host/p?user=a&password=***&ch=1"),
        ("http://host/p?API_Key=secret#x", "http://host/p?API_Key=***#x"),
        ("rtsp://host/user=a_pwd=secret_ch=1/x", "rtsp://host/user=a_pwd=***/x"),
        ("http://host/v?fps=30&size=1", "http://host/v?fps=30&size=1"),
    ],
)
def test_passwords_are_not_shown(source, shown):
    assert without_password(source) == shown
    with pytest.raises(ParameterError) as caught:
        open_video(source)
    assert "secret" not in str(caught.value)
    for wrong in (source.replace("rtsp", "gopher"), source.replace("://", ":/")):
        with pytest.raises(ParameterError) as caught:
            live_source.check_source(wrong, is_realtime=False, has_size=True)
        assert "secret" not in str(caught.value) or ":/me" in wrong


# Answers.


def answer(alarm=False, *, index=0, event="", time_s=0.0, level=0.5, reason=""):
    """An answer of an alarm that saw nothing, changed."""
    found = Detection(frame=index, time_s=time_s, mp=1.0, mp_abs=level, alarm=alarm)
    frame = Frame(index, time_s, np.zeros((9, 9)))
    return Answer(frame, found, event=event, latency_ms=1.5, reason=reason)


def test_events_are_the_onsets_of_a_result():
    rng = np.random.default_rng(5)
    for number in range(50):
        on = np.repeat(rng.random(40) < 0.4, rng.integers(1, 6, 40))
        time_s, rule = np.arange(len(on)) / 25, ("spikes", "ttc")[number % 2]
        events, told = Events(rule_of(load_set(9, alarm=rule))), []
        for row, flag in enumerate(on):
            found = Detection(
                frame=row, time_s=time_s[row], mp_abs=float(row), signal=-row, alarm=bool(flag)
            )
            told += [(row, event, span) for event, span in events.step(found)]
        last = events.over()
        alarms = [span for _, event, span in told if event == "end"] + [last] * (last is not None)
        assert [(a.start_frame, a.end_frame) for a in alarms] == [*map(tuple, spans(on, time_s))]
        assert all(one.peak_mp_abs == one.end_frame for one in alarms)
        peak = "end_frame" if rule == "ttc" else "start_frame"
        assert all(one.peak_signal == -getattr(one, peak) for one in alarms)
        begins = [(row, span.start_frame) for row, event, span in told if event == "begin"]
        assert begins == [(one.start_frame,) * 2 for one in alarms]
        for row, event, span in told:
            assert event == "begin" or 0.3 <= time_s[row] - span.end_s < 0.3 + 0.041


class EverySecond(dlgmd_cli.Rule):
    """A rule whose alarm is on at every second frame."""

    def value(self, row):
        return row.frame % 2


def test_an_end_comes_before_the_begin_at_the_same_frame():
    found, _ = answered(played(PAN[:8], fps=5.0, model_fps=5.0), Alarm(alarm=EverySecond))
    told = [(one.event, one.is_of_frame) for one in found if one.event in ("begin", "end")]
    assert told == [("begin", True), ("end", False)] * 4


def test_answers_are_those_of_the_alarm():
    frames = looming_frames(n_frames=30, width=64, height=48)
    expected = Alarm(load_set(3))
    began_s = time.time()
    found, _ = answered(played(frames), alarm_of(3))
    found = [one for one in found if one.event != "blind"]  # little moves at first
    assert len(found) == 31 and found[-2].detection.alarm
    for number, (one, frame) in enumerate(zip(found, frames, strict=False)):
        wanted = expected.step(frame, one.frame.time_s)
        assert one.frame.index == number and one.frame.time_s == pytest.approx(number / 30)
        np.testing.assert_equal(vars(one.detection), vars(wanted))
    *found, last = found
    assert [one.event for one in found if one.event] == ["begin"]
    # The alarm is on when the source is over: its end is told.
    assert (last.event, last.detection.alarm, last.is_of_frame) == ("end", False, False)
    facts = json.loads(found[-1].to_json())
    assert facts.pop("reason") == "frozen"
    assert (facts.pop("event"), facts.pop("side")) == ("begin", "ahead")
    end = json.loads(last.to_json())
    assert (end["side"], end["duration_s"]) == ("ahead", 0.0)
    assert end["peak_mp_abs"] == facts["mp_abs"]
    columns = {*csv.headers()["mp.csv"]} - {"mp_seq"}
    assert {*facts} == columns | {"spike", "rule", "utc", "latency_ms"}
    assert facts["frame"] == 29 and facts["alarm"] is True and abs(facts["g_x"]) < 0.1
    assert json.loads(found[0].to_json())["mp"] is None  # and not NaN
    # When the frame came: so long before the answer.
    answered_s = [one.utc_s + one.latency_ms / 1e3 for one in found] + [last.utc_s, time.time()]
    assert began_s < answered_s[0] and answered_s == sorted(answered_s)
    assert facts["utc"] == utc_text(found[-1].utc_s)


def test_the_threshold_follows_the_speed_that_is_reported():
    frames, reports = looming_frames(n_frames=40, width=240, height=136), Reports()
    speeds, told = iter([math.nan] * 20 + [3.0] * 99), []

    def params_at(speed_m_s):
        reports.speed_m_s = next(speeds)
        told.append(speed_m_s)
        alarms = 10.0 if math.isnan(speed_m_s) else 0.1
        return changed(alarm.params, expansion_alarm=alarms)

    alarm = alarm_of("flight")
    found = [
        one
        for one in answered(played(frames), alarm, reports=reports, params_at=params_at)[0]
        if one.is_of_frame
    ]
    assert [one.threshold["expansion_alarm"] for one in found] == [10.0] * 21 + [0.1] * 19
    assert not any(one.detection.alarm for one in found[:21])
    assert all(one.detection.alarm for one in found[21:] if one.detection.expansion > 0.1)
    assert json.loads(found[-1].to_json())["expansion_alarm"] == 0.1


def test_a_threshold_that_fails_ends_no_watch(caplog):
    """It stays as it was, and that is told once."""
    frames = looming_frames(n_frames=20, width=240, height=136)

    def params_at(speed_m_s):
        raise ZeroDivisionError("no time")

    found, _ = answered(played(frames), alarm_of("flight"), params_at=params_at)
    assert len([one for one in found if one.is_of_frame]) == len(frames)
    assert [text for text in caplog.messages if "threshold" in text] == [
        f"no threshold at nan m/s (no time); it stays {choose('flight').params.expansion_alarm:g}"
    ]


def test_an_event_is_no_repeat():
    assert answer(event="blind").to_dict()["repeat"] is False


def test_utc_is_iso_8601():
    assert utc_text(1_777_627_800.125) == "2026-05-01T09:30:00.125Z"


TEXTURE = cv2.resize(
    np.random.default_rng(3).integers(0, 255, (8, 60), np.uint8), (480, 60), interpolation=1
)
PAN = np.stack([TEXTURE[:, 2 * n : 2 * n + 80] for n in range(90)])
BLACK, STILL = np.zeros_like(PAN), np.repeat(PAN[:1], 90, axis=0)
# A plain wall below a moving frieze.
WALL = np.where(np.arange(60)[:, None] < 12, PAN, 120).astype(np.uint8)
FOG = np.random.default_rng(4).integers(126, 131, PAN.shape, np.uint8)


@pytest.mark.parametrize(
    ("pictures", "reason", "events"),
    [
        ([*PAN[:45], *BLACK[:45], *PAN[:45]], "black", ["blind", "sees"]),
        ([*PAN[:45], *STILL[:45], *PAN[:45]], "frozen", ["blind", "sees"]),
        ([*PAN[:45], *FOG[:45], *PAN[:45]], "flat", ["blind", "sees"]),
        ([*PAN[:30], *BLACK[:15], *PAN[:30], *STILL[:15], *PAN[:30]], "", []),
        (BLACK[:45], "black", ["blind"]),
        ([*PAN[:45], *WALL[:45], *PAN[:45]], "unmeasured", ["blind", "sees"]),
    ],
)
def test_pictures_that_show_nothing_are_events(pictures, reason, events, caplog):
    found, sight = answered(played(pictures, model_fps=30.0))
    told = [one for one in found if one.event in ("blind", "sees")]
    assert [one.event for one in told] == events and len(caplog.messages) == len(events)
    if events:
        begin = 0 if len(pictures) == 45 else 45
        assert (told[0].reason, told[0].to_dict()["reason"]) == (reason, reason)
        assert 0.0 < told[0].frame.time_s - begin / 30 < 1.0
        assert BLIND_WORDS[reason] in caplog.text and "latency_ms" in told[0].to_dict()
        for key in ("time_s", "utc"):  # events are in the order of their times, with the frames
            times = [one.to_dict()[key] for one in found]
            assert times == sorted(times)
        reasons = [one.reason for one in found if one.is_of_frame]
        assert reasons[begin + 30] == reason and reasons[begin] == ""
        assert len(events) == 1 or reasons[-1] == ""
        (line,) = sight.warnings()
        assert line.startswith("blind 1 time, ") and BLIND_WORDS[reason] in line


def test_what_shows_nothing_has_done_so_since_before_it_is_told():
    source = played(PAN)
    with source:
        assert source.take(SOON_S) is not None
        sight, earliest_s = SourceState(source), time.monotonic() - BLIND_S
        assert sight.step(Detection(blind="black")) == "blind"
        assert earliest_s <= sight.since_s <= time.monotonic() - BLIND_S


@pytest.mark.parametrize(
    ("model", "fps", "every", "is_told"),
    [
        ("flight", 6.0, 1, True),
        ("flight", 12.0, 2, True),
        ("flight", 7.5, 1, False),
        (9, 6.0, 1, False),
    ],
)
def test_frames_too_slow_for_the_expansion_are_told_once(model, fps, every, is_told):
    """As `run` tells it, whatever rate the parameters are made for; duplicates do not count."""
    pictures = np.repeat(PAN, every, axis=0)
    alarm = Alarm(choose(model).params, model_fps=fps)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        answered(played(pictures, fps=fps, model_fps=fps), alarm)
    told = [str(one.message) for one in caught]
    why = "6 frames/s: expansion rates are unreliable below 7.5 frames/s"
    assert len(told) == is_told and all(line.startswith(why) for line in told)


def test_a_silent_source_is_lost(caplog):
    """An alarm that is on ends; both are told once, and that the source is back."""
    frames, go_on = looming_frames(n_frames=30, width=64, height=48), threading.Event()

    def shots():
        began_s = time.monotonic()  # at even times, however busy the machine is
        for number, frame in enumerate(frames):
            time.sleep(0.012)
            yield Shot(frame, FULL, began_s + 0.012 * number)
        assert go_on.wait(SOON_S)
        for picture in PAN[:2]:  # as a buffer has them
            yield Shot(picture, FULL, time.monotonic())
        time.sleep(0.4)
        for number in range(500):
            if len(events) == 4:
                break
            picture = PAN[number % len(PAN)]
            yield Shot(picture, FULL, time.monotonic())
            time.sleep(0.03)

    source, events, told = source_of(shots, drops=False), [], []
    watching = Watch(source, alarm_of(3), SourceState(source))
    watching.load.fps = 30.0  # which would count the silence
    with source:
        for one in watching.answers():
            if one is not None and one.event:
                events.append((one.event, one.reason, time.monotonic() - source.heard_s))
                told.append(one)
            if len(events) == 3:
                go_on.set()
    assert [event for event, *_ in events] == ["begin", "end", "blind", "sees"]
    assert events[2][1] == "lost" and events[2][2] >= watch.SILENT_S and events[3][1] == ""
    assert watch.SILENT_S < 1.0 and math.isnan(watching.load.fps)
    # On a busy machine, a line about bursts may come before.
    lines = [line for line in caplog.messages if "blind" in line or "recovered" in line]
    assert "blind, no frame for" in lines[0] and "recovered" in lines[-1] and len(lines) == 2


def test_a_source_without_a_sender_is_lost_before_anything_comes():
    """As ``udp://``, whose opening blocks until then."""
    go_on = threading.Event()

    def shots():
        assert go_on.wait(SOON_S)
        yield Shot(PAN[0], None, time.monotonic())

    source = source_of(shots)
    watching = Watch(source, alarm_of(3), SourceState(source))
    with source:
        found = next(one for one in watching.answers() if one is not None)
        go_on.set()
    assert (found.event, found.reason) == ("blind", "lost")


def test_a_source_that_cannot_be_opened_yet_is_blind(monkeypatch):
    monkeypatch.setattr(live_source, "FIRST_PAUSE_S", 0.3)
    monkeypatch.setattr(watch, "SOUND_S", 0.2)
    n_opened = []

    def shots():
        n_opened.append(1)
        if len(n_opened) == 1:
            raise Unreadable("the stream cannot be opened")
        while not source.is_over:
            for picture in PAN:
                yield Shot(picture, FULL, time.monotonic())
                time.sleep(0.03)

    events, source = [], source_of(shots, tries_again=True)
    sight = SourceState(source)
    with source:
        for one in Watch(source, alarm_of("flight"), sight).answers():
            if one is not None:
                events.append((one.event, one.reason, one.to_dict()["frame"]))
                assert one.to_dict()["rule"] == "expansion"
                if one.event == "sees" or len(events) > 999:
                    break
    assert events[0] == ("blind", "lost", None) and len(events) > 5
    assert all(one[:2] == ("", "lost") for one in events[1:-1])
    assert events[-1][:2] == ("sees", "")
    (line,) = sight.warnings()
    assert line.startswith("blind 1 time, ") and "lost" in line


def test_statistics():
    statistics = Statistics()
    assert all(map(math.isnan, (*statistics.latency_ms(), statistics.fps)))
    for number in range(1000):
        one = replace(answer(event="begin" if number == 7 else ""), latency_ms=number + 1)
        statistics.put(one)
    assert statistics.n_frames == 1000 and statistics.n_alarms == 1
    assert statistics.latency_ms() == pytest.approx((500.5, 990.01))
    assert statistics.latency_ms(lately=True) == pytest.approx((850.5, 997.01))


def test_what_receivers_report_is_an_event():
    """Told with the next frame, and before its answer; between frames, soon."""
    frames, reports = looming_frames(n_frames=20, width=64, height=48), Reports()

    def shots():
        for frame in frames:
            yield Shot(frame, FULL, time.monotonic())
        until(lambda: told, SOON_S)
        reports.append(("output-lost", {"output": "jsonl"}))
        until(lambda: len(told) == 2, SOON_S)

    source, told, since = source_of(shots, drops=False), [], []
    with source:
        for one in Watch(source, alarm_of(3), SourceState(source), reports=reports).answers():
            since += [] if one is None else [one.to_dict()["time_s"]]
            if one is not None and one.is_of_frame and one.frame.index == 5:
                reports.append(("sent", {"mode": "BRAKE"}))
            if one is not None and one.event in ("sent", "output-lost"):
                told.append((one.to_dict(), one.is_of_frame))
    (sent, is_frame), (lost, _) = told
    assert sent["event"] == "sent" and sent["mode"] == "BRAKE" and not is_frame
    assert lost["output"] == "jsonl" and sent["frame"] > 5 and since == sorted(since)


def test_the_windows_follow_a_heading():
    frames, expansions = looming_frames(n_frames=20, width=64, height=48), []
    for motion in (None, (2.0, 0.5, 0.0)):
        reports = Reports()
        reports.motion = motion
        source, alarm = played(frames, model_fps=30.0), alarm_of(3)
        found, sight = answered(source, alarm, reports=reports, heading=Heading(reports))
        (told,) = [one.to_dict() for one in found if one.event == "heading"]
        assert told["by"] == ("default" if motion is None else "autopilot")
        assert not sight.warnings()  # it is no fault
        expansions.append([one.detection.expansion for one in found if one.is_of_frame][-1])
    assert told["right_deg"] == 14.0 and expansions[0] != expansions[1]


# Outputs.


def test_a_reader_that_goes_is_told_once(monkeypatch, caplog):
    class Broken:
        n_written = 0

        def write(self, data):
            self.n_written += 1
            raise BrokenPipeError

    monkeypatch.setattr(sys, "stdout", SimpleNamespace(buffer=Broken()))
    reports = Reports()
    deliver = outputs.lines_on_stdout(reports)
    for _ in range(3):
        deliver(answer())
    assert [*reports] == [("output-lost", {"output": "jsonl"})]
    assert len(caplog.messages) == 1 and sys.stdout.buffer.n_written == 1
    monkeypatch.setattr(sys, "stdout", None)  # closed before the start
    outputs.lines_on_stdout(reports)(answer())
    assert len(reports) == 2


def test_a_receiver_that_hangs_delays_nothing(monkeypatch, caplog):
    release, got = threading.Event(), []

    def deliver(one):
        release.wait(SOON_S)
        got.append(one.frame.index)

    output = outputs.Receiver("udp", deliver)
    for number in range(500):
        output.put(answer(index=number, event="begin" if number == 3 else ""))
    assert got == []  # no `put` has waited for the receiver
    monkeypatch.setattr(outputs, "PATIENCE_S", 0.05)
    outputs.finish([output])
    assert caplog.messages == [
        "udp: the receiver is too slow; answers are dropped",
        "udp: the receiver did not take everything in time",
    ]
    release.set()
    until(lambda: got and got[-1] == 499, SOON_S)
    assert len(got) <= outputs.MAX_WAITING + 1
    assert 3 in got  # no event is lost


def test_a_receiver_that_fails_is_told_once_and_tried_again(caplog):
    got = []

    def deliver(one):
        got.append(one.frame.index)
        raise OSError("the cable is out")

    output = outputs.Receiver("mavlink", deliver)
    for number in range(5):
        output.put(answer(index=number))
    until(lambda: len(got) == 5)
    output.close()
    assert caplog.messages == ["mavlink: the cable is out"] and got == [0, 1, 2, 3, 4]


def test_only_events():
    got = []
    output = outputs.Receiver("--exec", got.append, only_events=True)
    for event in ("", "begin", "", "end"):
        output.put(answer(event=event))
    until(lambda: len(got) == 2)
    output.close()
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
        send, places = outputs.Datagrams(address), set()
        for _ in range(3):
            send(answer(True, index=7, event="begin"))
            data, place = receiver.recvfrom(4096)
            places.add(place)
        send.close()
    facts = json.loads(data)
    assert len(places) == 1 and data.endswith(b"}\n")  # from one socket
    assert facts["frame"] == 7 and facts["event"] == "begin" and facts["alarm"] is True


@pytest.mark.parametrize(
    ("make", "given", "why"),
    [
        *(
            (outputs.Datagrams, text, "is not HOST:PORT")
            for text in ("", "host", "host:", ":5", "host:0", "host:70000", "host:x")
        ),
        (outputs.Datagrams, "no-such-host.invalid:5005", "cannot be found"),
        (outputs.Datagrams, "a..b:5005", "cannot be found"),
        (outputs.Programs, "no-such-program x", "no program"),
        (outputs.Programs, "'a", "quot"),
    ],
)
def test_receivers_that_are_not_there(make, given, why):
    with pytest.raises(ParameterError, match=why):
        make(given)


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("8000", ("127.0.0.1", 8000)),
        ("0.0.0.0:80", ("0.0.0.0", 80)),
        ("::1", ("::1", 0)),
        ("[::1]", ("::1", 0)),
        ("[::1]:8123", ("::1", 8123)),
    ],
)
def test_addresses_to_listen_at(text, address):
    assert outputs.split_address(text, "--serve", "127.0.0.1") == address


def wait_for(*started):
    for one in started:
        for process in one.running:
            process.kill()
            process.wait()


def test_a_program_gets_the_event_in_its_environment(tmp_path, caplog):
    script = "import os, sys; open(sys.argv[1], 'w').write(repr(sorted(os.environ.items())))"
    command = f"{sys.executable} -c \"{script}\" '{tmp_path}/$HOME; x'"
    start = outputs.Programs(command)
    start(answer(True, index=7, event="begin"))
    file = tmp_path / "$HOME; x"  # no shell has looked at it
    until(lambda: file.exists() and file.read_text())
    found = dict(eval(file.read_text()))
    assert (found["DLGMD_EVENT"], found["DLGMD_FRAME"]) == ("begin", "7")
    wait_for(start)
    assert found["DLGMD_ALARM"] == "true" and found["DLGMD_G_X"] == "" and not caplog.messages


def test_programs_that_hang_or_fail(caplog):
    start = outputs.Programs(f"{sys.executable} -c 'raise SystemExit(3)'")
    start(answer())
    start.running[0].wait()
    start(answer())
    assert caplog.messages[0] == "exec: the program ended with exit code 3"
    hanging = outputs.Programs("sleep 30")
    for _ in range(outputs.MAX_RUNNING):
        hanging(answer())
    with pytest.raises(RuntimeError, match="no more are started"):
        hanging(answer())
    wait_for(start, hanging)


# Recordings.


@contextmanager
def recording_of(source, folder, model=3, options=None, watched=None, **how):
    """What records a source, and the watch whose answers it takes."""
    setup, sight = choose(model), SourceState(source)
    alarm = alarm_of(setup)
    given = source, setup, options or InputOptions(), alarm.model, sight, folder
    with Recording(*given, **how) as recording, source:
        yield recording, Watch(source, alarm, sight, **watched or {})


def recorded(frames, folder, model=3, fps=30.0):
    """Record every answer to frames; yields the recording after each."""
    source = played(frames, fps=fps, model_fps=fps)
    with recording_of(source, folder, model) as (recording, watch):
        for one in filter(None, watch.answers()):
            recording.put(one)
            if one.is_of_frame:
                yield recording


def test_a_recording_with_headings_repeats(tmp_path):
    """The motion is a table of frames: the attitude where it alone was known, nothing without."""
    frames, reports = looming_frames(n_frames=16, width=64, height=48), Reports()
    attitude = reports.attitude = Attitude((0.0, 0.02, 0.5), (0.0, 0.0, 0.1), time.monotonic())
    source, watched = played(frames, model_fps=30.0), {"reports": reports}
    watched["heading"] = Heading(reports)
    with recording_of(source, tmp_path / "r", watched=watched) as (recording, watch):
        for one in filter(None, watch.answers()):
            recording.put(one)
            if one.is_of_frame:
                side = (one.frame.index % 5) / 10.0
                is_known = not 10 <= one.frame.index < 13
                reports.motion = (2.0, side, 0.0) if is_known else None
                reports.attitude = None if one.frame.index == 12 else attitude
    text = (tmp_path / "r" / "heading.csv").read_text()
    assert "\n12,,,,0.0,1.1" in text and "\n13,,,,,,\n" in text
    np.save(tmp_path / "frames.npy", frames)
    first = read_result(tmp_path / "r")
    again = run(tmp_path / "frames.npy", tmp_path / "r" / "run.yaml", input_fps=30)
    np.testing.assert_allclose(again.expansion, first.expansion, rtol=1e-6)
    np.testing.assert_allclose(again.corridor, first.corridor, rtol=1e-6)
    assert np.isfinite(first.corridor[[8, 15]]).tolist() == [True, False]
    assert len(np.unique(first.expansion_x[1:])) > 3
    (tmp_path / "r" / "heading.csv").write_text("frame,right_deg,up_deg\n0,0,0\n")
    with pytest.warns(DlgmdWarning, match="heading.csv has changed since"):
        choose(tmp_path / "r" / "run.yaml")


def test_a_recording_is_a_result_at_every_moment(tmp_path):
    frames = looming_frames(n_frames=40, width=64, height=48)
    frames[10:10] = [frames[9]]  # a repeat, whose row is a copy
    for number, _ in enumerate(recorded(frames, tmp_path / "r")):
        result = read_result(tmp_path / "r")
        assert len(result) == number + 1 and not result.record["complete"]
        assert result.is_repeat[-1] == (number == 10)
    result = read_result(tmp_path / "r")
    assert result.record["complete"] and result.is_repeat[10] and result.frame[10] == 10
    (warning,) = result.warnings
    assert warning.startswith("blind 1 time, ") and "frozen" in warning  # little moves at first
    assert result.alarms.any()
    stored = yaml_of(tmp_path / "r/run.yaml")["summary"]
    assert stored.pop("first_alarm_side") == result.summary.pop("first_alarm_side") == "ahead"
    assert stored.pop("rule") == result.summary.pop("rule") == "spikes"
    known = {key: value for key, value in result.summary.items() if value is not None}
    # Pooled, the digits of the table are summed over its rows.
    assert {key: stored[key] for key in known} == pytest.approx(known, rel=1e-7)
    assert stored.keys() == result.summary.keys()
    assert set(os.listdir(tmp_path / "r")) == names_of("run.yaml", ())
    written = (tmp_path / "r/alarms.csv").read_text()
    result.save(tmp_path / "again")
    assert (tmp_path / "again/alarms.csv").read_text() == written and written.count("\n") == 2


def test_a_mask_is_reduced_as_the_images_of_the_camera_are(tmp_path):
    """A wide camera's images are reduced less than those of the usual one."""
    frames, path = looming_frames(12, 240, 136), tmp_path / "mask.png"
    mask = np.full((136, 240), 255, np.uint8)
    mask[:, :60] = 0
    cv2.imwrite(str(path), mask)
    options = InputOptions(mask=str(path), fov=110.0)
    found, _ = answered(played(frames, options, model_fps=30.0), alarm_of("flight"))
    again = run(np.stack(frames), "flight", mask=path, fov=110.0, input_fps=30.0)
    rates = [one.detection.expansion for one in found if one.is_of_frame]
    np.testing.assert_allclose(rates, again.expansion, rtol=1e-6)
    assert np.isfinite(rates[2:]).all()


@pytest.mark.parametrize(
    ("side", "told"),
    [(48, ["6 frames/s: expansion rates are unreliable"]), (16, ["6 frames/s", "too small"])],
)
def test_a_recording_has_the_doubts_of_a_run(tmp_path, side, told):
    frames = PAN[:30, :side, :64]
    list(recorded([*frames], tmp_path / "r", "flight", 6.0))
    warnings = [line for line in read_result(tmp_path / "r").warnings if "blind" not in line]
    assert len(warnings) == len(told)
    assert all(part in line for part, line in zip(told, warnings, strict=True))
    with pytest.warns(DlgmdWarning):
        again = run(frames, "flight", input_fps=6.0)
    assert {*warnings} <= {*again.warnings}


@pytest.mark.parametrize("most", [5, 19, 20])
def test_a_long_recording_is_whole_but_for_what_needs_all_of_it(tmp_path, monkeypatch, most):
    monkeypatch.setattr("dlgmd_cli.watch.recording.MAX_HELD", most)
    assert len(list(recorded(looming_frames(20, 64, 48), tmp_path / "r"))) == 20
    columns = np.genfromtxt(tmp_path / "r/mp.csv", delimiter=",", names=True)
    assert len(columns) == 20 and np.isnan(columns["mp_seq"]).all() == (most < 20)
    result = read_result(tmp_path / "r")
    assert result.record["complete"] and result.summary["mp_max_frame"] == 19


def test_a_recording_that_ends_by_an_exception_is_not_complete(tmp_path):
    answered = recorded(looming_frames(n_frames=10, width=64, height=48), tmp_path / "r")
    for _ in range(5):
        next(answered)
    with pytest.raises(ZeroDivisionError):
        answered.throw(ZeroDivisionError)
    result = read_result(tmp_path / "r")
    assert len(result) == 5 and not result.record["complete"]


def test_a_recording_that_a_signal_ends_is_not_complete(tmp_path, monkeypatch):
    for number, _ in enumerate(recorded(looming_frames(10, 64, 48), tmp_path / "r")):
        monkeypatch.setattr("dlgmd_cli.machine.cancel._requested", number == 4)
    result = read_result(tmp_path / "r")
    assert len(result) == 5 and result.record["complete"] is False
    assert yaml_of(tmp_path / "r/run.yaml")["summary"]["mp_max_frame"] == 4


def test_a_recording_that_cannot_be_written_ends_alone(tmp_path, monkeypatch, caplog):
    n_answers = 0
    for recording in recorded(looming_frames(20, 64, 48), tmp_path / "r"):
        n_answers += 1
        if n_answers == 10:
            monkeypatch.setattr(recording, "_write_rows", full)
    assert n_answers == 20 and recording.has_failed
    with open(tmp_path / "r/mp.csv", "a", encoding="ascii") as file:
        file.write("10,1,0,0,,,\n")  # as of a process that is killed between two files
    with open(tmp_path / "r/attenuation.csv", "a", encoding="ascii") as file:
        file.write("10,0.")  # as of a disk that is full within a row
    assert len(caplog.messages) == 1 and "No space left on device" in caplog.text
    result = read_result(tmp_path / "r")
    assert len(result) == 10 and not result.record["complete"]


def test_a_recording_without_rows_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(Recording, "_write_rows", full)
    assert len(list(recorded(looming_frames(5, 64, 48), tmp_path / "r"))) == 5
    assert os.listdir(tmp_path) == []


def test_the_last_seconds_are_recorded_at_an_alarm(tmp_path):
    """Each row with its image, up to the alarm's end; the next recording begins after it."""
    frames = [
        np.roll(frame, 7 * number, axis=1) if number < 20 else frame
        for number, frame in enumerate(looming_frames(30, 64, 48))
    ]
    frames += [*PAN[:25, :48, :64], *looming_frames(30, 64, 48), *PAN[:25, :48, :64]]
    source, setup = played(frames, model_fps=30.0), choose(3)
    source.keeps_pictures = True
    alarm, sight, seen = alarm_of(setup), SourceState(source), []

    given = source, setup, InputOptions(), alarm.model, sight
    last = LastSeconds(0.5, tmp_path, partial(Recording, *given))
    with source:
        for one in Watch(source, alarm, sight).answers():
            if one is not None:
                last(one)
                seen.append(one)
    last.close()
    ends = [one.span for one in seen if one.event == "end"]
    results = [read_result(tmp_path / f"alarm-{n}") for n in (1, 2)]
    assert len(ends) == 2 and not (tmp_path / "alarm-3").exists()
    for span, result in zip(ends, results, strict=True):
        assert result.record["complete"] and len(result.alarm_list) == 1
        assert 0.45 < span.start_s - result.time_s[0] <= 0.55
        assert span.end_frame < result.frame[-1] < span.end_frame + 15
        pictures = sorted((tmp_path / result.record["input"]["path"]).iterdir())
        assert len(pictures) == len(result)
        for picture, index in zip(pictures, result.frame, strict=True):
            shown = cv2.imread(str(picture))[..., 0].astype(float)
            assert np.abs(shown - frames[int(index)]).mean() < 6.0
    options = results[0].record["options"]
    with open_video(results[0].record["input"]["path"], input_fps=options["input_fps"]) as video:
        assert len(list(video)) == len(results[0])


# The command.


def call(*arguments, data=b""):
    from dlgmd_cli.commands.app import cli

    return CliRunner().invoke(cli, ["live", *map(str, arguments)], input=data, prog_name="dlgmd")


@pytest.mark.parametrize("given", [{}, {"crop": "72x54+12+6", "fov": 100.0}])
def test_lockstep_answers_every_frame_at_its_rate(tmp_path, given):
    """However fast they come; `run` on the same frames gives the same rows, of a part of them too.

    The angle is that of the whole image.
    """
    frames = looming_frames(n_frames=60, width=96, height=72)
    data = b"".join(frame.tobytes() for frame in frames)
    options = ("--input-size", "96x72", "--lockstep", "--input-fps", "20", "--jsonl", "--set", 3)
    options += tuple(part for name, value in given.items() for part in (f"--{name}", value))
    result = call("-", *options, "--record", tmp_path / "r", data=data)
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    numbers = [line["frame"] for line in lines if line["latency_ms"] is not None]
    assert numbers == [*range(60)] and "dropped: 0" in result.stderr
    recorded = read_result(tmp_path / "r")
    again = dlgmd_cli.run(np.stack(frames), 3, fps=20.0, **given)
    for name in ("mp", "expansion", "ttc_s"):
        expected = getattr(again, name)
        np.testing.assert_allclose(
            getattr(recorded, name), expected, rtol=1e-8
        )  # as the CSV has it
    assert np.isfinite(again.expansion[4:]).all()
    assert recorded.record["camera"] == again.record["camera"]
    np.testing.assert_allclose(recorded.time_s, again.time_s, atol=1e-9)


def test_a_pipe_to_lines_of_json_and_a_recording(tmp_path):
    frames = looming_frames(n_frames=12, width=64, height=48)
    data = b"".join(frame.tobytes() for frame in frames)
    recorded = ("--record", tmp_path / "r", "--fps", "all")
    result = call("-", "--input-size", "64x48", "--jsonl", *recorded, data=data)
    assert result.exit_code == 0, result.output
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    assert lines and lines[-1]["frame"] == 11  # a pipe is read as fast as it fills
    numbers = [line["frame"] for line in lines if line["latency_ms"] is not None]
    assert f"{len(numbers)} answered" in result.stderr
    assert read_result(tmp_path / "r").frame.tolist() == numbers
    again = call("-", "--input-size", "64x48", *recorded, data=data)
    assert again.exit_code == 2 and "Add --overwrite to replace it" in again.stderr
    again = call("-", "--input-size", "64x48", *recorded, "--overwrite", data=data)
    assert again.exit_code == 0 and again.stdout.splitlines()[-1] == str(tmp_path / "r")
    assert "12 came" in again.stdout


@pytest.mark.parametrize(("fps", "rate_fps"), [(60, 30.0), (20, 20.0)])
def test_a_kept_video_has_a_picture_for_each_row(runs, tmp_path, fps, rate_fps):
    """Of the turned images, whatever was dropped or is a repeat, and `view` finds it.

    It plays at the rate of the frames that the model processed.
    """
    frames = [np.roll(TEXTURE[:, :64], n, axis=1)[:48] for n in range(40)]
    path = write_video(tmp_path / "pan.avi", [frames[0], *frames], fps=fps)
    options = ("--realtime", "--record", tmp_path / "r", "--keep-video", "--rotate", 180, "--flip")
    runs("live", path, *options)
    result = read_result(tmp_path / "r")
    facts = result.record["input"]
    assert facts["path"] == str(tmp_path / "r" / "video.mkv") and facts["source"] == str(path)
    assert (facts["rotate"], facts["flip"]) == (180, True)
    stated_fps, kept = read_video(tmp_path / "r" / "video.mkv")
    assert len(kept) == len(result) > 5
    assert (stated_fps, result.record["options"]["input_fps"]) == (rate_fps, rate_fps)
    for picture, index in zip(kept, result.frame, strict=True):
        expected = frames[max(0, int(index) - 1)][::-1]  # turned, then mirrored: upside down
        assert np.abs(picture[..., 0] - expected.astype(float)).mean() < 20.0


def test_kept_pictures_are_read_again_at_the_rate_of_the_rows(tmp_path):
    """Half of the frames of a fast camera are left out."""
    source, alarm = played([*PAN], fps=60.0, model_fps=30.0), alarm_of(3)
    sight = SourceState(source)
    given = source, choose(3), InputOptions(), alarm.model, sight, tmp_path / "r"
    with Recording(*given, film="pictures") as recording, source:
        for one in filter(None, Watch(source, alarm, sight).answers()):
            recording.put(replace(one, motion=Motion((0.0, 4.0))))
    record = yaml_of(tmp_path / "r" / "run.yaml")
    headings = np.genfromtxt(tmp_path / "r" / "heading.csv", delimiter=",", names=True)
    assert headings["frame"].tolist() == [*range(record["processed"]["frames"])]
    assert record["input"]["fps"] == pytest.approx(60.0, rel=0.02)
    assert record["options"]["input_fps"] == pytest.approx(30.0, rel=0.02)


def kept_by_live(source, options, folder, **how):
    """What `live` records of a source with its images, which lose nothing."""
    how = {"film": "pictures", **how}
    with recording_of(source, folder, "flight", options, **how) as (recording, watch):
        for one in filter(None, watch.answers()):
            if one.is_of_frame:
                lossless = cv2.imencode(".png", one.frame.picture)[1]
                recording.put(replace(one, frame=replace(one.frame, picture=lossless)))
    return read_result(folder)


def test_a_recording_keeps_what_a_busy_computer_left_out(tmp_path):
    """Its rows are empty there; the kept images give all numbers."""
    source = played(looming_frames(30, 64, 48), fps=30.0, model_fps=30.0)
    source.keeps_pictures, objects = True, []
    given = source, tmp_path / "r", "flight"
    with recording_of(*given, film="video.mkv") as (recording, watch):
        for one in filter(None, watch.answers()):
            recording.put(one)
            objects.append(one.to_dict())
            watch.load.left_out = "neuron" if 8 <= one.frame.index < 20 else ""
    assert [row["frame"] for row in objects if "left_out" in row] == [*range(9, 21)]
    assert all(row["mp"] is None for row in objects if row.get("left_out") == "neuron")
    first = read_result(tmp_path / "r")
    assert "12 frames not answered in full" in str(first.record["warnings"])
    again = run(tmp_path / "r" / "video.mkv", tmp_path / "r" / "run.yaml")
    assert len(first) == len(again) == 30 and np.isnan(first.mp[9:21]).all()
    assert np.isfinite(again.mp[9:21]).all()


@pytest.mark.parametrize("mask_wh", [None, (320, 180), (60, 40)])
def test_a_part_that_is_kept_is_measured_as_it_was(tmp_path, mask_wh):
    """By its record and the one beside it; the mask is that of the part, and a part of it is, too.

    The angle is that of the whole image.
    """
    frames, mask = looming_frames(24, 320, 180), tmp_path / "mask.png"
    given = {"crop": "160x120+100+20", "fov": 100.0}
    if mask_wh is not None:
        width, height = mask_wh
        white = np.full((height, width), 255, np.uint8)
        white[: height // 2, : width // 2] = 0
        cv2.imwrite(str(mask), white)
        given["mask"] = mask
    options = InputOptions(**given)
    first = kept_by_live(played(frames, options, model_fps=30.0), options, tmp_path / "r")
    facts, record = first.record["input"], tmp_path / "r" / "run.yaml"
    assert (facts["crop"], facts["width"], facts["height"]) == ("160x120+100+20", 320, 180)
    again = run(facts["path"], record)
    mask.unlink(missing_ok=True)  # it is not needed any more
    for name in ("mp", "expansion", "ttc_s"):
        np.testing.assert_allclose(getattr(again, name), getattr(first, name), rtol=1e-6)
    assert np.isfinite(again.expansion[2:]).all()
    part = run(facts["path"], record, crop="80x100+40+10")
    whole = run(np.stack(frames), "flight", crop="80x100+140+30", fov=100.0, input_fps=30.0)
    if mask_wh is None:
        np.testing.assert_allclose(part.expansion, whole.expansion, rtol=1e-6)


def test_a_mask_that_was_kept_goes_with_its_recording(tmp_path):
    frames, mask = looming_frames(6, 64, 48), np.full((48, 64), 255, np.uint8)
    mask[:10] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    masked = InputOptions(crop="60x40+0+0", mask=tmp_path / "mask.png")
    kept_by_live(played(frames, masked, model_fps=30.0), masked, tmp_path / "r")
    assert (tmp_path / "r" / "kept-mask.png").exists()
    plain = InputOptions()
    again = played(frames, plain, model_fps=30.0)
    kept_by_live(again, plain, tmp_path / "r", overwrite=True)
    assert not (tmp_path / "r" / "kept-mask.png").exists()


def test_what_is_kept_is_scaled_to_the_size_that_the_model_saw(tmp_path):
    """The images that are kept are 640 px wide, of any that are wider."""
    options = InputOptions(scale=0.125)
    source = played(looming_frames(8, 1280, 720), options, model_fps=30.0)
    first = kept_by_live(source, options, tmp_path / "r")
    again = run(first.record["input"]["path"], tmp_path / "r" / "run.yaml")
    sizes = [
        (one["width"], one["height"])
        for one in (first.record["processed"], again.record["processed"])
    ]
    assert sizes == [(160, 90)] * 2


@pytest.mark.parametrize("fps", [29.97, 66.667, 119.913, math.nan])
def test_a_video_is_kept_at_any_measured_rate(tmp_path, caplog, fps):
    """MPEG-4 has no more than 65535 ticks a second, and a measured rate has many decimals."""
    kept = KeptVideo(tmp_path / "video.mkv")
    for picture in PAN[:5]:
        kept.put(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR), fps)
    kept.close()
    rate_fps, pictures = read_video(tmp_path / "video.mkv")
    assert len(pictures) == 5 and caplog.messages == []
    assert rate_fps == pytest.approx(30.0 if math.isnan(fps) else fps, abs=0.01)


@pytest.mark.parametrize("rotate", [0, 90, 180, 270])
def test_pictures_are_turned(rotate):
    picture = np.arange(12, dtype=np.uint8).reshape(3, 4)
    expected = np.rot90(picture, -rotate // 90)
    assert (live_source.turned(picture, rotate, False) == expected).all()
    assert (live_source.turned(picture, rotate, True) == expected[:, ::-1]).all()
