"""MAVLink of `dlgmd live`: what is sent, what is read, and when the autopilot is told to brake."""

import hashlib
import math
import os
import select
import socket
import sys
import time
import tty
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import free_port, until

from dlgmd_cli import Alarm
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.frame import Frame
from dlgmd_cli.models.corridor import Motion
from dlgmd_cli.models.detection import AlarmSpan
from dlgmd_cli.models.stopping import Brake
from dlgmd_cli.models.windows import Camera
from dlgmd_cli.watch import links, mavlink, outputs
from dlgmd_cli.watch.autopilot import JERKS, braking_modes, known_modes
from dlgmd_cli.watch.heading import Heading, along_axes, direction_of
from dlgmd_cli.watch.reports import Attitude, Reports
from dlgmd_cli.watch.watch import Answer

names = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
SOON_S = 5.0
COPTER, PLANE, PX4, ARDUPILOT = 2, 1, 12, 3
SET_INTERVAL = names.MAV_CMD_SET_MESSAGE_INTERVAL
GUIDED, STABILIZE, BRAKE, MISSION = 4, 0, 17, 4 << 16 | 4 << 24
UNDEFINED = Alarm().step(np.zeros((9, 9), np.uint8))


HERE = ("127.0.0.1", 9)


class FakeLink:
    """A link of bytes to read, each with its place, and messages that were written."""

    def __init__(self):
        self.inbox, self.others, self.written, self.sent_to = b"", [], [], []
        self._parser = names.MAVLink(None)

    def write(self, data, places):
        messages = self._parser.parse_buffer(bytes(data))
        self.written += messages
        self.sent_to += [(one.get_type(), place) for one in messages for place in places]

    def read(self):
        data, others = self.inbox, self.others
        self.inbox, self.others = b"", []
        return [*([(HERE, data)] if data else []), *others]

    def close(self): ...

    def of(self, kind):
        return [one for one in self.written if one.get_type() == kind]


@pytest.fixture
def clock(monkeypatch):
    """A clock that only the test moves on."""
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(mavlink.time, "monotonic", lambda: clock.now)
    return clock


@pytest.fixture
def link(monkeypatch):
    link = FakeLink()
    monkeypatch.setattr(mavlink, "open_link", lambda url: link)
    return link


class Pilot:
    """Writes the messages of an autopilot to a link."""

    def __init__(self, link, kind=COPTER, pilot=ARDUPILOT, source=(1, 1), place=None):
        self.link, self.kind, self.pilot, self.place = link, kind, pilot, place
        self.mav = names.MAVLink(SimpleNamespace(write=self.put), *source)

    def put(self, data):
        if self.place is None:
            self.link.inbox += bytes(data)
        else:
            self.link.others.append((self.place, bytes(data)))

    def heartbeat(self, mode=GUIDED, armed=True, custom=True):
        flags = (128 if armed else 0) | (1 if custom else 0)
        self.mav.heartbeat_send(self.kind, self.pilot, flags, mode, 4)


def answer(alarm=False, *, event="", reason="", is_of_frame=True, captured_s=100.0, **found):
    detection = replace(UNDEFINED, mp=1.0, mp_abs=0.5, alarm=alarm, **found)
    frame = Frame(3, 0.1, np.zeros((9, 9)), captured_s=captured_s)
    latency_ms = 1.5 if is_of_frame else math.nan
    return Answer(frame, detection, event=event, latency_ms=latency_ms, reason=reason)


BEGIN = answer(True, event="begin", rule="ttc")


def asked(link):
    """The messages that the autopilot is asked for, and how often (us); they are taken."""
    found = [one for one in link.of("COMMAND_LONG") if one.command == SET_INTERVAL]
    assert all((one.target_system, one.target_component) == (1, 1) for one in found)
    link.written.clear()
    return [(int(one.param1), int(one.param2)) for one in found]


MOTION = [(number, 100_000) for number in (30, 32, 33)]  # attitude; local and global position


def test_the_motion_is_asked_for_and_again_after_a_reconnect(link, clock):
    """Also where none comes, as from a drone without a position; not before it is heard."""
    send, pilot = mavlink.Mavlink("udp://x:1", Reports()), Pilot(link)

    def pass_s(seconds, *, is_heard=True, moves=True):
        for _ in range(int(10 * seconds)):
            clock.now += 0.1
            if is_heard:
                pilot.heartbeat()
            if moves:
                pilot.mav.attitude_send(0, 0, 0, 0, 0, 0, 0)
                pilot.mav.local_position_ned_send(0, 0, 0, 0, 1, 0, 0)
            send.beat()

    pass_s(2, is_heard=False, moves=False)
    assert asked(link) == []
    pass_s(0.1)
    assert asked(link) == MOTION
    pass_s(20)
    assert asked(link) == []
    pass_s(4, is_heard=False, moves=False)  # a cable, or a restart
    asked(link)
    pass_s(0.2)
    assert asked(link) == MOTION
    pass_s(14, moves=False)
    assert asked(link) == 2 * MOTION


def test_messages_are_signed(link, clock, tmp_path):
    """By the SHA-256 of the passphrase; a receiver that knows it takes them, others are refused."""
    (tmp_path / "key").write_text("over the hills\n")
    send = mavlink.Mavlink("udp://x:1", Reports(), signing=str(tmp_path / "key"))
    data = []
    link.write = lambda message, places: data.append(bytes(message))
    send(answer())
    for phrase, is_taken in (("over the hills", True), ("far away", False)):
        parser = names.MAVLink(None)
        parser.robust_parsing = True
        parser.signing.secret_key = hashlib.sha256(phrase.encode()).digest()
        kinds = {one.get_type() for one in parser.parse_buffer(b"".join(data)) or ()}
        assert ("NAMED_VALUE_FLOAT" in kinds) == is_taken
    with pytest.raises(ParameterError, match="mavlink_signing"):
        mavlink.Mavlink("udp://x:1", Reports(), signing=str(tmp_path / "none"))


KEY = hashlib.sha256(b"over the hills").digest()


def signed(link, clock, tmp_path, key=KEY):
    """A watch that is told to brake and has the key, its reports, and an autopilot with a key."""
    (tmp_path / "key").write_text("over the hills")
    send, reports = braking(signing=str(tmp_path / "key"))
    pilot = Pilot(link, place=HERE)
    pilot.mav.signing.secret_key, pilot.mav.signing.sign_outgoing = key, True
    pilot.mav.signing.timestamp = send._mav.signing.timestamp
    return send, reports, pilot


