"""The closed loop over rendered flights: what the stops that alarms ask for are worth.

An alarm is judged at the frame that raises it, as in `scoring`:

- it is needed within the horizon before a collision, or for a real obstacle (`justified`): a
  collision within 1.5 s on the current course. Then it is not false, either;
- at the first frame at which an alarm is on, and needed or for a real obstacle, the drone stops.
  It is *saved* if it does so before it touches anything;
- an alarm that is neither when it is raised asks for a *false stop*, and the flight goes on. If it
  is still on once a stop is needed or for a real obstacle, the drone stops then.

No stop saves a hovering drone from an approaching object: such collisions are left out. The flights
are built again from the records that `dlgmd synth` wrote beside the videos.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import DlgmdError, ParameterError, ResultError, argument, warn
from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.machine.pool import results_of
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.parameters.checks import Spec, in_argument
from dlgmd_cli.parameters.facts import Record
from dlgmd_cli.parameters.keys import Parameters, changed
from dlgmd_cli.results import intervals
from dlgmd_cli.results.labels import Case
from dlgmd_cli.results.record import read_record
from dlgmd_cli.results.scoring import Signal, Tally, ratio
from dlgmd_cli.results.store import is_url
from dlgmd_cli.results.tradeoff import Curve, medians
from dlgmd_cli.scenes.flights.braking import STANDING_M_S, TILT_DEG, Brakes, Stoppable
from dlgmd_cli.scenes.flights.drone import JERK_M_S3
from dlgmd_cli.scenes.flights.scenes import recorded_stage
from dlgmd_cli.tasks.evaluate.candidates import Candidates, difference_from, record_beside

_REACT = Spec(float, 0, 10)
_BRAKE = Spec(float, 0.1, 100)
_TILT, _JERK = Spec(float, 5, 45), Spec(float, 0.1, 1000)
# A tilt that is rounded is the same.
_SAME_DEG = 1e-6
_SPEED = Spec(float, STANDING_M_S, 100)
# What a threshold that follows the speed adds to the time that a stop needs.
MARGIN_S = 0.2
# The least time that is left when a rate stands for it: an overdue stop has a finite rate, too.
_LEAST_LEFT_S = 0.001
# The speed of each rendered flight itself.
TRUE = "true"


def speed_of(speed: float | str | None, *words: str) -> float | str | None:
    """A checked speed in m/s, or one of some words that say whose it is; raises ParameterError."""
    if speed is None or speed in words:
        return speed
    with in_argument("speed_m_s"):
        return _SPEED.parse(str(speed))


def brakes_of(
    react: float,
    brake: float | None,
    agile: bool | None,
    tilt: float | None = None,
    jerk: float | None = None,
) -> Brakes:
    """The checked answer to alarms; raises ParameterError.

    A tilt or a jerk alone means a stabilised drone.
    """
    with in_argument("react"):
        react_s = _REACT.check(react)
    if brake is not None:
        if agile is not None:
            drones = f"{argument('agile')} or {argument('stabilised')}"
            why = f"{argument('brake')} does not work with {drones}: it is instant"
            raise ParameterError("", why, "Leave one out.")
        with in_argument("brake"):
            brake = _BRAKE.check(brake)
    if brake is not None and (tilt, jerk) != (None, None):
        why = f"{argument('brake')} does not work with {argument('tilt')} or {argument('jerk')}"
        raise ParameterError("", f"{why}: it is instant", "Leave one out.")
    if agile and jerk is not None:
        why = f"{argument('jerk')} does not work with {argument('agile')}: its tilt is instant"
        raise ParameterError("", why, "Leave one out.")
    with in_argument("tilt"):
        tilt_deg = TILT_DEG if tilt is None else _TILT.check(tilt)
    with in_argument("jerk"):
        jerk_m_s3 = JERK_M_S3 if jerk is None else _JERK.check(jerk)
    if agile is None and (tilt, jerk) != (None, None):
        agile = False
    return Brakes(react_s, brake, agile, tilt_deg, jerk_m_s3)


def brakes_text(brakes: Brakes) -> str:
    """How a drone brakes, in words."""
    if brakes.brake_m_s2 is not None:
        return f"braking at {brakes.brake_m_s2:g} m/s²"
    if brakes.agile is not None:
        if brakes.agile:
            usual = abs(brakes.tilt_deg - TILT_DEG) < _SAME_DEG
            return f"braking with instant tilt{'' if usual else f' of {brakes.tilt_deg:g}°'}"
        return f"braking stabilised ({brakes.tilt_deg:g}°, {brakes.jerk_m_s3:g} m/s³)"
    return "braking within each drone's own limits"


def following(params: Parameters, brakes: Brakes, speed_m_s: float) -> Parameters:
    """Parameters whose threshold leaves time for a stop, and `MARGIN_S`, at a speed in m/s.

    They are as they were where the drone stands, or its speed is NaN. No speed that an autopilot
    reports is an error, see `Rule.threshold_at`.
    """
    needed_s = brakes.needed_s(speed_m_s)
    return params if math.isnan(needed_s) else _at(params, needed_s + MARGIN_S)


def _at(params: Parameters, time_s: float) -> Parameters:
    """Parameters whose rule raises an alarm so long before contact."""
    rule = rule_of(params)
    return changed(params, **{rule.key: rule.threshold_at(time_s)})


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

    def rows(self, time_s: npt.ArrayLike) -> npt.NDArray[np.intp]:
        """The rows of the frames that are nearest to these times."""
        return np.abs(np.subtract.outer(np.asarray(time_s), self.time_s)).argmin(axis=-1)

    def on(self, signal: Signal) -> Signal:
        """A signal of the flight, with the frames at which a stop is for a real obstacle."""
        return replace(signal, justified=self.justified[self.rows(signal.time_s)])

    def outcomes(self, stop_s: Series) -> npt.NDArray[np.float64]:
        """What comes of stops at these times, (T,); NaN for no stop.

        Returns
        -------
        ndarray, shape (3, T)
            Whether the drone is saved, its speed at impact in m/s, and the distance that is left in
            m; NaN where undefined, and of a flight in which no stop helps.
        """
        if not self.can_stop:
            return np.full((3, len(stop_s)), math.nan)
        rows = self.rows(np.nan_to_num(stop_s))
        stopped = np.stack([self.saved[rows], self.impact_m_s[rows], self.stopped_m[rows]])
        # Without a stop, the speed is that of the last frame before the collision.
        return np.where(np.isnan(stop_s), [[0.0], [self.speed_m_s], [math.nan]], stopped)

    def worth(self, stop_s: float) -> tuple[float, ...]:
        """The `outcomes` of one stop, and whether it is for a real obstacle."""
        justified = self.justified[self.rows(stop_s)]
        return *self.outcomes(np.array([stop_s]))[:, 0].tolist(), float(justified)


def stops_of(candidates: Candidates, brakes: Brakes, jobs: int | None) -> dict[str, Stops]:
    """The stops of the videos that are rendered flights, by name.

    A video counts as a flight if the record that `dlgmd synth` wrote is beside it, agrees with the
    video, and is still that of the flight which this version renders; else, a warning says so.
    """
    first = next(iter(candidates.by_label.values()))
    tasks = [
        (case, candidates.records[case.name], first.signals[case.name].time_s)
        for case in candidates.cases
        if not is_url(case.path) and record_beside(case).is_file()
    ]
    stops = {}
    for (case, *_), found in results_of(partial(stops_in, brakes), tasks, jobs):
        if isinstance(found, DlgmdError):
            file_name = Path(found.what).name
            warn(f"{case.name}: no stop is simulated: {file_name} {found.why}")
        elif found is not None:
            stops[case.name] = found
    return stops


def stops_in(brakes: Brakes, task: tuple[Case, Record, Series]) -> Stops | None:
    """The stops of one video: the record of a result, and the times of its frames.

    None if it is not a flight. Raises ResultError if it is not the flight of its record.
    """
    case, record, time_s = task
    path = record_beside(case)
    stage = recorded_stage(path)
    if stage is None:
        return None
    if other := difference_from(read_record(path), record):
        raise ResultError(str(path), f"is the record of another video ({other})")
    flight, times = Stoppable(stage), time_s.tolist()
    stops = [flight.stop(at_s, brakes) for at_s in times]
    return Stops(
        time_s,
        np.array([stop.saved for stop in stops]),
        np.array([stop.impact_m_s for stop in stops]),
        np.array([stop.stopped_m for stop in stops]),
        np.array([flight.is_justified(at_s) for at_s in times]),
        flight.can_stop,
        flight.speed_m_s,
        np.array([flight.needed_s(at_s, brakes) for at_s in times]),
    )


def with_speed(
    candidates: Candidates, stops: Mapping[str, Stops], brakes: Brakes, speed: float | str
) -> None:
    """Add each model whose rule can once more, with a threshold that follows the speed.

    The speed is given in m/s, for a stabilised drone unless `brakes` say otherwise, or it is
    `TRUE`: that of each rendered flight at each frame, by how that one brakes. With the
    latter, the rule compares the time that is left beside the one that a stop needs, with
    `MARGIN_S`; where no speed is known, alarms are those at the model's own threshold.
    """
    for label, candidate in [*candidates.by_label.items()]:
        params = candidate.params
        if params is None or not rule_of(params).follows_speed:
            continue
        if speed != TRUE:
            label += f", {speed:g} m/s"
            added = replace(candidate, label=label, params=following(params, brakes, float(speed)))
        else:
            label += f", {speed} speed"
            rule, params = rule_of(params), _at(params, MARGIN_S)
            usual_s = rule.as_time(rule.threshold) - MARGIN_S
            added = replace(candidate, label=label, params=params, signals={})
            for name, signal in candidate.signals.items():
                needed_s = np.full(1, math.nan)
                if name in stops:
                    needed_s = stops[name].needed_s[stops[name].rows(signal.time_s)]
                sign = -1.0 if rule.at_most else 1.0
                time_s = rule.as_time(sign * signal.strength)
                left_s = time_s - np.where(np.isnan(needed_s), usual_s, needed_s)
                if not rule.at_most:
                    left_s = np.maximum(left_s, _LEAST_LEFT_S)
                strength = sign * np.asarray(rule.as_time(left_s))
                added.signals[name] = replace(signal, strength=strength)
        candidates.by_label[label] = added


def score_stops(flights: Sequence[tuple[Stops, Tally]]) -> dict[str, float]:
    """The measures over flights that were tallied at one threshold; NaN where undefined.

    `drones`: collisions that a stop could avoid. `saved`: their share that it does. `impact_m_s`
    and `stopped_m`: medians of the speed at impact of the others, and of the distance that is left
    to those that are saved. `justified`: share of the alarms without a collision that asked
    for a stop for a real obstacle. `unneeded_per_min`: the others, false stops. `speed_m_s`:
    median of the speeds at collisions. `saved` and `unneeded_per_min` are followed by their
    bounds, see `with_bounds` and `poisson_interval`.
    """
    drones = [(stops, tally) for stops, tally in flights if stops.can_stop]
    saved, impact, left = np.hstack(
        [np.empty((3, 0)), *(stops.outcomes(tally.stop_s) for stops, tally in drones)]
    )
    n_justified = sum(int(tally.n_justified[0]) for _, tally in flights)
    n_unneeded = sum(int(tally.n_false[0]) for _, tally in flights)
    minutes = sum(tally.minutes for _, tally in flights)
    least, most = intervals.poisson_interval(n_unneeded)
    return {
        "drones": len(drones),
        **with_bounds("saved", int(saved.sum()), len(drones)),
        "impact_m_s": _median(impact),
        "stopped_m": _median(left),
        "justified": _share(n_justified, n_justified + n_unneeded),
        "unneeded_per_min": _share(n_unneeded, minutes),
        "unneeded_per_min_low": _share(least, minutes),
        "unneeded_per_min_high": _share(most, minutes),
        "speed_m_s": _median([stops.speed_m_s for stops, tally in flights if len(tally.lead_s)]),
    }


def with_bounds(name: str, n: int, of: int) -> dict[str, float]:
    """A share by its name, with its bounds (`binomial_interval`); NaN of nothing."""
    bounds = intervals.binomial_interval(n, of) if of else (math.nan, math.nan)
    return dict(zip((name, f"{name}_low", f"{name}_high"), (_share(n, of), *bounds), strict=True))


def _share(part: float, whole: float) -> float:
    return float(part) / whole if whole else math.nan


def _median(values: npt.ArrayLike) -> float:
    """The median of the values that are not NaN; NaN if there are none."""
    return float(medians(np.reshape(values, (-1, 1)))[0])


def with_stops(curve: Curve, flights: Sequence[tuple[Stops, Tally]]) -> Curve:
    """A curve with the share of the drones that is saved, and the rate of false stops, of flights
    that were tallied at its thresholds.
    """
    saved = [stops.outcomes(tally.stop_s)[0] for stops, tally in flights if stops.can_stop]
    n_unneeded = np.sum([tally.n_false for _, tally in flights], axis=0)
    rate = ratio(n_unneeded, sum(tally.minutes for _, tally in flights))
    share = np.mean(saved, axis=0) if saved else curve.saved
    return replace(curve, saved=share, unneeded_per_min=rate)
