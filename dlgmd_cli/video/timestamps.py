"""Timestamps of frames: repaired so that they increase, and searched for missing frames."""

import math

# Thirty years; if a stream has no start, OpenCV's timestamps are astronomic.
MAX_PLAUSIBLE_TIME_S = 1e9
HOLE_EDGE_FRAMES = 5


class HoleWatch:
    """Finds frames that are missing in a stream of constant rate: a demuxer skipped them.

    Streams of variable rate have odd intervals everywhere; nothing is reported for them.

    Parameters
    ----------
    fps : float
        Nominal rate.
    """

    def __init__(self, fps: float) -> None:
        self._fps = fps
        self._last_s = math.nan
        self._n_frames = 0
        self._n_steady = self._n_odd = self._n_holes = self._n_missing = self._n_long = 0
        self._first: tuple[int, float] | None = None
        self._hole_ends = -HOLE_EDGE_FRAMES

    def add(self, index: int, time_s: float) -> None:
        """Take the next frame's time."""
        intervals = (time_s - self._last_s) * self._fps  # NaN at the first frame
        if abs(intervals - 1.0) < 0.25 + 2e-3 * self._fps:
            self._n_steady += 1
        elif intervals > 1.0:
            # The edges of a hole are ragged: several long intervals close together.
            if index - self._hole_ends > HOLE_EDGE_FRAMES:
                self._n_holes += 1
                self._n_long = 0
            self._n_long += 1
            self._n_odd += self._n_long > HOLE_EDGE_FRAMES  # too long for an edge
            if self._first is None:
                self._first = (index - 1, self._last_s)
            self._n_missing += round(intervals) - 1
            self._hole_ends = index
        elif index > 0:
            self._n_odd += 1
        self._last_s, self._n_frames = time_s, index + 1

    def report(self) -> str | None:
        """One line on the holes, or None."""
        is_steady = self._n_odd == 0 and self._n_steady >= 20 * self._n_holes
        # A video that was cut can have a ragged end.
        is_end = self._n_holes == 1 and self._n_frames - self._hole_ends <= HOLE_EDGE_FRAMES
        if self._first is None or is_end or not is_steady or self._n_missing < 2 * self._n_holes:
            return None
        index, time_s = self._first
        more = f" and in {self._n_holes - 1} more places" if self._n_holes > 1 else ""
        return (
            f"about {self._n_missing} frames are missing after frame {index} ({time_s:.3f} s)"
            f"{more}, damaged file or dropped frames; do not trust the response there"
        )


class FrameClock:
    """Strictly increasing times from a decoder's timestamps, however poor these are.

    Parameters
    ----------
    fps : float
        Nominal rate, for frames that have no usable timestamp.
    """

    def __init__(self, fps: float) -> None:
        self._interval = 1.0 / fps
        self._fps = fps
        self._last_good = self._last = -MAX_PLAUSIBLE_TIME_S
        self._stale = 0
        self.n_stamped = 0
        self.n_repaired = 0

    def time(self, index: int, stamp_s: float) -> float:
        """Time of frame `index` in seconds, given its timestamp (NaN: none)."""
        if self._last < stamp_s <= MAX_PLAUSIBLE_TIME_S:
            self.n_stamped += index > 0
            self._stale = 0
            self._last_good = self._last = stamp_s
            return stamp_s
        self.n_repaired += 1
        self._stale += 1
        if self.n_stamped == 0:  # no frame after the first one ever had one
            time_s = index * self._interval
        else:  # half an interval at first, so that the next good stamp is still ahead
            time_s = self._last_good + (self._stale - 0.5) * self._interval
        self._last = max(time_s, math.nextafter(self._last, math.inf))
        return self._last

    def report(self) -> str | None:
        """One line on times that are not the decoder's own, or None."""
        if self.n_repaired == 0:
            return None
        if self.n_stamped == 0:
            return f"the stream has no timestamps; times are frame number / {self._fps:g} fps"
        return (
            f"{self.n_repaired} frames had no usable timestamp; "
            f"their times follow from {self._fps:g} fps"
        )
