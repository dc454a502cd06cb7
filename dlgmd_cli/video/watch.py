"""Watching the packets for a change of the picture size, because OpenCV hides it.

OpenCV scales or garbles what follows a change to the size it saw first, and says nothing. The
packets, which it hands out undecoded to a second capture, do tell.
"""

import math
from collections.abc import Generator
from typing import NamedTuple

import cv2

from dlgmd_cli.video.coded_size import KEYED, READERS, Header, canonical, coded_size, read_header
from dlgmd_cli.video.ffmpeg import guarded
from dlgmd_cli.video.frames import GRABS_PAST_DAMAGE, MAX_PLAUSIBLE_TIME_S
from dlgmd_cli.video.h26x import Size


class _Packet(NamedTuple):
    """A packet's header, and its timestamp in seconds or NaN."""

    header: Header
    stamp_s: float


class ResolutionWatch:
    """Tells when the coded size of a video changes, in step with another capture that decodes it.

    A file that gives nothing to watch counts as one that never changes.

    Parameters
    ----------
    path : str
        A name that OpenCV can open; it is opened with the first question.
    """

    def __init__(self, path: str) -> None:
        self._packets = _packets(path)
        self._first: Size | None = None
        self._changed: Size | None = None
        self._n_frames = 0
        self._n_shown = 0
        self._reached_s = -math.inf

    def size_of_next(self, stamp_s: float = math.nan) -> Size | None:
        """Go on to the next decoded frame and tell whether it has another size than the first.

        Parameters
        ----------
        stamp_s : float, optional
            The frame's timestamp in seconds as the decoding capture gives it, NaN for none. It
            keeps the two in step where packets do not lead to a frame.

        Returns
        -------
        (int, int) or None
            Width and height in px from the change on, else None.

        Notes
        -----
        Frames shown before a change come from packets before it. So a frame has the size that was
        announced last when as many packets as frames were read, and one as late as the frame.
        """
        self._n_frames += 1
        while self._n_shown < self._n_frames or self._reached_s < stamp_s:
            packet = None if self._changed else next(self._packets, None)
            if packet is None:
                break
            size, n_shown = packet.header
            self._n_shown += 1 if n_shown is None else n_shown
            if math.isnan(packet.stamp_s):
                stamp_s = math.nan
            else:
                self._reached_s = max(self._reached_s, packet.stamp_s)
            if size is not None:
                self._first = self._first or size
                self._changed = size if size != self._first else None
        return self._changed

    def close(self) -> None:
        """Free the file; may be called twice."""
        self._packets.close()


def count_packets(path: str) -> int | None:
    """Number of frames that a video holds, whether they can be decoded or not.

    Parameters
    ----------
    path : str
        A name that OpenCV can open. The whole file is read, but not decoded.

    Returns
    -------
    int or None
        Packets that show a frame, counted from where decoding can begin; None where packets
        cannot be had or are not one to a frame.
    """
    total = 0
    for packet in _packets(path):
        if packet.header.n_shown is None:
            return None
        total += packet.header.n_shown
    return total or None


def _packets(path: str) -> Generator[_Packet, None, None]:
    """The packets of the video stream in the order of decoding, none where they cannot be had."""
    # Asked for at once, not as a property later, it spares a decoder and its threads.
    with guarded():
        capture = cv2.VideoCapture(path, cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    try:
        if capture.get(cv2.CAP_PROP_FORMAT) != -1:
            return
        fourcc = int(capture.get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF
        codec = canonical(fourcc.to_bytes(4, "little").decode("latin-1"))
        if codec == "mp4v":  # some containers hold its header once, outside the packets
            extra = _payload(capture, int(capture.get(cv2.CAP_PROP_CODEC_EXTRADATA_INDEX)))
            yield _Packet(Header(coded_size(codec, extra), 0), math.nan)
        has_started = codec not in KEYED
        n_failed = 0
        while n_failed < GRABS_PAST_DAMAGE:
            if not capture.grab():
                n_failed += 1
                continue
            n_failed = 0
            is_key = capture.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME) != 0
            has_started = has_started or is_key
            if codec in READERS and (is_key or codec not in KEYED):
                header = read_header(codec, _payload(capture))
            else:
                header = Header(n_shown=int(has_started))
            stamp_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            # OpenCV says 0 for "none", and something astronomic where a stream has no start.
            has_stamp = 0.0 < abs(stamp_s) < MAX_PLAUSIBLE_TIME_S
            yield _Packet(header, stamp_s if has_stamp else math.nan)
    finally:
        capture.release()


def _payload(capture: cv2.VideoCapture, index: int = 0) -> bytes:
    """The packet grabbed last, or what else OpenCV keeps at `index`; empty if that fails."""
    try:
        is_there, data = capture.retrieve(None, index)
    except cv2.error:
        return b""
    return data.tobytes() if is_there and data is not None else b""