def test_with_a_key_no_forger_counts(link, clock, tmp_path, caplog):
    """Neither unsigned, nor by another key "from the future", nor what was sent before."""
    send, reports, pilot = signed(link, clock, tmp_path)
    forgers = [Pilot(link, place=("10.0.0.9", number)) for number in (1, 2)]
    forgers[1].mav.signing.secret_key, forgers[1].mav.signing.sign_outgoing = bytes(32), True
    forgers[1].mav.signing.timestamp = pilot.mav.signing.timestamp + 10**9
    for _ in range(20):
        for forger in forgers:
            forger.heartbeat(STABILIZE, armed=False)
        pilot.heartbeat()
        link.others.append((("10.0.0.9", 3), link.others[-1][1]))  # what it has heard
        forgers[0].mav.radio_status_send(0, 0, 0, 0, 0, 0, 0)  # as a radio does, and is not told
        send.beat()
        clock.now += 1.0
    assert [*reports][:4] == [
        ("unsigned", {"why": "not signed", "address": "10.0.0.9:1"}),
        ("unsigned", {"why": "signed with another key", "address": "10.0.0.9:2"}),
        ("unsigned", {"why": "old, or sent twice", "address": "10.0.0.9:3"}),
        ("autopilot", {"heard": True, "mode": "GUIDED", "armed": True}),
    ]
    send(answer(True, event="begin", captured_s=clock.now))
    assert commands(link) == [(176, 0, 129, BRAKE, 0)]
    send.close()
    flaws = "not signed", "signed with another key", "old, or sent twice"
    assert caplog.messages == [f"mavlink: dropped 20 messages: {flaw}" for flaw in flaws]


def test_a_wrong_key_is_told_from_no_answer(link, clock, tmp_path):
    send, reports, pilot = signed(link, clock, tmp_path, key=bytes(32))
    pilot.heartbeat()
    send.beat()
    assert reports[0] == (
        "unsigned",
        {"why": "signed with another key", "address": "127.0.0.1:9"},
    )
    clock.now += 3.1
    send.beat()
    assert reports[1] == ("autopilot", {"heard": False}) and len(reports) == 2


def test_an_autopilot_without_a_clock_is_answered_until_its_time_is_right(link, clock, tmp_path):
    """By MAVLink's rules, it takes the time of what it gets."""
    send, reports, pilot = signed(link, clock, tmp_path)
    now, pilot.mav.signing.timestamp = pilot.mav.signing.timestamp, 1
    pilot.heartbeat()
    send.beat()
    assert reports[0][1]["why"] == "old, or sent twice" and ("HEARTBEAT", HERE) in link.sent_to
    pilot.mav.signing.timestamp = now
    pilot.heartbeat()
    send.beat()
    assert reports[1] == ("autopilot", {"heard": True, "mode": "GUIDED", "armed": True})


def braking(modes="GUIDED", **more):
    reports = Reports()
    send = mavlink.Mavlink("udp://x:1", reports, modes=known_modes(modes), **more)
    return send, reports


def told(reports):
    """The reports so far, without those of the autopilot's state."""
    found = [(event, {**facts}) for event, facts in reports if event != "autopilot"]
    reports.clear()
    return found


def commands(link):
    """The commands of a mode; after each, a heartbeat is asked for."""
    sent = [one for one in link.of("COMMAND_LONG") if one.command != SET_INTERVAL]
    sent = [one for one in sent if (one.command, one.param1) != (512, 2)]  # the time of its start
    modes, beats = sent[::2], sent[1::2]
    assert all((one.command, one.param1) == (512, 0) for one in beats)
    return [
        (one.command, one.confirmation, int(one.param1), int(one.param2), int(one.param3))
        for one in modes
    ]


def texts(link):
    """What the pilot was told of the brake."""
    found = []
    for one in link.of("STATUSTEXT"):
        found += [""] if one.chunk_seq == 0 else []
        found[-1] += one.text
    return [text.removeprefix("dlgmd: ") for text in found if "alarm" not in text]


# What is sent.


def test_a_long_text_is_sent_in_parts_of_one_number(link):
    """The last part has room for the zero byte that ends it; a text of 50 bytes is one part."""
    send = mavlink.Mavlink("udp://x:1", Reports())
    for n_letters in (43, 44, 92, 93):
        send._tell(4, "x" * n_letters)
    parts = [(one.id, one.chunk_seq, len(one.text)) for one in link.of("STATUSTEXT")]
    of_43, of_44, of_92 = [(0, 0, 50)], [(1, 0, 50), (1, 1, 1)], [(2, 0, 50), (2, 1, 49)]
    assert parts == [*of_43, *of_44, *of_92, (3, 0, 50), (3, 1, 50), (3, 2, 0)]


def test_what_a_flight_sends(link, clock):
    send = mavlink.Mavlink("udp://x:1", Reports(), system=7, component=42)
    spike = answer(spike=True, ttc_s=0.7)
    begin = replace(BEGIN, span=AlarmSpan(3, 0.1, 3, 0.1, 0.5, side="left"))
    for one in (answer(), spike, begin, answer(), answer(event="end")):
        send(one)
        clock.now += 0.1
    send(answer(event="blind", reason="black", is_of_frame=False))
    send(answer(event="sees", is_of_frame=False))
    send.close()
    assert {(one.get_srcSystem(), one.get_srcComponent()) for one in link.written} == {(7, 42)}
    threats = link.of("COLLISION")
    assert [one.threat_level for one in threats] == [1, 2, 0]
    assert {one.src for one in threats} == {255}  # neither ADS-B nor an aircraft's GPS
    assert threats[0].time_to_minimum_delta == pytest.approx(0.7)
    assert math.isnan(threats[1].time_to_minimum_delta)
    texts = [(one.severity, one.text) for one in link.of("STATUSTEXT")]
    assert texts == [
        *((2, "dlgmd: collision alarm (ttc), left"), (5, "dlgmd: collision alarm over")),
        *((3, "dlgmd: blind (black)"), (5, "dlgmd: recovered")),
        (4, "dlgmd: the watch has ended"),
    ]
    beats = [one.system_status for one in link.of("HEARTBEAT")]
    assert beats == [names.MAV_STATE_ACTIVE, names.MAV_STATE_POWEROFF]
    values = link.of("NAMED_VALUE_FLOAT")
    n_sets = 3  # at most five a second, and with events
    assert [one.name for one in values] == ["mp", "expansion", "ttc_s"] * n_sets
    assert values[0].value == 1.0 and values[3].time_boot_ms in (199, 200)
    assert not link.of("COMMAND_LONG")


