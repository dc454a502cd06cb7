"""MAVLink of `dlgmd live`: what is sent, what is read, and when the autopilot is told to brake."""

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
from click.testing import CliRunner
from conftest import free_port, until

from dlgmd_cli import Alarm
from dlgmd_cli.errors import MissingExtraError, ParameterError
from dlgmd_cli.frame import Frame
from dlgmd_cli.live import mavlink, outputs
from dlgmd_cli.live.watch import Answer, Reports

names = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
SOON_S = 5.0
COPTER, PLANE, PX4, ARDUPILOT = 2, 1, 12, 3
GUIDED, STABILIZE, BRAKE, MISSION, HOLD = 4, 0, 17, 4 << 16 | 4 << 24, 4 << 16 | 3 << 24
UNDEFINED = Alarm().step(np.zeros((9, 9), np.uint8))


class FakeLink:
    """A link of bytes to read, and messages that were written."""

    def __init__(self):
        self.inbox, self.written, self._parser = b"", [], names.MAVLink(None)

    def write(self, data):
        self.written += self._parser.parse_buffer(bytes(data))

    def read(self):
        data, self.inbox = self.inbox, b""
        return data

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
    monkeypatch.setattr(mavlink, "_link", lambda url: link)
    return link


class Pilot:
    """Writes the messages of an autopilot to a link."""

    def __init__(self, link, kind=COPTER, pilot=ARDUPILOT, source=(1, 1)):
        self.link, self.kind, self.pilot = link, kind, pilot
        self.mav = names.MAVLink(SimpleNamespace(write=self.put), *source)

    def put(self, data):
        self.link.inbox += bytes(data)

    def heartbeat(self, mode=GUIDED, armed=True, custom=True):
        flags = (128 if armed else 0) | (1 if custom else 0)
        self.mav.heartbeat_send(self.kind, self.pilot, flags, mode, 4)


def answer(alarm=False, *, event="", reason="", is_of_frame=True, captured_s=100.0, **found):
    detection = replace(UNDEFINED, mp=1.0, mp_abs=0.5, alarm=alarm, **found)
    frame = Frame(3, 0.1, np.zeros((9, 9)), captured_s=captured_s)
    latency_ms = 1.5 if is_of_frame else math.nan
    return Answer(frame, detection, event=event, latency_ms=latency_ms, reason=reason)


BEGIN = answer(True, event="begin", rule="ttc")


def braking(modes="GUIDED", **more):
    reports = Reports()
    send = mavlink.Mavlink("udp://x:1", reports, modes=mavlink.known_modes(modes), **more)
    return send, reports


def told(reports):
    """The reports so far, without those of the autopilot's state."""
    found = [(event, {**facts}) for event, facts in reports if event != "autopilot"]
    reports.clear()
    return found


def commands(link):
    return [
        (one.command, one.confirmation, int(one.param1), int(one.param2), int(one.param3))
        for one in link.of("COMMAND_LONG")
    ]


# What is sent.


def test_what_a_flight_sends(link, clock):
    send = mavlink.Mavlink("udp://x:1", Reports(), system=7, component=42)
    spike = answer(spike=True, ttc_s=0.7)
    for one in (answer(), spike, BEGIN, answer(), answer(event="end")):
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
        *((2, "dlgmd: collision alarm (ttc)"), (5, "dlgmd: collision alarm over")),
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
    monkeypatch.setattr(mavlink, "_HEARTBEAT_S", 0.02)
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
    send.beat()
    pilot.heartbeat()
    send.beat()
    send.beat()
    pilot.heartbeat(STABILIZE, armed=False)
    send.beat()
    clock.now += 2.1
    send.beat()
    assert [*reports] == [
        ("autopilot", {"heard": False}),
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
        ("brake-withheld", {"why": "Mode(4000000000) is not one of the modes"})
    ]
    pilot.heartbeat()
    send(BEGIN)
    assert commands(link) == [(176, 0, 129, BRAKE, 0)]


# The command.


