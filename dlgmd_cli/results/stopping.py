"""The closed loop over rendered flights: what the stops that alarms ask for are worth.

An alarm is judged at the frame that raises it, as in `scoring`:

- it is needed within the horizon before a collision, or for a real obstacle (`justified`): a
  collision within 1.5 s on the current course. Then it is not false, either;
- at the first frame at which an alarm is on, and needed or for a real obstacle, the drone stops.
  It is *saved* if it does so before it touches anything;
- an alarm that is neither when it is raised asks for a *false stop*, and the flight goes on. If it
  is still on once a stop is needed or for a real obstacle, the drone stops then.

No stop saves a hovering drone from an approaching object: such collisions are left out.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import counted
from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.results.scoring import EARLY, FALSE, HIT, JUSTIFIED, Signal, kinds, onset_thresholds

STOP_MEASURES = (
    *("drones", "saved", "impact_m_s", "stopped_m"),
    *("justified", "unneeded_per_min", "speed_m_s"),
)
# The share of all collisions that are detected, or whose drone an earlier alarm saves.
SAVED_OR_DETECTED = "saved_or_detected"
MEASURES = (*STOP_MEASURES, SAVED_OR_DETECTED)


@dataclass(frozen=True)
class Stops:
    """What a stop at each frame of a rendered flight is worth, see `braking.Stop`.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Times of the frames, increasing.
    saved, justified : ndarray, shape (n,), bool
    impact_m_s, stopped_m : ndarray, shape (n,)
    can_stop : bool
        Whether the flight ends in a collision that a stop could avoid.
    speed_m_s : float
        Its speed, at the collision if there is one.
    needed_s : ndarray, shape (n,)
        The time to contact at which an alarm comes just in time, by the drone's speed at the frame;
        NaN where it stands.
    """

    time_s: Series
    saved: Flags
    impact_m_s: Series
    stopped_m: Series
    justified: Flags
    can_stop: bool
    speed_m_s: float
    needed_s: Series

    def row(self, time_s: float) -> int:
        """The row of the frame at a time."""
        return int(np.abs(self.time_s - time_s).argmin())

    def on(self, signal: Signal) -> Signal:
        """A signal of the flight, with the frames at which a stop is for a real obstacle."""
        rows = [self.row(time_s) for time_s in signal.time_s]
        return replace(signal, justified=self.justified[rows])


@dataclass(frozen=True)
class StopTally:
    """The stops of one flight at each of T thresholds.

    Attributes
    ----------
    stops, signal : Stops, Signal
    saved : ndarray, shape (T,), bool
    impact_m_s, stopped_m : ndarray, shape (T,)
        NaN where the drone is saved, or is not.
    n_unneeded, n_justified : int ndarray, shape (T,)
        Numbers of alarms that are not needed, and of those for a real obstacle only.
    """

    stops: Stops
    signal: Signal
    saved: Flags
    impact_m_s: Series
    stopped_m: Series
    n_unneeded: npt.NDArray[np.intp]
    n_justified: npt.NDArray[np.intp]


def difference_from(flight: Mapping[str, Any], record: Mapping[str, Any]) -> str:
    """In what the record of a flight is not of the video that the record of a result is about.

    Size, frame rate and number of frames are compared. Empty if they agree; with `--end`, the video
    may have more frames than were read.
    """
    read, is_cut = record["input"], record.get("options", {}).get("end") is not None
    for name in ("width", "height", "fps", "frames"):
        ours, theirs = read.get(name, math.nan), flight.get(name)
        off = ours - theirs if isinstance(theirs, int | float) else math.nan
        most = 1e-3 * ours if name == "fps" else 0.0
        if not (-math.inf if is_cut and name == "frames" else -most) <= off <= most:
            return f"{name} {theirs} instead of {ours}"
    return ""


def tally_stops(
    signal: Signal, stops: Stops, n_sp: int, thresholds: npt.ArrayLike, horizon_s: float
) -> StopTally:
    """Judge the alarms of a flight, at one threshold or at T."""
    signal = stops.on(signal)
    at = np.atleast_1d(np.asarray(thresholds, np.float64))
    low, high = onset_thresholds(signal, n_sp)
    kind, _ = kinds(signal, horizon_s)
    begins = (low[:, None] < at) & (at <= high[:, None])
    rows = np.array([stops.row(time_s) for time_s in signal.time_s])
    justified = kind == JUSTIFIED
    saved = np.zeros(len(at), np.bool_)
    impact, left = np.full((2, len(at)), math.nan)
    if stops.can_stop:
        # Without a stop, the speed is that of the last frame before the collision.
        impact[:] = stops.speed_m_s
        # Where an alarm is on, not only where it begins: a pilot who did not heed it then may now.
        for row in np.flatnonzero((kind == HIT) | justified)[::-1]:  # earlier ones overwrite
            here = at <= high[row]
            saved[here] = stops.saved[rows[row]]
            impact[here], left[here] = stops.impact_m_s[rows[row]], stops.stopped_m[rows[row]]
    counts = begins[(kind == FALSE) | (kind == EARLY)].sum(axis=0), begins[justified].sum(axis=0)
    return StopTally(stops, signal, saved, impact, left, *counts)


def score_stops(tallies: Sequence[StopTally]) -> dict[str, float]:
    """The measures over flights that were tallied at one threshold; NaN where undefined.

    `drones`: collisions that a stop could avoid. `saved`: their share that it does. `impact_m_s`
    and `stopped_m`: medians of the speed at impact of the others, and of the distance that is left
    to those that are saved. `justified`: share of the alarms without a collision that asked
    for a stop for a real obstacle. `unneeded_per_min`: the others, false stops. `speed_m_s`:
    median of the speeds at collisions.
    """
    own = [t for t in tallies if t.stops.can_stop]
    n_justified = sum(int(t.n_justified[0]) for t in tallies)
    n_unneeded = sum(int(t.n_unneeded[0]) for t in tallies)
    measures = (
        len(own),
        _share(sum(bool(t.saved[0]) for t in own), len(own)),
        _median([float(t.impact_m_s[0]) for t in own]),
        _median([float(t.stopped_m[0]) for t in own]),
        _share(n_justified, n_justified + n_unneeded),
        _share(n_unneeded, sum(t.signal.minutes for t in tallies)),
        _median([t.stops.speed_m_s for t in tallies if t.signal.contacts_s]),
    )
    return dict(zip(STOP_MEASURES, measures, strict=True))


def stop_curve(tallies: Sequence[StopTally]) -> tuple[Series, Series]:
    """False stops a minute, and the share of the drones that is saved, at every threshold."""
    own = [t.saved for t in tallies if t.stops.can_stop]
    minutes = sum(t.signal.minutes for t in tallies)
    n_unneeded = np.sum([t.n_unneeded for t in tallies], axis=0)
    rate = n_unneeded / minutes if minutes else np.full(len(n_unneeded), math.nan)
    saved = np.mean(own, axis=0) if own else np.full(len(n_unneeded), math.nan)
    return np.asarray(rate, np.float64), np.asarray(saved, np.float64)


def shown_stops(made: Any) -> Iterator[Any]:
    """What the stops of an `Evaluation` are worth, also by speed, for a terminal."""
    speeds = [flight.speed_m_s for flight in made.stops.values() if flight.can_stop]
    middle, least, most = np.median(speeds), min(speeds), max(speeds)
    yield (
        f"Rendered flights: {counted(len(speeds), 'drone')} in which a stop avoids the "
        f"collision, at {least:.1f} to {most:.1f} m/s (median {middle:.1f}). "
        f"Reaction {made.answer['react_s']:g} s, {made.answer['brakes']}."
    )
    mains = {label: made.main(label) for label in made.curves}
    first, *_ = mains
    names = [name for name in made.names("speed") if made.main(first, speed=name)["drones"]]
    shown = (
        *("recall", SAVED_OR_DETECTED, "saved", "unneeded_per_min"),
        *("justified", "impact_m_s", "stopped_m"),
    )
    lines = [
        (
            label,
            row["at"],
            *(_number(row[measure]) for measure in shown),
            *(_number(made.main(label, speed=name)["saved"]) for name in names),
        )
        for label, row in mains.items()
    ]
    header = ("recall", "or saved", "saved", "false stops/min", "justified", "impact m/s", "left m")
    yield ("model", "threshold", *header, *(f"saved, {name}" for name in names)), lines


def _number(value: float) -> str:
    """A measure for tables."""
    return "–" if math.isnan(value) else f"{value:.2f}"


def stop_time(signal: Signal, n_sp: int, threshold: float, horizon_s: float) -> float | None:
    """When an alarm is first on and a stop needed or for a real obstacle; None if never.

    `signal` says where a stop is for a real obstacle, see `Stops.on`.
    """
    _, high = onset_thresholds(signal, n_sp)
    kind, _ = kinds(signal, horizon_s)
    rows = np.flatnonzero(((kind == HIT) | (kind == JUSTIFIED)) & (threshold <= high))
    return float(signal.time_s[rows[0]]) if rows.size else None


def stop_cells(stops: Stops | None, time_s: float | None) -> tuple[float, ...]:
    """Whether a stop at a time saves the drone, its speed at impact, the distance that is left, and
    whether the stop is for a real obstacle; NaN where undefined. Without a stop, it is not saved.
    """
    if stops is None:
        return (math.nan,) * 4
    row = None if time_s is None else stops.row(time_s)
    justified = math.nan if row is None else float(stops.justified[row])
    if not stops.can_stop:
        return *(math.nan,) * 3, justified
    if row is None:
        return 0.0, stops.speed_m_s, math.nan, justified
    return *map(float, (stops.saved[row], stops.impact_m_s[row], stops.stopped_m[row])), justified


def _share(part: float, whole: float) -> float:
    return part / whole if whole else math.nan


def _median(values: Sequence[float]) -> float:
    """The median of the values that are not NaN; NaN if there are none."""
    known = [value for value in values if not math.isnan(value)]
    return float(np.median(known)) if known else math.nan
