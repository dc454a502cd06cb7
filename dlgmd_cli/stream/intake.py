"""From a camera's images to frames in time: which are taken, when, and after what."""

import math
from typing import NamedTuple

from dlgmd_cli.errors import Once
from dlgmd_cli.frame import Image
from dlgmd_cli.stream.clock import Pace, StreamClock
from dlgmd_cli.stream.continuity import Continuity


class Placed(NamedTuple):
    """The capture time (s) of an image that is taken, and how it follows the last one taken."""

    time_s: float
    is_repeat: bool
    after_gap: bool


class Intake:
    """Says of each image of a source when it was captured, and whether it is taken.

    Of a source that is faster than `max_fps`, every k-th image is taken.

    Parameters
    ----------
    continuity : Continuity
        Detects duplicates and gaps.
    max_fps : float
        The highest rate of the images that are taken; infinite to take all.
    clock : StreamClock, optional
        Estimates capture times from arrivals. Without a clock, times are those of the capture.

    Attributes
    ----------
    pace : Pace
        The rate of the source.
    """

    def __init__(
        self, continuity: Continuity, max_fps: float = math.inf, clock: StreamClock | None = None
    ) -> None:
        self.pace, self._continuity, self._clock = Pace(max_fps), continuity, clock
        self._doubts = Once()

    def reset(self) -> None:
        """Forget all earlier images."""
        self.pace.reset()
        self._continuity.reset()
        if self._clock is not None:
            self._clock.reset()

    def place(
        self, image: Image | None, time_s: float | None, stamp_s: float = math.nan
    ) -> Placed | None:
        """The place of an image, (H, W) or (H, W, 3), in the sequence; None if it is left out.

        `time_s` is the time of its arrival, or of its capture if there is no clock, and `stamp_s`
        the stream's own time. An image without a time is taken, and follows no gap.
        """
        at_s, is_stale, is_due = time_s, False, True
        if time_s is not None:
            at_s = time_s if self._clock is None else self._clock.step(time_s, stamp_s)
            is_stale = self._clock is not None and self._clock.is_stale
            is_due = self.pace.is_due(at_s) or not self.is_settled
        self._continuity.step(image, at_s)
        if is_stale or not is_due:
            return None
        return Placed(math.nan if at_s is None else at_s, *self._continuity.take())

    @property
    def is_settled(self) -> bool:
        """Whether images have come for long enough to know their rate."""
        return self._clock is None or self._clock.arrivals.is_settled

    def doubts(self) -> str:
        """How the images arrive, if unevenly or in bursts, once each; else empty."""
        doubts = "" if self._clock is None else self._clock.arrivals.doubts()
        return doubts if doubts and self._doubts.is_new(doubts.partition(",")[0]) else ""