@pytest.mark.parametrize(
    ("kind", "pilot", "mode", "modes", "numbers"),
    [
        (COPTER, ARDUPILOT, GUIDED, "auto, guided", (BRAKE, 0)),
        (COPTER, ARDUPILOT, GUIDED, "4", (BRAKE, 0)),
        (10, ARDUPILOT, 10, "AUTO", (4, 0)),  # a rover
        (COPTER, PX4, MISSION, "MISSION", (4, 3)),
        (COPTER, PX4, MISSION, str(MISSION), (4, 3)),
    ],
)
def test_an_alarm_brakes(link, clock, kind, pilot, mode, modes, numbers):
    """Once; it is accepted, and the end of the alarm releases nothing."""
    send, reports = braking(modes)
    pilot = Pilot(link, kind, pilot)
    pilot.heartbeat(mode)
    send(answer())
    send(BEGIN)
    assert commands(link) == [(176, 0, 128 | 1, *numbers)]
    (sent,) = link.of("COMMAND_LONG")
    assert (sent.target_system, sent.target_component) == (1, 1)
    pilot.mav.command_ack_send(names.MAV_CMD_DO_SET_MODE, 0)
    for _ in range(40):
        clock.now += 0.1
        send(answer(True, captured_s=clock.now))
    send(answer(event="end"))
    assert len(commands(link)) == 1
    (brake, first), (event, facts) = told(reports)
    assert (brake, first["number"]) == ("brake", 1)
    assert (event, facts) == ("brake-answer", {"result": "ACCEPTED", "number": 1})


@pytest.mark.parametrize(
    ("heartbeat", "found", "why"),
    [
        (None, BEGIN, "no heartbeat of the autopilot within 2 s"),
        ({"armed": False}, BEGIN, "not armed"),
        ({"mode": STABILIZE}, BEGIN, "STABILIZE is not one of the modes"),
        ({"custom": False}, BEGIN, "Mode(0x00000080) is not one of the modes"),
        ({"mode": BRAKE}, BEGIN, "BRAKE already"),
        ({}, answer(True, event="begin", reason="frozen"), "blind, frozen"),
        ({}, answer(True, event="begin", captured_s=98.9), "the alarm is more than 1 s old"),
    ],
)
def test_when_an_alarm_does_not_brake(link, clock, heartbeat, found, why):
    send, reports = braking("GUIDED,BRAKE,0")
    if heartbeat is not None:
        Pilot(link).heartbeat(**heartbeat)
    if heartbeat == {"mode": STABILIZE}:
        send, reports = braking()
    send(found)
    assert told(reports) == [("brake-withheld", {"why": why})] and not commands(link)


def test_a_heartbeat_counts_for_two_seconds(link, clock):
    for age_s, n_sent in ((1.9, 1), (2.1, 0)):
        link.written.clear()
        send, _ = braking()
        Pilot(link).heartbeat()
        send.beat()
        clock.now += age_s
        send(answer(True, event="begin", captured_s=clock.now))
        assert len(commands(link)) == n_sent


def test_a_plane_has_nothing_to_brake_with(link, clock):
    for pilot, mode, modes in ((ARDUPILOT, 15, "GUIDED"), (PX4, MISSION, "MISSION")):
        send, reports = braking(modes)
        Pilot(link, PLANE, pilot).heartbeat(mode)
        send(BEGIN)
        assert told(reports)[0][1]["why"] == "no braking mode of this vehicle is known"
    assert not commands(link)


@pytest.mark.parametrize("result", [None, names.MAV_RESULT_DENIED, names.MAV_RESULT_FAILED])
def test_a_command_is_tried_three_times(link, clock, caplog, result):
    """Half a second after the one before, with the number of the try, whatever the answer."""
    send, reports = braking()
    pilot, sent_s, n_sent = Pilot(link), [], 0
    pilot.heartbeat()
    send(BEGIN)
    for _ in range(100):
        if len(commands(link)) > n_sent:
            n_sent += 1
            sent_s.append(clock.now)
            if result is not None:
                pilot.mav.command_ack_send(names.MAV_CMD_DO_SET_MODE, result)
        clock.now += 0.05
        pilot.heartbeat()
        send.beat()
    assert [confirmation for _, confirmation, *_ in commands(link)] == [0, 1, 2]
    assert np.diff(sent_s) == pytest.approx([0.5, 0.5], abs=0.06)
    answers = [facts for event, facts in told(reports) if event == "brake-answer"]
    name = {None: "none", 2: "DENIED", 4: "FAILED"}[result]
    assert answers == [{"result": name, "number": n} for n in (1, 2, 3)]
    assert caplog.messages == ["mavlink: the autopilot has not accepted 3 commands"]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda send, pilot: pilot.heartbeat(armed=False), "not armed"),
        (lambda send, pilot: pilot.heartbeat(STABILIZE), "STABILIZE is not one of the modes"),
        (lambda send, pilot: pilot.heartbeat(BRAKE), "BRAKE already"),
        (lambda send, pilot: send(answer(event="blind", reason="black")), "blind, black"),
    ],
)
def test_a_command_is_not_tried_again_if_all_has_changed(link, clock, change, why):
    send, reports = braking()
    pilot = Pilot(link)
    pilot.heartbeat()
    send(BEGIN)
    change(send, pilot)
    clock.now += 0.6
    send.beat()
    clock.now += 5.0
    send.beat()
    assert len(commands(link)) == 1
    assert told(reports)[-1] == ("brake-withheld", {"why": why})


