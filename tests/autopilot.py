"""A stand-in for an autopilot, by pymavlink: `python autopilot.py KIND LINK`.

KIND is copter or px4. LINK is a UDP port to listen at, udpout:PORT to send to, or pty, whose name
is the first line of stdout. Lines of stdin change it: `arm`, `mode NAME`, `refuse`, `speed M/S`,
`pitch DEG` (from then on it sends its attitude). ArduCopter's parameter PSC_JERK_XY is 20.
Each message of interest that comes is a line of stdout: the log.
"""

import math
import os
import select
import socket
import sys
import time
import tty

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as names

START_S = time.monotonic()
KINDS = {
    "copter": (names.MAV_TYPE_QUADROTOR, names.MAV_AUTOPILOT_ARDUPILOTMEGA),
    "px4": (names.MAV_TYPE_QUADROTOR, names.MAV_AUTOPILOT_PX4),
}


class Udp:
    """Answers whoever sends, or sends to a port."""

    def __init__(self, place):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        port = int(place.rpartition(":")[2])
        self._place = ("127.0.0.1", port) if ":" in place else None
        if self._place is None:
            self._socket.bind(("127.0.0.1", port))
        self.fileno = self._socket.fileno

    def write(self, data):
        if self._place is not None:
            self._socket.sendto(data, self._place)

    def read(self):
        data, self._place = self._socket.recvfrom(4096)
        return data


class Pty:
    """A pseudo-terminal, whose name is printed."""

    def __init__(self):
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        print(os.ttyname(self._theirs), flush=True)

    def fileno(self):
        return self._ours

    def write(self, data):
        os.write(self._ours, data)

    def read(self):
        return os.read(self._ours, 4096)


class Autopilot:
    """Its state, and what it sends and answers."""

    def __init__(self, kind, link):
        self.kind, self.pilot = KINDS[kind]
        self.link, self.mav = link, names.MAVLink(link, 1, 1)
        self.mav.robust_parsing = True
        self.armed, self.result = False, 0
        self.speed_m_s, self.pitch_deg, self.beat_s, self.seen = None, None, 0.0, set()
        self.set_mode("GUIDED" if kind != "px4" else "MISSION")

    def set_mode(self, name):
        if self.pilot == names.MAV_AUTOPILOT_PX4:
            _, main, sub = mavutil.px4_map[name]
            self.number = main << 16 | sub << 24
        else:
            self.number = mavutil.mode_mapping_byname(self.kind)[name]

    def obey(self, line):
        """A line of stdin."""
        word, _, value = line.partition(" ")
        log(f"  -- {line}")
        if word == "arm":
            self.armed = True
        elif word == "mode":
            self.set_mode(value)
        elif word == "refuse":
            self.result = names.MAV_RESULT_DENIED
        elif word == "speed":
            self.speed_m_s = float(value)
        elif word == "pitch":
            self.pitch_deg = float(value)
        self.beat_s = 0.0

    def beat(self):
        """A heartbeat, five a second, and the speed."""
        if time.monotonic() - self.beat_s < 0.2:
            return
        self.beat_s = time.monotonic()
        base = names.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (128 if self.armed else 0)
        self.mav.heartbeat_send(self.kind, self.pilot, base, self.number, 4)
        if self.speed_m_s is not None:
            self.mav.local_position_ned_send(0, 0, 0, 0, 0, self.speed_m_s, 0)
        if self.pitch_deg is not None:  # it flies east, and looks there
            pitch, yaw = math.radians(self.pitch_deg), math.radians(90.0)
            self.mav.attitude_send(0, 0, pitch, yaw, 0, 0, 0)

    def take(self, message):
        """A message that came."""
        kind = message.get_type()
        if kind == "STATUSTEXT":
            log(f"{kind} {message.severity} {message.text}")
        elif kind == "PARAM_REQUEST_READ":
            if message.param_id == "PSC_JERK_XY":
                self.mav.param_value_send(b"PSC_JERK_XY", 20.0, 9, 1, 0)
        elif kind == "COMMAND_LONG":
            if message.command == names.MAV_CMD_REQUEST_MESSAGE:
                self.beat_s = 0.0  # a heartbeat
                return
            if message.command == names.MAV_CMD_SET_MESSAGE_INTERVAL:
                log(f"{kind} 511: message {message.param1:g} every {message.param2:g} us")
                self.mav.command_ack_send(message.command, names.MAV_RESULT_ACCEPTED)
                return
            flags, main, sub = (int(message.param1), int(message.param2), int(message.param3))
            log(f"{kind} {message.command} try {message.confirmation}: {flags} {main} {sub}")
            if self.result == 0:
                is_px4 = self.pilot == names.MAV_AUTOPILOT_PX4
                self.number = main << 16 | sub << 24 if is_px4 else main
            self.mav.command_ack_send(message.command, self.result)
            self.beat_s = 0.0
        else:
            about = {
                "HEARTBEAT": lambda: f"state {message.system_status}",
                "COLLISION": lambda: f"src {message.src} level {message.threat_level}",
                "NAMED_VALUE_FLOAT": lambda: message.name,
            }.get(kind, str)()
            line = f"{kind} {about} from {message.get_srcSystem()}/{message.get_srcComponent()}"
            if line not in self.seen:
                self.seen.add(line)
                log(line)


def log(line):
    print(f"{time.monotonic() - START_S:6.2f} {line}", flush=True)


def main(kind, place):
    link = Pty() if place == "pty" else Udp(place)
    pilot = Autopilot(kind, link)
    while True:
        ready, _, _ = select.select([link, sys.stdin], [], [], 0.02)
        if sys.stdin in ready:
            data = os.read(0, 4096)  # without a buffer, of which `select` knows nothing
            if not data:
                return
            for line in data.decode().split("\n")[:-1]:
                pilot.obey(line)
        if link in ready:
            for message in pilot.mav.parse_buffer(link.read()) or ():
                pilot.take(message)
        pilot.beat()


if __name__ == "__main__":
    main(*sys.argv[1:])