def test_the_heartbeat_goes_on_without_frames(link, monkeypatch):
    """BOOT before the first frame, CRITICAL after `blind`."""
    monkeypatch.setattr(mavlink, "HEARTBEAT_S", 0.02)
    monkeypatch.setattr(mavlink.Mavlink, "PAUSE_S", 0.01)
    output = outputs.Receiver("--mavlink", mavlink.Mavlink("udp://x:1", Reports()))

    def states():
        return [one.system_status for one in link.of("HEARTBEAT")]

    until(lambda: len(states()) > 2)
    output.put(answer(event="blind", reason="lost", is_of_frame=False))
    until(lambda: states()[-2:] == [names.MAV_STATE_CRITICAL] * 2)
    output.put(answer(event="sees", is_of_frame=False))
    until(lambda: states()[-1] == names.MAV_STATE_ACTIVE)
    outputs.finish([output])
    assert states()[0] == names.MAV_STATE_BOOT and states()[-1] == names.MAV_STATE_POWEROFF


# What is read.


def test_the_state_of_the_autopilot_is_reported(link, clock):
    send, reports = braking()
    pilot = Pilot(link)
    for _ in range(2):  # an autopilot that is there is not called lost before its first heartbeat
        send.beat()
        clock.now += 0.9
    pilot.heartbeat()
    send.beat()
    send.beat()
    pilot.heartbeat(STABILIZE, armed=False)
    send.beat()
    clock.now += 3.1
    send.beat()
    assert [*reports] == [
        ("autopilot", {"heard": True, "mode": "GUIDED", "armed": True}),
        ("autopilot", {"heard": True, "mode": "STABILIZE", "armed": False}),
        ("autopilot", {"heard": False}),
    ]


def test_the_speed_is_the_local_one_if_there_is_one(link, clock):
    send, reports = braking()
    pilot = Pilot(link)
    assert math.isnan(reports.speed_m_s)
    pilot.mav.global_position_int_send(0, 0, 0, 0, 0, 300, 400, 0, 0)
    send.beat()
    assert reports.speed_m_s == pytest.approx(5.0)
    pilot.mav.local_position_ned_send(0, 0, 0, 0, 2.0, 1.0, 2.0)
    send.beat()
    assert reports.speed_m_s == pytest.approx(3.0)
    pilot.mav.local_position_ned_send(0, 0, 0, 0, math.nan, 1.0, 2.0)
    send.beat()
    assert reports.speed_m_s == pytest.approx(3.0)
    clock.now += 1.5
    pilot.mav.global_position_int_send(0, 0, 0, 0, 0, 100, 0, 0, 0)
    clock.now += 1.0
    send.beat()
    assert reports.speed_m_s == pytest.approx(1.0)  # the other is too old
    facts = replace(answer(), speed_m_s=reports.speed_m_s).to_dict()
    assert facts["speed_m_s"] == 1.0 and "speed_m_s" not in answer().to_dict()


DIRECTIONS = [
    # roll, pitch, yaw; north, east, down; tilt of the camera; to the right, upwards
    ((0, 0, 0), (2, 0, 0), 0, (0, 0)),
    ((0, -5, 0), (2, 0, 0), 0, (0, 5)),
    ((0, -5, 90), (0, 2, 0), 5, (0, 0)),
    ((0, 0, 90), (-0.2, 2, 0), 0, (5.71, 0)),
    ((10, 0, 180), (-2, 0, -0.2), 0, (-1.0, 5.62)),
    ((0, 0, 0), (2, 0, 0.2), 10, (0, -15.71)),
]


@pytest.mark.parametrize(("attitude", "velocity", "tilt_deg", "expected"), DIRECTIONS)
def test_the_direction_of_flight_in_the_view_of_the_camera(attitude, velocity, tilt_deg, expected):
    motion = along_axes(velocity, tuple(map(math.radians, attitude)))
    assert direction_of(motion, tilt_deg) == pytest.approx(expected, abs=0.02)
    backwards = along_axes(tuple(-part for part in velocity), tuple(map(math.radians, attitude)))
    assert direction_of(backwards, tilt_deg) is None


def test_the_attitude_alone_tells_of_turns(clock):
    reports, camera = Reports(), Camera(tilt_deg=10.0)
    heading = Heading(reports)
    heading.look(camera, (240, 135))
    assert heading.motion() == Motion()
    for velocity in (None, (0.1, 0.0, 0.0), (-2.0, 0.0, 0.0)):  # unknown, at rest, backwards
        reports.motion = velocity
        reports.attitude = Attitude((0.1, 0.2, 0.3), (0.0, 0.0, 0.0), clock.now)
        motion = heading.motion()
        assert motion.direction == Motion().direction and not motion.has_way
        assert motion[2:] == pytest.approx(np.degrees((0.1, 0.2, 0.3)))
        reports.attitude = None
        assert velocity is None or not heading.motion().has_attitude
    reports.motion, reports.attitude = None, Attitude((0.1, 0.2, 0.3), (0.0, 0.0, 0.0), clock.now)
    clock.now += 1.01
    assert heading.motion() == Motion()


def test_the_heading_follows_what_is_fresh_fast_and_in_view(link, clock):
    """Smoothed; an event says when it comes, and why it goes. Impossible angles are ignored."""
    send, reports = braking()
    heading, pilot = Heading(reports), Pilot(link)
    heading.look(Camera(), (240, 135))

    def found(forward_m_s=None, pitch_deg=None):
        if forward_m_s is not None:
            pilot.mav.local_position_ned_send(0, 0, 0, 0, forward_m_s, 0, 0)
        if pitch_deg is not None:
            pilot.mav.attitude_send(0, 0, math.radians(pitch_deg), 0, 0, 0, 0)
        send.beat()
        direction = heading.motion().direction
        return None if math.isnan(sum(direction)) else direction

    def events():
        return [{**facts} for event, facts in told(reports) if event == "heading"]

    assert found() is None and found(2.0) is None
    assert events() == [{"by": "default", "why": "no attitude and velocity within 1 s"}]
    assert found(2.0, -8.0) == pytest.approx((0.0, 8.0))
    assert events() == [{"by": "autopilot", "right_deg": 0.0, "up_deg": 8.0}]
    clock.now += 0.1
    assert found(2.0, math.nan)[1] == found(2.0, math.inf)[1] == pytest.approx(8.0)
    clock.now += 0.3
    assert found(2.0, -2.0)[1] == pytest.approx(2.0 + 6.0 / math.e, abs=0.1)
    clock.now += 0.99
    assert found() is not None and events() == []
    clock.now += 0.02
    assert found() is None and found(0.4, -2.0) is None
    assert heading.motion().pitch_deg == pytest.approx(-2.0, abs=1.0)  # a turn is known at rest
    clock.now += 1.01
    assert found(2.0, -60.0) == pytest.approx((0.0, 60.0), abs=1.0)  # out of view
    assert [one["why"] for one in events()] == [
        "no attitude and velocity within 1 s",
        "slower than 0.5 m/s",
        "the camera does not see where the drone flies",
    ]
    clock.now += 1.01
    for forward_m_s in (0.42, 0.55, 0.42, 0.55, 0.3):  # about the least speed: no event each time
        pilot.mav.attitude_send(0, 0, 0, 0, 0, 0, 0)
        found(forward_m_s)
        clock.now += 0.9
    assert [one["by"] for one in events()] == ["default", "autopilot", "default"]


