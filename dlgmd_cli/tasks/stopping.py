"""What stops at each frame of rendered flights are worth; the flights are rebuilt from records."""

import logging
import math
import os
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dlgmd_cli.errors import DlgmdError, ParameterError, ResultError
from dlgmd_cli.machine.pool import results_of
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.parameters.checks import Spec, blame
from dlgmd_cli.parameters.keys import Parameters, changed
from dlgmd_cli.results.candidates import Candidates
from dlgmd_cli.results.labels import Case
from dlgmd_cli.results.record import read_record
from dlgmd_cli.results.stopping import Stops, difference_from
from dlgmd_cli.results.store import is_url
from dlgmd_cli.scenes.flights.braking import STANDING_M_S, Brakes, Stoppable
from dlgmd_cli.scenes.flights.scenes import recorded_stage

_log = logging.getLogger(__name__)

_REACT = Spec(float, 0, 10)
_BRAKE = Spec(float, 0.1, 100)
_SPEED = Spec(float, STANDING_M_S, 100)
# What a threshold that follows the speed adds to the time that a stop needs.
MARGIN_S = 0.2
# The speed of each rendered flight itself.
TRUE = "true"


def speed_of(speed: float | str | None, *words: str) -> float | str | None:
    """A checked speed in m/s, or one of some words that say whose it is; raises ParameterError."""
    if speed is None or speed in words:
        return speed
    with blame("Invalid value for '--speed-m-s'"):
        return _SPEED.parse(str(speed))


def brakes_of(react: float, brake: float | None, agile: bool | None) -> Brakes:
    """The checked answer to alarms; raises ParameterError."""
    with blame("Invalid value for '--react'"):
        react_s = _REACT.check(react)
    if brake is not None:
        if agile is not None:
            why = "--brake does not work with --agile or --stabilised: it is instant"
            raise ParameterError("", why, "Leave one out.")
        with blame("Invalid value for '--brake'"):
            brake = _BRAKE.check(brake)
    return Brakes(react_s, brake, agile)


def answer_of(brakes: Brakes) -> dict[str, Any]:
    """How an alarm is answered, for the record and in words."""
    words = "braking within each drone's own limits"
    if brakes.brake_m_s2 is not None:
        words = f"braking at {brakes.brake_m_s2:g} m/s²"
    elif brakes.agile is not None:
        words = f"braking {'with instant tilt' if brakes.agile else 'stabilised (25°, 8 m/s³)'}"
    return {"react_s": brakes.react_s, "brakes": words}


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
            usual_s, params = rule_of(params).threshold - MARGIN_S, _at(params, MARGIN_S)
            added = replace(candidate, label=label, params=params, signals={})
            for name, signal in candidate.signals.items():
                needed_s = np.full(1, math.nan)
                if name in stops:
                    rows = [stops[name].row(time_s) for time_s in signal.time_s]
                    needed_s = stops[name].needed_s[rows]
                strength = signal.strength + np.where(np.isnan(needed_s), usual_s, needed_s)
                added.signals[name] = replace(signal, strength=strength)
        candidates.by_label[label] = added


def stops_of(candidates: Candidates, brakes: Brakes, jobs: int | None) -> dict[str, Stops]:
    """The stops of the videos that are rendered flights, by name.

    A video counts as a flight if the record that `dlgmd synth` wrote is beside it, agrees with the
    video, and is still that of the flight which this version renders; else, a warning says so.
    """
    first = next(iter(candidates.by_label.values()))
    tasks = [
        (case, candidates.records[case.name], first.signals[case.name].time_s.tobytes())
        for case in candidates.cases
        if not is_url(case.path) and _record_beside(case).is_file()
    ]
    stops = {}
    for (case, *_), made in results_of(partial(stops_in, brakes), tasks, jobs):
        if isinstance(made, DlgmdError):
            file_name = Path(made.what).name
            _log.warning("%s: no stop is simulated: %s %s", case.name, file_name, made.why)
        elif made is not None:
            stops[case.name] = made
    return stops


def _record_beside(case: Case) -> Path:
    """Where the record of a rendered video is."""
    return Path(os.path.abspath(case.path)).with_suffix(".yaml")


def stops_in(brakes: Brakes, task: tuple[Case, dict[str, Any], bytes]) -> Stops | None:
    """The stops of one video: the record of a result, and the times of its frames as bytes.

    None if it is not a flight. Raises ResultError if it is not the flight of its record.
    """
    case, record, times = task
    path = _record_beside(case)
    stage = recorded_stage(path)
    if stage is None:
        return None
    if other := difference_from(read_record(path), record):
        raise ResultError(str(path), f"is the record of another video ({other})")
    flight, time_s = Stoppable(stage), np.frombuffer(times)
    made = [flight.stop(at_s, brakes) for at_s in time_s.tolist()]
    return Stops(
        time_s,
        np.array([stop.saved for stop in made]),
        np.array([stop.impact_m_s for stop in made]),
        np.array([stop.stopped_m for stop in made]),
        np.array([flight.is_justified(at_s) for at_s in time_s.tolist()]),
        flight.can_stop,
        flight.speed_m_s,
        np.array([flight.needed_s(at_s, brakes) for at_s in time_s.tolist()]),
    )
