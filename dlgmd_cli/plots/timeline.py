"""The time that several results share, and where a frame stands on it."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dlgmd_cli.results.tables import Result, Series

# Times come from CSVs with nine digits.
_ROUNDING = 1e-8


@dataclass(frozen=True)
class Timeline:
    """From the first time of any result to the last.

    Attributes
    ----------
    start_s, end_s : float
        First and last time, in seconds.
    frame, time_s : array, shape (n,)
        Frames, increasing, and their times: those of all results if they agree, otherwise those
        of the first result.
    is_shared : bool
        Whether all results agree on which frame is when.
    """

    start_s: float
    end_s: float
    frame: npt.NDArray[np.int64]
    time_s: Series
    is_shared: bool

    @classmethod
    def of(cls, results: Iterable[Result]) -> "Timeline":
        """The timeline of at least one result, each with at least one frame."""
        results = list(results)
        start_s = min(float(result.time_s[0]) for result in results)
        end_s = max(float(result.time_s[-1]) for result in results)
        first, *others = results
        frame, time_s = first.frame, first.time_s
        for result in others:
            merged = _merged(frame, time_s, result)
            if merged is None:
                return cls(start_s, end_s, first.frame, first.time_s, is_shared=False)
            frame, time_s = merged
        return cls(start_s, end_s, frame, time_s, is_shared=True)

    @property
    def view(self) -> tuple[float, float]:
        """What the time axis shows, in seconds; never empty."""
        if self.end_s > self.start_s:
            return self.start_s, self.end_s
        return self.start_s - 0.5, self.start_s + 0.5

    @property
    def frames(self) -> tuple[int, int]:
        """First and last frame."""
        return int(self.frame[0]), int(self.frame[-1])

    def time_of(self, frame: float) -> float:
        """Time of a frame, between two that are known if need be."""
        return float(np.interp(frame, self.frame, self.time_s))


def _merged(
    frame: npt.NDArray[np.int64], time_s: Series, result: Result
) -> tuple[npt.NDArray[np.int64], Series] | None:
    """Both relations as one, or None if they share no frame or disagree."""
    _, here, there = np.intersect1d(frame, result.frame, return_indices=True)
    tolerance = _ROUNDING * max(1.0, abs(float(result.time_s[-1])))
    if not here.size or np.abs(time_s[here] - result.time_s[there]).max() > tolerance:
        return None
    merged, places = np.unique(np.concatenate((frame, result.frame)), return_index=True)
    times = np.concatenate((time_s, result.time_s))[places]
    return None if (np.diff(times) < 0).any() else (merged, times)