@pytest.mark.parametrize("speed_m_s", [100.5, 1e6, 1e38, -math.inf])
def test_a_speed_that_no_drone_has_is_ignored_and_told_once(link, clock, caplog, speed_m_s):
    send, reports = braking()
    pilot = Pilot(link)
    for forward_m_s in (7.0, speed_m_s, speed_m_s):
        pilot.mav.local_position_ned_send(0, 0, 0, 0, forward_m_s, 0, 0)
        send.beat()
        assert reports.speed_m_s == pytest.approx(7.0)
    (line,) = caplog.messages
    assert "mavlink: the autopilot reports " in line
    assert line.endswith(" m/s; speeds beyond 100 m/s are ignored")


def test_others_are_not_the_autopilot(link, clock):
    """Neither a gimbal of the vehicle, nor another vehicle, nor a ground station."""
    send, reports = braking(system=3)
    for source in ((3, 154), (1, 1), (255, 190)):
        Pilot(link, source=source).heartbeat()
    clock.now += 3.0
    send.beat()
    assert reports == Reports([("autopilot", {"heard": False})])
    Pilot(link, source=(3, 1)).heartbeat()
    send.beat()
    assert reports[-1][1]["heard"]


def test_nonsense_is_told_once_and_stops_nothing(link, clock, caplog):
    """Noise of a wrong rate, messages cut anywhere, and messages with impossible values."""
    rng = np.random.default_rng(4)
    send, reports = braking()
    pilot = Pilot(link)
    for _ in range(200):
        link.inbox += rng.integers(0, 256, 60, dtype=np.uint8).tobytes()
        pilot.heartbeat()
        data = bytearray(link.inbox)
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        link.inbox = bytes(data[: rng.integers(40, len(data))])
        send(answer())
    assert caplog.messages == [
        "mavlink: what comes back is not MAVLink; check the rate of the port"
    ]
    link.inbox = bytes(300)  # what was cut is over
    Pilot(link, kind=99, pilot=77).heartbeat(mode=4_000_000_000)
    pilot.mav.command_ack_send(names.MAV_CMD_DO_SET_MODE, 99)
    send.beat()
    assert reports[-1] == ("autopilot", {"heard": True, "mode": "Mode(4000000000)", "armed": True})
    reports.clear()
    send(BEGIN)
    assert told(reports) == [
        ("brake-withheld", {"why": "no braking mode of this vehicle is known"})
    ]
    pilot.heartbeat()
    send(BEGIN)
    assert commands(link) == [(176, 0, 129, BRAKE, 0)]


# The command.


class Drone(Pilot):
    """An autopilot with a mode, whose heartbeat comes once a second; and the clock of both."""

    def __init__(self, link, clock, send, **more):
        super().__init__(link, **more)
        self.mode, self.is_armed, self.result, self.obeys = GUIDED, True, 0, True
        self.clock, self.send, self.beat_s, self.beats = clock, send, -math.inf, True
        self._n_seen = 0

    def live(self, duration_s, alarm=False, step_s=0.05):
        """Let time pass, with answers that have or have no alarm."""
        end_s = self.clock.now + duration_s
        while self.clock.now < end_s - 1e-9:
            if self.beats and self.clock.now - self.beat_s >= 1.0:
                self.beat_s = self.clock.now
                self.heartbeat(self.mode, self.is_armed)
            self.send(answer(alarm, captured_s=self.clock.now))
            for command in self.link.of("COMMAND_LONG")[self._n_seen :]:
                self._n_seen += 1
                if self.result is None:
                    continue
                if command.command != names.MAV_CMD_DO_SET_MODE:
                    self.beat_s = -math.inf  # it was asked for a heartbeat
                    continue
                result = self.result.pop(0) if isinstance(self.result, list) else self.result
                self.mav.command_ack_send(names.MAV_CMD_DO_SET_MODE, result)
                if result == 0 and self.obeys:
                    main, sub = int(command.param2), int(command.param3)
                    self.mode = main << 16 | sub << 24 if self.pilot == PX4 else main
            self.clock.now += step_s

    def forget(self):
        """Forget what was sent so far."""
        self.link.written.clear()
        self._n_seen = 0

    def alarm(self, duration_s=1.0):
        """An alarm that begins, and is on for so long."""
        self.send(answer(True, event="begin", rule="ttc", captured_s=self.clock.now))
        self.live(duration_s, alarm=True)

    def over(self):
        self.send(answer(event="end", captured_s=self.clock.now))


def flying(link, clock, modes="GUIDED", *, kind=COPTER, pilot=ARDUPILOT, mode=GUIDED, **more):
    """A watch with an autopilot that was heard, and its reports."""
    send, reports = braking(modes, **more)
    drone = Drone(link, clock, send, kind=kind, pilot=pilot)
    drone.mode = mode
    drone.live(0.2)
    reports.clear()
    return drone, reports


@pytest.mark.parametrize(
    ("kind", "pilot", "mode", "modes", "numbers", "name"),
    [
        (COPTER, ARDUPILOT, GUIDED, "auto, guided", (BRAKE, 0), "BRAKE"),
        (COPTER, ARDUPILOT, GUIDED, "4", (BRAKE, 0), "BRAKE"),
        (10, ARDUPILOT, 10, "AUTO", (4, 0), "HOLD"),  # a rover
        (COPTER, PX4, MISSION, "MISSION", (4, 3), "LOITER"),
        (COPTER, PX4, MISSION, str(MISSION), (4, 3), "LOITER"),
    ],
)
def test_an_alarm_brakes(link, clock, kind, pilot, mode, modes, numbers, name):
    """Once; its mode is seen, and the end of the alarm releases nothing."""
    drone, reports = flying(link, clock, modes, kind=kind, pilot=pilot, mode=mode)
    drone.alarm(4.0)
    drone.over()
    drone.live(2.0)
    assert commands(link) == [(176, 0, 128 | 1, *numbers)]
    assert {(one.target_system, one.target_component) for one in link.of("COMMAND_LONG")} == {
        (1, 1)
    }
    assert told(reports) == [
        ("brake", {"mode": name, "number": 1}),
        ("brake-answer", {"result": "ACCEPTED", "number": 1}),
        ("brake-confirmed", {"mode": name, "number": 1}),
    ]
    assert texts(link) == [f"braking ({name})"]


