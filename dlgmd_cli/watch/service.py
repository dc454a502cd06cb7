"""Messages to systemd (`Type=notify`): that the watch is ready, that it is alive, what it does."""

import math
import os
import socket
import time
from contextlib import suppress

from dlgmd_cli.watch.statistics import Statistics
from dlgmd_cli.watch.watch import LOST, Answer

# A status is sent once in _STATUS_S seconds; signs of life a few times per WatchdogSec.
_STATUS_S, _SIGNS = 2.0, 4


class Service:
    """Tells systemd about the watch; does nothing unless systemd asks for it.

    ``READY=1`` follows the first answer to a frame. ``WATCHDOG=1`` follows answers to frames; while
    the source is silent, and the event `blind` has said so, it goes on without. If the loop hangs,
    it ceases, and systemd starts the program again.

    Parameters
    ----------
    statistics : Statistics
        The numbers for the status, which get each answer before.
    """

    def __init__(self, statistics: Statistics) -> None:
        place = os.environ.get("NOTIFY_SOCKET", "")
        # A name that begins with @ is in the abstract namespace.
        self._place = "\0" + place[1:] if place.startswith("@") else place
        self._statistics, self._is_ready, self._is_silent = statistics, False, False
        self._sent_s, self._status_s = -math.inf, -math.inf
        self._pause_s = int(os.environ.get("WATCHDOG_USEC") or 0) / 1e6 / _SIGNS

    def put(self, answer: Answer | None) -> None:
        """Process an answer or event of the watch, or None: a while without a frame."""
        if not self._place:
            return
        if answer is not None:
            self._is_silent = answer.reason == LOST
        if not (answer.is_of_frame if answer is not None else self._is_silent):
            return
        if not self._is_ready and not self._is_silent:
            self._is_ready = True
            self._send("READY=1")
        now_s = time.monotonic()
        if self._is_ready and now_s - self._sent_s >= self._pause_s:
            self._sent_s = now_s
            self._send("WATCHDOG=1")
        if now_s - self._status_s >= _STATUS_S:
            self._status_s = now_s
            self._send(f"STATUS={self._status()}")

    def close(self) -> None:
        """Tell that the watch ends."""
        if self._place:
            self._send("STOPPING=1")

    def _status(self) -> str:
        statistics = self._statistics
        reason = "" if statistics.newest is None else statistics.newest.reason
        if reason:
            return f"blind: {reason}"
        # The first answer alone has no rate.
        rate = f"{statistics.fps:.1f} frames/s" if statistics.n_frames > 1 else ""
        parts = rate, f"{statistics.n_alarms} alarms", statistics.busy
        return ", ".join(filter(None, parts))

    def _send(self, text: str) -> None:
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.setblocking(False)
            sender.sendto(text.encode(), self._place)
