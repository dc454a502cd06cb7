"""The few numbers that a result comes down to."""

import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.results.tables import Flags, Result, Series

# Frames on either side of a peak or a false positive that distinguishability looks at.
NEAR_FRAMES = 5


def summarise(result: Result) -> dict[str, Any]:
    """Summary of a result, as run.yaml and the command line show it.

    Parameters
    ----------
    result : Result
        Any number of frames.

    Returns
    -------
    dict
        `mp_max`, `mp_max_frame`, `mp_max_time_s` (the peak of the raw membrane potential),
        `spikes` (spiking frames), `first_spike_time_s`, `collisions` (alarms: unbroken runs of
        collision frames), `first_collision_frame`, `first_collision_time_s`, and
        `mean_attenuation_db` over the frames where something passes. None where there is none.
    """
    peak = _peak(result)
    spiking = np.flatnonzero(result.spike)
    alarms = onsets(result.collision)
    passing = result.attenuation_db[np.isfinite(result.attenuation_db)]
    return {
        "mp_max": _at(result.mp, peak),
        "mp_max_frame": _number(result, peak),
        "mp_max_time_s": _at(result.time_s, peak),
        "spikes": int(spiking.size),
        "first_spike_time_s": _at(result.time_s, _first(spiking)),
        "collisions": int(alarms.size),
        "first_collision_frame": _number(result, _first(alarms)),
        "first_collision_time_s": _at(result.time_s, _first(alarms)),
        "mean_attenuation_db": float(passing.mean()) if passing.size else None,
    }


def doubts(result: Result, decoder: str = "opencv") -> list[str]:
    """What looks wrong about a result, a line each, given what decoded the input."""
    lines = []
    if result.p_sum.size > 1 and not np.nansum(result.p_sum) > 0.0:
        line = "no picture differs from the one before it: a still scene"
        if decoder == "opencv":
            line += (
                f", or interlaced video, which OpenCV {cv2.__version__} may not convert; if so, "
                "read it with --decoder pyav, or de-interlace it with ffmpeg -vf yadif"
            )
        lines.append(line)
    if np.isfinite(result.mp).any() and not np.isfinite(result.level).any():
        lines.append(
            "the membrane potential never changes, so that it cannot be normalised by its own "
            "sequence; there are no spikes"
        )
    return lines


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
    peak = _number(result, _peak(result))
    if peak is None:
        return math.nan
    response, mistake = (_mean_near(result, frame) for frame in (peak, false_positive_frame))
    if mistake == 0.0:
        return math.inf if response > 0.0 else math.nan
    return response / mistake


def _mean_near(result: Result, frame: int) -> float:
    """Mean K over the valid frames near `frame`, NaN if there are none."""
    near = result.mp[np.abs(result.frame - frame) <= NEAR_FRAMES]
    valid = near[~np.isnan(near)]
    return float(valid.mean()) if valid.size else math.nan


def onsets(alarm: Flags) -> npt.NDArray[np.intp]:
    """Rows at which a run of alarms begins."""
    before = np.concatenate(([False], alarm[:-1]))
    return np.flatnonzero(alarm & ~before)


def _peak(result: Result) -> int | None:
    """Row of the greatest membrane potential."""
    return int(np.nanargmax(result.mp)) if np.isfinite(result.mp).any() else None


def _first(rows: npt.NDArray[np.intp]) -> int | None:
    return int(rows[0]) if rows.size else None


def _at(series: Series, row: int | None) -> float | None:
    return None if row is None else float(series[row])


def _number(result: Result, row: int | None) -> int | None:
    return None if row is None else int(result.frame[row])