@pytest.mark.parametrize(
    ("change", "why", "text"),
    [
        ({"beats": False}, "no heartbeat of the autopilot within 3 s", None),
        ({"is_armed": False}, "not armed", None),
        ({"mode": STABILIZE}, "STABILIZE is not one of the modes", "mode STABILIZE"),
        ({"mode": BRAKE}, "BRAKE already", None),
    ],
)
def test_what_withholds_the_brake_is_asked_again(link, clock, change, why, text):
    """While the alarm is on, and told once; what it was is told to the pilot, too."""
    drone, reports = flying(link, clock, "GUIDED,BRAKE")
    before = {name: getattr(drone, name) for name in change}
    vars(drone).update(change)
    drone.live(3.1)
    drone.alarm(0.4)
    assert told(reports) == [("brake-withheld", {"why": why})] and not commands(link)
    assert texts(link) == [f"not braking: {text or why}"]
    vars(drone).update(before)
    drone.live(1.2, alarm=True)
    assert commands(link) == [(176, 0, 129, BRAKE, 0)]
    drone.over()


def test_nothing_is_sent_once_the_alarm_is_over(link, clock):
    drone, reports = flying(link, clock)
    drone.mode = STABILIZE
    drone.live(1.0)
    drone.alarm(0.4)
    drone.over()
    drone.mode = GUIDED
    drone.live(3.0)
    assert not commands(link) and [event for event, _ in told(reports)] == ["brake-withheld"]


def test_a_blind_watch_and_a_late_alarm_do_not_brake(link, clock):
    for found, why in (
        (answer(True, event="begin", reason="frozen"), "blind, frozen"),
        (answer(True, event="begin", captured_s=98.9), "the alarm is more than 1 s old"),
    ):
        send, reports = braking()
        Pilot(link).heartbeat()
        send(found)
        assert told(reports) == [("brake-withheld", {"why": why})] and not commands(link)


def test_an_alarm_brakes_also_if_what_follows_is_not_measured(link, clock):
    send, reports = braking()
    Pilot(link).heartbeat()
    send(answer(True, event="begin", reason="unmeasured"))
    assert commands(link) and not told(reports)[0][1].get("why")


def test_one_lost_heartbeat_does_not_withhold_the_brake(link, clock):
    """It counts for 3 s."""
    for age_s, n_sent in ((2.9, 1), (3.1, 0)):
        link.written.clear()
        send, _ = braking()
        Pilot(link).heartbeat()
        send.beat()
        clock.now += age_s
        send(answer(True, event="begin", captured_s=clock.now))
        assert len(commands(link)) == n_sent


@pytest.mark.parametrize("kind", [PLANE, *range(19, 26)])
def test_a_plane_has_nothing_to_brake_with(link, clock, kind):
    """Nor has a VTOL in forward flight, or one of which that is not known; one that hovers has."""
    ways = [(ARDUPILOT, 15, "GUIDED", None), (PX4, MISSION, "MISSION", None)]
    ways += [(PX4, MISSION, "MISSION", state) for state in (1, 2, 3, 4)]
    for pilot, mode, modes, vtol_state in ways:
        link.written.clear()
        send, reports = braking(modes)
        autopilot = Pilot(link, kind, pilot)
        if vtol_state is not None:
            autopilot.mav.extended_sys_state_send(vtol_state, 2)
        autopilot.heartbeat(mode)
        send(BEGIN)
        if kind != PLANE and vtol_state == names.MAV_VTOL_STATE_MC:
            assert commands(link) == [(176, 0, 129, 4, 3)]
        else:
            assert told(reports)[0][1]["why"] == "no braking mode of this vehicle is known"
            assert not commands(link)


@pytest.mark.parametrize("result", [None, names.MAV_RESULT_DENIED, names.MAV_RESULT_FAILED])
def test_a_command_is_sent_ten_times(link, clock, result):
    """A tenth of a second after the one before, while the mode is not seen."""
    drone, reports = flying(link, clock)
    drone.result = result
    begin_s = clock.now
    drone.alarm(3.0)
    assert [confirmation for _, confirmation, *_ in commands(link)] == [*range(10)]
    name = {None: "no answer (signing?)", 2: "DENIED", 4: "FAILED"}[result]
    (first, *answers, (event, facts)) = told(reports)
    assert first == ("brake", {"mode": "BRAKE", "number": 1})
    assert answers == ([] if result is None else [("brake-answer", {"result": name, "number": 1})])
    assert event == "brake-failed" and facts == {"mode": "BRAKE", "number": 10, "why": name}
    refusal = [] if result is None else [f"BRAKE REFUSED: {name}"]
    assert texts(link) == ["braking (BRAKE)", *refusal, f"BRAKE FAILED: {name}"]
    assert clock.now - begin_s == pytest.approx(3.0)


def test_the_mode_counts_not_the_answer(link, clock):
    """A lost answer is no failure; ACCEPTED without the mode is none either, and it goes on."""
    drone, reports = flying(link, clock)
    drone.result = None
    drone.alarm(0.3)
    drone.mode = BRAKE  # it was heard, but its answer was lost
    drone.live(1.5, alarm=True)
    assert told(reports)[-1] == (
        "brake-confirmed",
        {"mode": "BRAKE", "number": len(commands(link))},
    )
    drone.over()
    drone.forget()
    drone.mode, drone.result, drone.obeys = GUIDED, 0, False
    drone.live(3.0)
    drone.alarm(0.8)
    n_sent = len(commands(link))
    assert n_sent in (1, 2)  # it waits for a heartbeat
    drone.live(12.0, alarm=True)
    assert len(commands(link)) == 10  # one with each heartbeat
    why = "ACCEPTED, but the mode stays GUIDED"
    assert told(reports)[-1] == ("brake-failed", {"mode": "BRAKE", "number": 10, "why": why})


