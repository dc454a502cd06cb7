"""Sends a video at its own pace, again and again: `python streamer.py FILE URL [STALL_S]`.

The URL is udp://, rtp://, http:// or rtsp://; to the latter two, one client may come. With STALL_S,
nothing is sent for so long at the end of each second, and then all that waited: nothing is lost.
"""

import socket
import struct
import sys
import time
from contextlib import suppress
from fractions import Fraction
from urllib.parse import urlsplit

import av

TIMES = 100
CHUNK = 7 * 188
SDP = "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=x\r\nt=0 0\r\nm=video 0 RTP/AVP 33\r\na=control:t\r\n"


class Link:
    """Where the muxer writes to, piece by piece; holds pieces back while the link stalls."""

    def __init__(self, send, stall_s):
        self._send, self._stall_s, self._begin_s = send, stall_s, time.monotonic()
        self._waiting = b""

    def write(self, data):
        """Take what the muxer writes."""
        self._waiting += data
        return len(data)

    def push(self, *, last=False):
        """Send what waits, unless the link stalls."""
        if (time.monotonic() - self._begin_s) % 1.0 < 1.0 - self._stall_s or last:
            while len(self._waiting) >= CHUNK or (last and self._waiting):
                self._send(self._waiting[:CHUNK])
                self._waiting = self._waiting[CHUNK:]


def over_udp(place):
    """Datagrams."""
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    return lambda data: sender.sendto(data, place)


def over_http(place):
    """The body of an answer."""
    client = socket.create_server(place).accept()[0]
    client.recv(4096)
    client.sendall(b"HTTP/1.0 200 OK\r\nContent-Type: video/mp2t\r\n\r\n")
    return client.sendall


def over_rtsp(place):
    """RTP within the connection, after the handshake."""
    client, number = socket.create_server(place).accept()[0], 0
    while True:
        asked = client.recv(4096).decode()
        method, seq = asked.split()[0], asked.split("CSeq:")[1].split()[0]
        more, body = "", SDP if method == "DESCRIBE" else ""
        if method == "DESCRIBE":
            more = f"Content-Type: application/sdp\r\nContent-Length: {len(SDP)}\r\n"
        elif method == "SETUP":
            more = "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n"
        elif method == "OPTIONS":
            more = "Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN\r\n"
        head = f"RTSP/1.0 200 OK\r\nCSeq: {seq}\r\nSession: 1\r\n{more}\r\n"
        client.sendall((head + body).encode())
        if method == "PLAY":
            break

    def send(data):
        nonlocal number
        ticks = int(time.monotonic() * 90_000) % 2**32
        packet = struct.pack("!BBHII", 0x80, 33, number % 2**16, ticks, 1) + data
        client.sendall(struct.pack("!BBH", 0x24, 0, len(packet)) + packet)
        number += 1

    return send


def main(path, url, stall_s="0"):
    parts = urlsplit(url)
    if parts.scheme == "rtp":  # FFmpeg sends by itself
        opened, link = av.open(url, "w", format="rtp"), None
    else:
        over = {"udp": over_udp, "http": over_http, "rtsp": over_rtsp}[parts.scheme]
        link = Link(over((parts.hostname, parts.port)), float(stall_s))
        opened = av.open(link, "w", format="mpegts")
    with opened as target:
        stream = None
        begin, sent = time.monotonic(), 0
        for _ in range(TIMES):
            with av.open(path) as source:
                for frame in source.decode(video=0):
                    if stream is None:
                        stream = target.add_stream("libx264", rate=30)
                        stream.width, stream.height = frame.width, frame.height
                        stream.pix_fmt = "yuv420p"
                        stream.options = {"preset": "ultrafast", "tune": "zerolatency", "g": "15"}
                    frame.pts, frame.time_base = sent, Fraction(1, 30)
                    time.sleep(max(0.0, begin + sent / 30 - time.monotonic()))
                    target.mux(stream.encode(frame))
                    if link is not None:
                        link.push()
                    sent += 1


if __name__ == "__main__":
    with suppress(OSError):  # the client has gone
        main(*sys.argv[1:])
