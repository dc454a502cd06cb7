"""The few numbers that a result comes down to."""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.results.tables import Flags, Result, Series


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
    peak = int(np.nanargmax(result.mp)) if np.isfinite(result.mp).any() else None
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


def onsets(alarm: Flags) -> npt.NDArray[np.intp]:
    """Rows at which a run of alarms begins."""
    before = np.concatenate(([False], alarm[:-1]))
    return np.flatnonzero(alarm & ~before)


def _first(rows: npt.NDArray[np.intp]) -> int | None:
    return int(rows[0]) if rows.size else None


def _at(series: Series, row: int | None) -> float | None:
    return None if row is None else float(series[row])


def _number(result: Result, row: int | None) -> int | None:
    return None if row is None else int(result.frame[row])
