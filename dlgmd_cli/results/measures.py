"""The few numbers that a result comes down to."""

import math
from collections.abc import Iterable, Sequence
from itertools import chain
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.results.tables import Flags, Result

# Frames on either side of a peak or a false positive that distinguishability looks at.
NEAR_FRAMES = 5


class Summary:
    """Gathers what a result comes down to, piece by piece.

    Its numbers are the same however the result is cut.
    """

    def __init__(self) -> None:
        self._n_frames = self._n_spikes = self._n_alarms = self._n_passing = 0
        self._peak: tuple[float, int, float] | None = None
        self._first_spike_s: float | None = None
        self._first_alarm: tuple[int, float] | None = None
        self._in_alarm = self._has_change = self._has_level = False
        self._attenuation: list[float] = []

    @classmethod
    def of(cls, pieces: Iterable[Result]) -> "Summary":
        """The summary of all pieces, which come in order."""
        summary = cls()
        for piece in pieces:
            summary.add(piece)
        return summary

    def add(self, piece: Result) -> None:
        """Go on with the next frames, of any number."""
        self._n_frames += len(piece.frame)
        self._has_change = self._has_change or bool((piece.p_sum > 0.0).any())
        self._has_level = self._has_level or bool(np.isfinite(piece.level).any())
        row = _peak(piece)
        if row is not None and (self._peak is None or piece.mp[row] > self._peak[0]):
            self._peak = float(piece.mp[row]), int(piece.frame[row]), float(piece.time_s[row])
        spiking = np.flatnonzero(piece.spike)
        if spiking.size and self._n_spikes == 0:
            self._first_spike_s = float(piece.time_s[spiking[0]])
        self._n_spikes += spiking.size
        alarms = onsets(piece.collision, goes_on=self._in_alarm)
        if alarms.size and self._n_alarms == 0:
            self._first_alarm = int(piece.frame[alarms[0]]), float(piece.time_s[alarms[0]])
        self._n_alarms += alarms.size
        self._in_alarm = bool(piece.collision[-1]) if piece.collision.size else self._in_alarm
        passing = piece.attenuation_db[np.isfinite(piece.attenuation_db)]
        self._n_passing += passing.size
        self._attenuation = _parts([*self._attenuation, *passing.tolist()])

    def to_dict(self) -> dict[str, Any]:
        """The summary as run.yaml and the command line show it.

        Returns
        -------
        dict
            `mp_max`, `mp_max_frame`, `mp_max_time_s` (the peak of the raw membrane potential),
            `spikes` (spiking frames), `first_spike_time_s`, `collisions` (alarms: unbroken runs
            of collision frames), `first_collision_frame`, `first_collision_time_s`, and
            `mean_attenuation_db` over the frames where something passes. None where there is none.
        """
        mp_max, mp_max_frame, mp_max_time_s = self._peak or (None, None, None)
        first_collision_frame, first_collision_time_s = self._first_alarm or (None, None)
        n_passing = self._n_passing
        return {
            "mp_max": mp_max,
            "mp_max_frame": mp_max_frame,
            "mp_max_time_s": mp_max_time_s,
            "spikes": self._n_spikes,
            "first_spike_time_s": self._first_spike_s,
            "collisions": self._n_alarms,
            "first_collision_frame": first_collision_frame,
            "first_collision_time_s": first_collision_time_s,
            "mean_attenuation_db": math.fsum(self._attenuation) / n_passing if n_passing else None,
        }

    def doubts(self, decoder: str = "opencv") -> list[str]:
        """What looks wrong, a line each, given what decoded the input."""
        lines = []
        if self._n_frames > 1 and not self._has_change:
            line = "no picture differs from the one before it: a still scene"
            if decoder == "opencv":
                line += (
                    f", or interlaced video, which OpenCV {cv2.__version__} may not convert; if "
                    "so, read it with --decoder pyav, or de-interlace it with ffmpeg -vf yadif"
                )
            lines.append(line)
        if self._peak is not None and not self._has_level:
            lines.append(
                "the membrane potential never changes, so that it cannot be normalised by its own "
                "sequence; there are no spikes"
            )
        return lines


def summarise(result: Result) -> dict[str, Any]:
    """Summary of a result of any number of frames, see `Summary.to_dict`."""
    return Summary.of([result]).to_dict()


def doubts(result: Result, decoder: str = "opencv") -> list[str]:
    """What looks wrong about a result, a line each, given what decoded the input."""
    return Summary.of([result]).doubts(decoder)


def sharpness(result: Result) -> float:
    """How broad the response is: the mean of K/max K over the valid frames, lower is sharper.

    NaN where no frame is valid, or the membrane potential is 0 throughout.
    """
    valid = result.mp[~np.isnan(result.mp)]
    peak = float(valid.max()) if valid.size else 0.0
    return float((valid / peak).mean()) if peak > 0.0 else math.nan


def distinguishability(result: Result, false_positive_frame: int) -> float:
    """DA: the mean K near its peak over the mean K near a false positive.

    Parameters
    ----------
    result : Result
        Any number of frames.
    false_positive_frame : int
        Number of the frame about which the response is a mistake.

    Returns
    -------
    float
        Each mean is over the valid frames that lie no more than 5 frame numbers away. Infinite
        where the model is silent near the false positive alone; NaN where it is silent near both,
        or one of them has no valid frame.
    """
    peak = _peak(result)
    if peak is None:
        return math.nan
    centres = (int(result.frame[peak]), false_positive_frame)
    response, mistake = (_mean_near(result, frame) for frame in centres)
    if mistake == 0.0:
        return math.inf if response > 0.0 else math.nan
    return response / mistake


def _mean_near(result: Result, frame: int) -> float:
    """Mean K over the valid frames near `frame`, NaN if there are none."""
    near = result.mp[np.abs(result.frame - frame) <= NEAR_FRAMES]
    valid = near[~np.isnan(near)]
    return float(valid.mean()) if valid.size else math.nan


def onsets(alarm: Flags, *, goes_on: bool = False) -> npt.NDArray[np.intp]:
    """Rows at which a run of alarms begins; the first does not if one `goes_on` from before."""
    before = np.concatenate(([goes_on], alarm[:-1]))
    return np.flatnonzero(alarm & ~before)


def _peak(result: Result) -> int | None:
    """Row of the greatest membrane potential."""
    return int(np.nanargmax(result.mp)) if np.isfinite(result.mp).any() else None


def _parts(numbers: Sequence[float]) -> list[float]:
    """A few numbers, the greatest first, whose sum is that of `numbers` without any error."""
    parts: list[float] = []
    while rest := math.fsum(chain(numbers, (-part for part in parts))):
        parts.append(rest)
    return parts