@pytest.mark.parametrize("is_confirmed", [False, True])
def test_the_pilot_takes_over(link, clock, is_confirmed):
    """Another mode than before and than ours: nothing more in this alarm, but in the next one."""
    drone, reports = flying(link, clock, "GUIDED,LOITER")
    drone.result = 0 if is_confirmed else None
    drone.alarm(1.5 if is_confirmed else 0.3)
    n_sent = len(commands(link))
    drone.mode, drone.beat_s = 5, -math.inf  # LOITER, which is one of the modes
    drone.live(4.0, alarm=True)
    assert len(commands(link)) == n_sent
    if not is_confirmed:
        why = "the pilot has taken over (LOITER)"
        assert told(reports)[-1] == ("brake-withheld", {"why": why})
    drone.over()
    drone.result = 0
    drone.alarm(0.3)
    assert len(commands(link)) == n_sent + 1


ORDER = "BRAKE,ALT_HOLD,LAND"


@pytest.mark.parametrize(
    ("result", "obeys", "beats", "least_s", "most_s"),
    [
        ([2, 0], True, True, 0.0, 0.2),  # refused
        ([0, 0], False, True, 0.1, 1.2),  # accepted, but a later heartbeat has the old mode
        (None, True, False, 1.5, 1.7),  # neither an answer nor a heartbeat
    ],
)
def test_the_next_mode(link, clock, result, obeys, beats, least_s, most_s):
    drone, reports = flying(link, clock, braking=known_modes(ORDER))
    drone.result, drone.obeys, drone.beats = result, obeys, beats
    begin_s = clock.now
    drone.send(answer(True, event="begin", rule="ttc", captured_s=clock.now))
    while len([one for one in reports if one[0] == "brake"]) < 2:
        drone.live(0.05, alarm=True)
        assert clock.now - begin_s < 5.0
    assert least_s <= clock.now - begin_s <= most_s + 0.06
    modes = [numbers[3] for numbers in commands(link)]
    assert modes[0] == BRAKE and modes[-1] == 2 and set(modes) == {BRAKE, 2}  # ALT_HOLD
    named = [facts["mode"] for event, facts in told(reports) if event == "brake"]
    assert named == ["BRAKE", "ALT_HOLD"] and "braking (ALT_HOLD)" in texts(link)


def test_land_only_where_it_is_named(link, clock):
    """And only after the others; what a vehicle does not have is left out."""
    drone, reports = flying(link, clock, braking=known_modes("HOLD,BRAKE,LAND"))
    drone.result = [2, 0]
    drone.alarm(2.0)
    assert [numbers[3] for numbers in commands(link)] == [BRAKE, 9]
    assert told(reports)[-1] == ("brake-confirmed", {"mode": "LAND", "number": 1})


@pytest.mark.parametrize(
    ("pilot", "mode", "name"), [(ARDUPILOT, 2, "ALT_HOLD"), (PX4, 2 << 16, "ALTCTL")]
)
def test_a_mode_that_only_holds_a_height_is_no_brake(link, clock, caplog, pilot, mode, name):
    """The drone flies on, and sinks with the throttle stick: both are told."""
    before = MISSION if pilot == PX4 else GUIDED
    more = {"pilot": pilot, "mode": before, "braking": [name]}
    drone, reports = flying(link, clock, "GUIDED,MISSION", **more)
    drone.alarm(2.0)
    assert drone.mode == mode and told(reports)[-1] == ("height-held", {"mode": name, "number": 1})
    assert texts(link)[-1] == f"NOT BRAKING: {name} holds the height alone"
    what = "with a throttle stick at the bottom, the drone sinks; put it into the middle"
    assert caplog.messages == [f"mavlink: in {name}, {what}"]


# The stop.


def stops(link, clock, speed_m_s=3.0, jerk=None, seconds=5.0, name="PSC_JERK_XY", **more):
    """Let a drone fly that answers for its jerk, if any; the reports."""
    drone, reports = flying(link, clock, **more)
    for _ in range(int(seconds)):
        drone.mav.local_position_ned_send(0, 0, 0, 0, 0, speed_m_s, 0)
        if jerk is not None and link.of("PARAM_REQUEST_READ"):
            drone.mav.param_value_send(name.encode(), jerk, 9, 1, 0)
        drone.live(1.0)
    return reports


def asked_for(link):
    return [one.param_id for one in link.of("PARAM_REQUEST_READ")]


@pytest.mark.parametrize("name", JERKS)
def test_arducopter_tells_its_stop(link, clock, name):
    """The parameter has another name in later versions; it is read once, and none is written."""
    reports = stops(link, clock, jerk=20.0, name=name)
    assert asked_for(link) == [*JERKS] and not link.of("PARAM_SET")
    state = {"heard": True, "mode": "GUIDED", "armed": True}
    needed_s = round(Brake.parse("arducopter:20").stop_s(3.0), 2)
    stop = {"brake": "arducopter:20", "brake_by": name, "stop_s": needed_s}
    assert [*reports] == [("autopilot", state | stop)]
    assert reports.brake == Brake.parse("arducopter:20")


@pytest.mark.parametrize("jerk", [None, 0.0, 1e-30, -5.0, math.nan, math.inf, 1e9])
def test_without_a_valid_answer_the_default_is_assumed(link, clock, jerk):
    reports = stops(link, clock, jerk=jerk)
    assert len(asked_for(link)) == 3 * len(JERKS)
    facts = reports[-1][1]
    assert (facts["brake"], facts["brake_by"]) == ("arducopter", "default, no valid answer")
    assert reports.brake == Brake.parse("arducopter") and facts["stop_s"] > 1.7


def test_px4_is_not_asked(link, clock):
    reports = stops(link, clock, pilot=PX4, mode=MISSION, modes="MISSION")
    assert not asked_for(link) and reports.brake == Brake.parse("px4")


@pytest.mark.parametrize(
    ("jerk", "speed_m_s", "is_armed", "cure"),
    [
        (5.0, 3.0, True, "set PSC_JERK_XY to 15, which"),
        (5.0, 5.0, True, "set PSC_JERK_XY to 20, which"),
        (None, 3.0, True, "set PSC_JERK_XY to 15, which"),
        (20.0, 3.0, True, None),
        (5.0, 3.0, False, None),
        (5.0, 0.2, True, None),
    ],
)
def test_an_alarm_that_is_too_late_is_warned_of(
    link, clock, caplog, jerk, speed_m_s, is_armed, cure
):
    """Once, armed and moving: which parameter, which value, and what it costs.

    Also where the threshold follows the speed, and is low already.
    """
    rule = Alarm().rule
    rule.threshold = 0.3
    send, _ = braking(rule=rule)
    drone = Drone(link, clock, send)
    drone.is_armed = is_armed
    for _ in range(8):
        drone.mav.local_position_ned_send(0, 0, 0, 0, 0, speed_m_s, 0)
        if jerk is not None:
            drone.mav.param_value_send(b"PSC_JERK_XY", jerk, 9, 1, 0)
        drone.live(1.0)
    lines = [line for line in caplog.messages if "is too late for a stop" in line]
    assert len(lines) == (cure is not None)
    for line in lines:
        assert f"at {speed_m_s} m/s, expansion_alarm 0.47" in line and cure in line
        assert "false alarms" in line


