"""Connections for MAVLink: a UDP socket, which knows the senders' addresses, a serial port, TCP."""

import logging
import math
import select
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any

from dlgmd_cli.errors import MissingExtraError, argument
from dlgmd_cli.watch.outputs import datagram_socket, split_address

_log = logging.getLogger(__name__)

# The address of a sender; a serial port has a single place.
Address = tuple[Any, ...]
_AT_THE_PORT: Address = ()
# Pause (s) before a lost serial port is opened again.
AGAIN_S = 1.0


class SocketLink:
    """Datagrams to ``HOST:PORT``, or to the heard senders; raises OSError, ValueError."""

    def __init__(self, place: str, *, listens: bool) -> None:
        host, port = split_address(place, argument("mavlink"), "127.0.0.1" if listens else None)
        self._socket, self._target = datagram_socket(host, port)
        self._listens = listens
        self._socket.setblocking(False)
        self.close = self._socket.close
        if listens:
            try:
                self._socket.bind(self._target)
            except OSError:
                self.close()
                raise

    def write(self, data: bytes, places: Iterable[Address]) -> None:
        """Send a message to the target; if the link listens, to `places` instead."""
        if not self._listens:
            self._socket.sendto(data, self._target)
            return
        for place in places:
            with suppress(OSError):  # a lost receiver must not keep the message from the others
                self._socket.sendto(data, place)

    def read(self) -> Iterator[tuple[Address, bytes]]:
        """The datagrams that have come, each with its place."""
        while True:
            try:
                data, place = self._socket.recvfrom(4096)
            except ConnectionError:  # a receiver of an earlier message does not listen
                continue
            except OSError:  # no further datagram
                return
            yield place, data


class TcpPort:
    """A TCP connection with the methods of a serial port; raises OSError."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), timeout=1.0)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, True)
        self.write, self.close = self._socket.sendall, self._socket.close

    def read(self, n_bytes: int) -> bytes:
        """The bytes that have come, at most so many."""
        if not select.select([self._socket], [], [], 0.0)[0]:
            return b""
        if not (data := self._socket.recv(n_bytes)):
            raise ConnectionError("it was closed")
        return data


class PortLink:
    """A serial port or a TCP connection, opened again after a loss; raises OSError at first.

    A message that cannot be written is dropped. The loss and the return of the port are logged as
    warnings.
    """

    def __init__(self, device: str, opened: Callable[[], Any], too_slow: type[Exception]) -> None:
        self._device, self._open, self._too_slow = device, opened, too_slow
        self._port = self._open()
        self._tried_s = -math.inf

    def write(self, data: bytes, places: Iterable[Address]) -> None:
        """Write a message to the port; `places` is ignored."""
        if self._port is None and not self._is_back():
            return
        try:
            self._port.write(bytes(data))
        except self._too_slow:
            raise TimeoutError(f"{self._device} takes nothing") from None
        except OSError as error:  # also the base of pyserial's exceptions
            self._lose(error)

    def read(self) -> Iterator[tuple[Address, bytes]]:
        """The bytes that have come."""
        try:
            data = b"" if self._port is None else self._port.read(1 << 16)
        except OSError as error:
            self._lose(error)
            return
        if data:
            yield _AT_THE_PORT, data

    def close(self) -> None:
        """Free the port."""
        port, self._port = self._port, None
        if port is not None:
            with suppress(OSError):
                port.close()

    def _lose(self, error: OSError) -> None:
        _log.warning("%s: %s is lost (%s); trying again", argument("mavlink"), self._device, error)
        self.close()

    def _is_back(self) -> bool:
        """Try to open the port again, once a second."""
        if time.monotonic() - self._tried_s < AGAIN_S:
            return False
        self._tried_s = time.monotonic()
        try:
            self._port = self._open()
        except OSError:
            return False
        _log.warning("%s: %s is back", argument("mavlink"), self._device)
        return True


def open_link(url: str) -> SocketLink | PortLink:
    """The link for a URL; raises ValueError or OSError."""
    scheme, _, place = url.partition(":")
    place = place.removeprefix("//")
    if scheme in ("udp", "udpin"):
        return SocketLink(place, listens=scheme == "udpin")
    if scheme == "tcp":
        opened = partial(TcpPort, *split_address(place, argument("mavlink")))
        return PortLink(place, opened, TimeoutError)
    if scheme != "serial":
        raise ValueError("only udp://, udpin://, tcp:// and serial:// are links")
    try:
        import serial
    except ImportError:
        raise MissingExtraError.of(argument("mavlink"), "pyserial") from None
    device, baud = serial_place(place)
    opened = partial(serial.Serial, device, baud, timeout=0.0, write_timeout=1.0)
    return PortLink(device, opened, serial.SerialTimeoutException)


def serial_place(place: str) -> tuple[str, int]:
    """``/dev/ttyACM0:57600`` as a device and a baud rate, 57600 unless given."""
    device, _, baud = place.rpartition(":")
    return (device, int(baud)) if device else (place, 57600)
