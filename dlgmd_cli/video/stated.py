"""What a file states of its video, to compare with what is read of it."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2

from dlgmd_cli.frame import Image
from dlgmd_cli.video.base import FALLBACK_FPS, StreamInfo
from dlgmd_cli.video.timestamps import steady_fps

# A matrix is followed if it differs by less than 6 degrees from one that only turns by right angles
# and mirrors.
_SLANT = 0.1


class Orientation(NamedTuple):
    """What makes images upright: swap rows and columns first, then mirror along x or y."""

    swaps: bool = False
    flips_x: bool = False
    flips_y: bool = False

    @classmethod
    def of_matrix(cls, a: int, b: int, c: int, d: int) -> "Orientation":
        """That of a display matrix, by which (x, y) is shown at (a x + c y, b x + d y)."""
        straight, crossed = max(abs(a), abs(d)), max(abs(b), abs(c))
        if crossed <= _SLANT * straight:
            return cls(False, a < 0, d < 0)
        if straight <= _SLANT * crossed:
            return cls(True, c < 0, b < 0)
        return cls()

    @property
    def is_mirrored(self) -> bool:
        """Whether left and right are swapped after turning by `turned_deg`."""
        return (self.flips_x != self.flips_y) != self.swaps

    @property
    def turned_deg(self) -> int:
        """The angle by which images are turned clockwise: 0, 90, 180 or 270."""
        return (270 if self.flips_y else 90) if self.swaps else 180 * self.flips_y

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Width and height of an upright image."""
        return (height, width) if self.swaps else (width, height)

    def upright(self, image: Image) -> Image:
        """An image made upright; the same one if it is already."""
        if self.swaps:
            image = cv2.transpose(image)
        if self.flips_x or self.flips_y:
            image = cv2.flip(image, -1 if self.flips_x and self.flips_y else int(self.flips_x))
        return image


UPRIGHT = Orientation()


# The times of an AVI are those of decoding, with B-frames up to so many frames late.
_MAX_DELAY = 16
# Times are known to half a frame: this rounds to whole ones.
_NEARLY = 0.4


class Stated(NamedTuple):
    """What is stated; NaN for times that are not, in seconds.

    Of Matroska, `begin_s` is the time of the first key frame by the index, and `end_s` that of the
    end of the last frame, on the container's own clock. Of an MP4, `end_s` is the duration that an
    edit list leaves visible. `n_faults` counts the places where packets of a transport stream are
    damaged, or missing by their continuity counters; of others, those where the structure of the
    file is broken or a checksum is wrong. `has_key` says that the first image of an MP4 or a
    transport stream is flagged as a key frame, and `is_default` that no later video of a Matroska
    or an MP4 is the default one. `n_videos` counts the video streams of a Matroska, an MP4, or the
    first 3 MB of a transport stream. `orientation` is that of an MP4. `n_frames` is the number that
    an APNG or an MP4 in fragments states, 0 for others. `is_cut` says that the file ends within a
    frame, a box or a chunk. `n_empty` counts the frames that an AVI leaves out on purpose, and
    `other_fps` is a second rate that it states, if another.
    """

    kind: str = ""
    begin_s: float = math.nan
    end_s: float = math.nan
    n_faults: int = 0
    has_key: bool = False
    is_default: bool = True
    n_videos: int = 1
    orientation: Orientation = UPRIGHT
    n_frames: int = 0
    is_cut: bool = False
    n_empty: int = 0
    other_fps: float = math.nan

    @property
    def is_in_steps(self) -> bool:
        """Whether the times are those of decoding: of an AVI, and of bare MPEG-1 and MPEG-2."""
        return self.kind in ("avi", "mpegvideo")


def choice(n_videos: int, number: int, width: int, height: int) -> str:
    """Which of several video streams is read, in words; empty if there is only one."""
    if n_videos < 2:
        return ""
    what = f"the file has {n_videos} video streams; number {number} is read, the default"
    return f"{what} ({width}x{height})"


def measured(
    info: StreamInfo,
    stated: Stated,
    packets: Sequence[tuple[float, bool]],
    first_s: float,
    start_s: float,
    is_delayed: bool,
) -> StreamInfo:
    """What a stream states of its rate and length, as its first packets and its container have it.

    Parameters
    ----------
    info : StreamInfo
        With the number of frames as FFmpeg has it.
    stated : Stated
        What the container states.
    packets : sequence of (float, bool)
        The time of the first packets in seconds, from that of the first one on, and whether each
        is a key frame. What comes before the first key frame was cut off by purpose.
    first_s : float
        The time of the first frame that is read, in seconds on the same clock.
    start_s : float
        That of the first packet on the container's own clock, to half a frame.
    is_delayed : bool
        Whether times that are those of decoding may be late.
    """
    fps, count = info.fps or FALLBACK_FPS, stated.n_frames or info.n_frames or 0
    if math.isfinite(stated.other_fps):
        what = f"the file states {fps:g} and {stated.other_fps:g} frames/s; {fps:g} are used"
        info = info._replace(remark=what)
    # Of interlaced video, each packet may be a field.
    steady = None if info.is_interlaced else steady_fps(dict(packets))
    if stated.is_in_steps and steady and info.fps:  # its rate may be that of fields, or FFmpeg's
        count, fps = round(count * steady / fps), steady
        info = info._replace(fps=fps)
    # Of two entries a frame, one is empty.
    n_empty = max(0, stated.n_empty - max(0, (info.n_frames or 0) - count))
    rate, key_s = steady or fps, _first_key_s(stated, packets, start_s)
    n_before = int(max(0.0, -key_s) * rate + _NEARLY)
    if stated.kind in ("mkv", "flv"):  # the length counts from 0, wherever the video begins
        end = count if math.isnan(stated.end_s) else round(stated.end_s * fps)
        count = max(0, round(end - max(start_s, 0.0) * fps) + n_before)
    lost_s = first_s - key_s
    n_lost = int(lost_s * rate + _NEARLY) if lost_s > 0.0 else 0
    most_late = n_empty + (_MAX_DELAY if is_delayed else 0)
    # Nothing tells where a bare MPEG video began.
    is_late = stated.kind == "mpegvideo" or (stated.is_in_steps and n_lost <= most_late)
    count -= n_lost if is_late and n_lost > _MAX_DELAY else 0
    if stated.kind == "frames":
        info, steady, count = info._replace(fps=None, assumed_fps=fps), None, 0
    return info._replace(
        n_frames=count or None,
        # An edit list that shows less than a frame is damaged.
        shown_s=stated.end_s if stated.kind == "mp4" and stated.end_s * fps >= 1.0 else math.inf,
        steady_fps=steady,
        first_index=0 if is_late else n_lost,
        before_s=n_before / rate,
        n_empty=n_empty,
    )


def _first_key_s(stated: Stated, packets: Sequence[tuple[float, bool]], start_s: float) -> float:
    """The time of the first key frame in seconds, from the first packet on; NaN for none."""
    if math.isfinite(stated.begin_s):
        return stated.begin_s - start_s
    if stated.has_key or stated.n_faults or stated.is_in_steps:
        return 0.0
    return next((max(0.0, stamp_s) for stamp_s, is_key in packets if is_key), math.nan)