@pytest.mark.parametrize(("pilot", "mode"), [(ARDUPILOT, GUIDED), (PX4, MISSION)])
def test_a_threshold_of_the_window_that_is_too_late_is_warned_of(link, clock, caplog, pilot, mode):
    """With the rule corridor, it holds where the motion is unknown."""
    send, _ = braking(rule=Alarm(alarm="corridor").rule)
    drone = Drone(link, clock, send, pilot=pilot)
    drone.mode = mode
    for _ in range(8):
        drone.mav.local_position_ned_send(0, 0, 0, 0, 0, 3.0, 0)
        drone.live(1.0)
    (line,) = (one for one in caplog.messages if "is too late for a stop" in one)
    assert "expansion_alarm 0.47 is" in line
    assert ("corridor_alarm 0.5 and" in line) == (pilot == ARDUPILOT)


def test_a_command_is_not_sent_again_to_what_is_not_armed_any_more(link, clock):
    drone, reports = flying(link, clock)
    drone.result = None
    drone.alarm(0.25)
    drone.is_armed, drone.beat_s = False, -math.inf
    drone.live(0.1, alarm=True)
    n_sent = len(commands(link))
    drone.live(3.0, alarm=True)
    assert len(commands(link)) == n_sent
    assert told(reports)[-1] == ("brake-withheld", {"why": "not armed"})


def test_commands_of_two_alarms_are_two_seconds_apart(link, clock):
    """The pilot has taken over and gone on; a new alarm comes at once."""
    drone, reports = flying(link, clock)
    drone.alarm(0.5)
    drone.over()
    drone.mode, drone.beat_s = GUIDED, -math.inf
    drone.alarm(1.0)
    assert len(commands(link)) == 1
    drone.live(1.0, alarm=True)
    assert len(commands(link)) == 2
    withheld = [facts["why"] for event, facts in told(reports) if event == "brake-withheld"]
    assert withheld == ["BRAKE already", "commanded less than 2 s ago"]


def test_answers_to_others_do_not_count(link, clock):
    send, reports = braking()
    pilot = Pilot(link)
    pilot.heartbeat()
    send(BEGIN)
    pilot.mav.command_ack_send(400, 0)
    pilot.mav.command_ack_send(names.MAV_CMD_DO_SET_MODE, 0, target_system=255)
    Pilot(link, source=(1, 154)).mav.command_ack_send(names.MAV_CMD_DO_SET_MODE, 0)
    send.beat()
    assert [event for event, _ in told(reports)] == ["brake"]
    pilot.mav.command_ack_send(names.MAV_CMD_DO_SET_MODE, 0, 0, 0, 1, 196)
    send.beat()
    assert told(reports) == [("brake-answer", {"result": "ACCEPTED", "number": 1})]


def test_nothing_is_commanded_without_modes(link, clock):
    send = mavlink.Mavlink("udp://x:1", reports := Reports())
    Pilot(link).heartbeat()
    send(BEGIN)
    assert not commands(link) and not told(reports)


# Who is there.

GROUND, COPTERS = ("127.0.0.1", 1), [("127.0.0.1", 2), ("127.0.0.1", 3)]


def test_commands_go_to_the_autopilot_alone(link, clock):
    """A ground station that speaks fifty times as often hears everything else."""
    send, _ = braking()
    ground = Pilot(link, 6, 8, source=(255, 190), place=GROUND)
    copter = Pilot(link, place=COPTERS[0])
    for number in range(50):
        ground.heartbeat()
        if number == 20:
            copter.heartbeat()
        clock.now += 0.02
        send(answer(captured_s=clock.now))
    send(answer(True, event="begin", rule="ttc", captured_s=clock.now))
    places = {
        kind: {place for one, place in link.sent_to if one == kind} for kind, _ in link.sent_to
    }
    assert places["COMMAND_LONG"] == {COPTERS[0]}
    assert places["COLLISION"] == places["STATUSTEXT"] == {GROUND, COPTERS[0]}
    clock.now += 5.1
    link.sent_to.clear()
    ground.heartbeat()
    send(answer(event="end", captured_s=clock.now))
    assert {place for _, place in link.sent_to} == {GROUND}


def two(link, clock, apart_ms):
    """Two addresses that speak as the autopilot, and say when they were started; the reports."""
    send, reports = braking()
    first, second = (Pilot(link, place=place) for place in COPTERS)
    first.heartbeat()
    second.heartbeat(STABILIZE, armed=False)
    send.beat()
    first.mav.attitude_send(90_000, 0, 0, 0, 0, 0, 0)
    if apart_ms is not None:
        second.mav.system_time_send(0, 90_000 + apart_ms)
    send(answer(True, event="begin", captured_s=clock.now))
    return send, reports, first


@pytest.mark.parametrize(("apart_ms", "are"), [(300, "links of one autopilot"), (None, "unknown")])
def test_the_first_address_stays_the_autopilot(link, clock, apart_ms, are):
    """Be the other another of its links, or whoever: it is named, and not heeded."""
    _, reports, _ = two(link, clock, apart_ms)
    state = {"heard": True, "mode": "GUIDED", "armed": True}
    addresses = {"addresses": ["127.0.0.1:2", "127.0.0.1:3"]}
    assert reports[-2] == ("autopilot", state | addresses | {"are": are})
    assert commands(link) == [(176, 0, 129, BRAKE, 0)]
    orders = {place for kind, place in link.sent_to if kind == "COMMAND_LONG"}
    assert orders == {*COPTERS}  # both are asked for their clocks


def test_messages_that_waited_do_not_make_two_autopilots(link, clock):
    """As on a busy computer, where those of one address are read before those of the other."""
    send, reports, first = two(link, clock, 300)
    for _ in range(3):
        clock.now += 1.5
        first.mav.attitude_send(90_200, 0, 0, 0, 0, 0, 0)
        send.beat()
        first.mav.attitude_send(int(1e3 * (clock.now - 10)), 0, 0, 0, 0, 0, 0)
        send.beat()
    assert "several autopilots" not in [facts.get("are") for _, facts in reports]