def test_commands_are_two_seconds_apart(link, clock):
    """The pilot has taken over and gone on; a new alarm comes at once."""
    send, reports = braking()
    pilot, n_sent = Pilot(link), []
    for pause_s in (0.0, 1.0, 1.1):
        clock.now += pause_s
        pilot.heartbeat()
        send(answer(True, event="begin", captured_s=clock.now))
        pilot.mav.command_ack_send(names.MAV_CMD_DO_SET_MODE, 0)
        send.beat()
        n_sent.append(len(commands(link)))
    assert n_sent == [1, 1, 2]
    withheld = [facts["why"] for event, facts in told(reports) if event == "brake-withheld"]
    assert withheld == ["the last command is less than 2 s old"]


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


# Links and options.


def test_mavlink_addresses():
    with pytest.raises(ValueError, match="only udp://, udpin:// and serial://"):
        mavlink._link("tcp://a:5")
    assert mavlink.serial_place("/dev/ttyACM0:115200") == ("/dev/ttyACM0", 115200)
    assert mavlink.serial_place("/dev/ttyS1") == ("/dev/ttyS1", 57600)


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_a_serial_port_that_goes_comes_back(tmp_path, caplog, capfd, monkeypatch):
    """A pseudo-terminal that closes, and returns later under the same name."""
    pytest.importorskip("serial", reason="pyserial is not installed")
    monkeypatch.setattr(mavlink, "_AGAIN_S", 0.02)
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


def test_mavlink_needs_its_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "pymavlink", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'dlgmd\[live\]'"):
        mavlink.Mavlink("udp://127.0.0.1:1", Reports())


def test_the_socket_that_listens_answers_who_sends():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        other.settimeout(SOON_S)
        port = free_port()
        link = mavlink._link(f"udpin://127.0.0.1:{port}")
        link.write(b"nobody is there yet")
        assert link.read() == b""
        other.sendto(b"here", ("127.0.0.1", port))
        got = []
        until(lambda: got.append(link.read()) or got[-1])
        link.write(b"there")
        assert got[-1] == b"here" and other.recv(99) == b"there"
        with pytest.raises(ParameterError, match=r"cannot be opened .*in use"):
            mavlink.Mavlink(f"udpin://127.0.0.1:{port}", Reports())
        link.close()


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (("--mavlink-brake",), "--mavlink-brake works only with --mavlink and --mavlink-modes"),
        (("--mavlink-modes", "GUIDED"), "--mavlink-modes works only with --mavlink-brake"),
        (("--mavlink-brake", "--mavlink-modes", "GUIDET"), "no mode 'GUIDET'. Did you mean GUIDED"),
        (("--mavlink-brake", "--mavlink-modes", ""), "works only with"),
        (("--mavlink-brake", "--mavlink-modes", "4,"), "there is no mode ''"),
        (("--mavlink-component", "1"), "--mavlink-component"),
        (("--speed-m-s", "autopilot", "--set", "9"), "works only with the rule ttc"),
        (("--speed-m-s", "autopilot", "--record", "x"), "a result has one ttc_alarm"),
        (("--speed-m-s", "0"), "Invalid value for '--speed-m-s'"),
        (("--speed-m-s", "autopilot"), "autopilot works only with --mavlink"),
    ],
)
def test_options(arguments, why):
    from dlgmd_cli.commands.app import cli

    link = () if "works only with --mavlink" in why else ("--mavlink", "udp://127.0.0.1:9")
    result = CliRunner().invoke(cli, ["live", "0", *link, *arguments], prog_name="dlgmd")
    assert result.exit_code == 2 and why in result.stderr, result.output