def test_an_autopilot_that_restarts_is_the_same_on_an_old_and_a_new_link(link, clock):
    send, reports = braking()
    for places, seconds in (((2, 3), 100), ((2, 4), 8)):
        pilots = [Pilot(link, place=("127.0.0.1", port)) for port in places]
        for number in range(10 * seconds):
            clock.now += 0.1
            for pilot in pilots:
                pilot.heartbeat()
                pilot.mav.attitude_send(100 * number, 0, 0, 0, 0, 0, 0)
            send.beat()
    assert reports[-1][1]["are"] == "links of one autopilot"
    send(answer(True, event="begin", captured_s=clock.now))
    assert commands(link)


def test_two_autopilots_with_one_number_are_not_commanded(link, clock):
    """Until one of them has been silent for 5 s."""
    send, reports, first = two(link, clock, 5_000)
    assert reports[1][1]["are"] == "several autopilots" and not commands(link)
    assert told(reports) == [("brake-withheld", {"why": "several autopilots of system 1"})]
    for number in range(80):
        clock.now += 0.1
        first.heartbeat()
        if number == 49:  # until then, both are asked for their clocks
            assert not commands(link)
            link.sent_to.clear()
        send(answer(True, captured_s=clock.now))
    assert len(commands(link)) == 10  # it does not answer
    assert {place for kind, place in link.sent_to if kind == "COMMAND_LONG"} == {COPTERS[0]}


def test_another_address_becomes_the_autopilot_after_five_seconds(link, clock):
    send, reports = braking()
    first, second = (Pilot(link, place=place) for place in COPTERS)
    first.heartbeat()
    for number in range(60):
        second.heartbeat(STABILIZE)
        send.beat()
        clock.now += 0.1
        if number in (28, 49):
            assert reports[-1][1].get("mode", "") == ("GUIDED" if number == 28 else "")
    assert reports[-1] == ("autopilot", {"heard": True, "mode": "STABILIZE", "armed": True})


def test_another_system_is_a_hint(link, clock, caplog):
    send, _ = braking()
    for number in (7, 9):
        Pilot(link, source=(number, 1)).heartbeat()
        send.beat()
    text = "mavlink: an autopilot of system 7 is heard; mavlink_system says which one to command"
    assert caplog.messages == [text]


# Links and options.


def test_mavlink_addresses():
    with pytest.raises(ValueError, match="only udp://, udpin://, tcp:// and serial://"):
        links.open_link("http://a:5")
    assert links.serial_place("/dev/ttyACM0:115200") == ("/dev/ttyACM0", 115200)
    assert links.serial_place("/dev/ttyS1") == ("/dev/ttyS1", 57600)


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_a_serial_port_that_goes_comes_back(tmp_path, caplog, capfd, monkeypatch):
    """A pseudo-terminal that closes, and returns later under the same name."""
    pytest.importorskip("serial", reason="pyserial is not installed")
    monkeypatch.setattr(links, "AGAIN_S", 0.02)
    port = tmp_path / "ttyACM0"

    def plugged():
        ours, theirs = os.openpty()
        tty.setraw(theirs)
        port.unlink(missing_ok=True)
        port.symlink_to(os.ttyname(theirs))
        return ours, theirs

    def texts(ours, told):
        decoder, found = names.MAVLink(None), []
        decoder.robust_parsing = True
        send(told)
        while not found and select.select([ours], [], [], SOON_S)[0]:
            for message in decoder.parse_buffer(os.read(ours, 4096)) or ():
                found += [message.text] if message.get_type() == "STATUSTEXT" else []
        return found

    ours, theirs = plugged()
    send = mavlink.Mavlink(f"serial://{port}:57600", Reports())
    assert texts(ours, answer(event="sees", is_of_frame=False)) == ["dlgmd: recovered"]
    os.close(theirs)
    os.close(ours)
    port.unlink()
    for _ in range(5):
        send(answer(event="sees", is_of_frame=False))
        time.sleep(0.01)
    ours, theirs = plugged()
    time.sleep(0.03)
    assert texts(ours, answer(event="end", is_of_frame=False)) == ["dlgmd: collision alarm over"]
    send.close()
    os.close(theirs)
    os.close(ours)
    lost, back = caplog.messages
    assert f"{port} is lost" in lost and lost.endswith("trying again") and "is back" in back
    assert capfd.readouterr().out == ""  # nothing but JSON is ever on stdout


@pytest.mark.parametrize("scheme", ["tcp:", "tcp://"])
def test_a_tcp_connection_that_ends_is_made_again(monkeypatch, caplog, scheme):
    monkeypatch.setattr(links, "AGAIN_S", 0.02)
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = links.open_link(f"{scheme}127.0.0.1:{server.getsockname()[1]}")
        got = []
        for _ in range(2):
            until(lambda: link.write(b"here", []) or select.select([server], [], [], 0.03)[0])
            caplog.clear()
            with server.accept()[0] as other:
                other.sendall(b"there")
                until(lambda: got.append([*link.read()]) or got[-1])
                link.write(b"here", [])
                assert got[-1] == [((), b"there")] and other.recv(4) == b"here"
            until(lambda: [*link.read()] or "is lost" in caplog.text)
        link.close()
    with pytest.raises(ParameterError, match="is not HOST:PORT"):
        links.open_link("tcp:here")


def test_the_socket_that_listens_answers_who_sends():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        other.settimeout(SOON_S)
        port = free_port()
        link = links.open_link(f"udpin://{port}")  # of this machine alone
        assert link._socket.getsockname() == ("127.0.0.1", port)
        link.write(b"nobody is there yet", [])
        assert [*link.read()] == []
        other.sendto(b"here", ("127.0.0.1", port))
        got = []
        until(lambda: got.append([*link.read()]) or got[-1])
        link.write(b"there", [other.getsockname()])
        assert got[-1] == [(other.getsockname(), b"here")] and other.recv(99) == b"there"
        with pytest.raises(ParameterError, match=r"cannot be opened .*in use"):
            mavlink.Mavlink(f"udpin://127.0.0.1:{port}", Reports())
        link.close()


def test_the_modes_that_brake_are_names():
    assert braking_modes(None) == [] and braking_modes("brake, Alt_Hold") == ["BRAKE", "ALT_HOLD"]
    for text, why in (("GUIDET", "no mode 'GUIDET'. Did you mean GUIDED"), ("4,", "no mode ''")):
        with pytest.raises(ParameterError, match=why):
            known_modes(text)
    with pytest.raises(
        ParameterError, match=r"GUIDED does not brake\. Choose from BRAKE, HOLD, LOIT"
    ):
        braking_modes("BRAKE,GUIDED")
    with pytest.raises(ParameterError, match="17 is no name"):
        braking_modes("BRAKE,17")
    with pytest.raises(ParameterError, match=r"no mode 'BRAKES'\. Did you mean BRAKE\?"):
        braking_modes("BRAKES")
