"""The models and baselines that are scored, with the signal of each labelled video."""

import logging
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dlgmd_cli.errors import DlgmdError, ResultError, SourceError, argument, counted, warn
from dlgmd_cli.frame import Series
from dlgmd_cli.machine.pool import results_of
from dlgmd_cli.models.normalise import params_at_scale
from dlgmd_cli.models.rules import Rule, rule_of
from dlgmd_cli.models.stopping import BRAKES, Brake
from dlgmd_cli.parameters.facts import Record, Size, extended, part_of
from dlgmd_cli.parameters.keys import CORRIDOR, Parameters
from dlgmd_cli.parameters.presets import ANGLES, LkDivergenceParameters
from dlgmd_cli.results.labels import Case, Label, StoredResults
from dlgmd_cli.results.reading import read_result
from dlgmd_cli.results.record import model_entry
from dlgmd_cli.results.result import Result
from dlgmd_cli.results.scoring import Contact, Signal, contact_of
from dlgmd_cli.results.store import SUMMARY, is_url
from dlgmd_cli.tasks import call
from dlgmd_cli.tasks.call import Progress, Request, Setup
from dlgmd_cli.tasks.stepping import require_response, run_models
from dlgmd_cli.video.given_times import misfit

_log = logging.getLogger(__name__)

P_SUM, FLOW = "ΣP alone", "LK divergence"
# Greatest number of frames that a labelled collision may lie after a video's last frame.
_LATE_FRAMES = 3

# The results of a video by the models' labels, or the error that prevented them.
Results = dict[str, Result] | DlgmdError


@dataclass
class Candidate:
    """A model that is scored, or a baseline, which has no threshold of its own.

    Attributes
    ----------
    label : str
        The candidate's name in tables.
    n_sp : int
        Number of frames in a row that raise an alarm: 1 with the rule `ttc`.
    params : Parameters or None
        The model's parameters; None for a baseline.
    by_sequence : bool
        Whether the potential is the per-video min–max.
    record : dict
        The record (run.yaml) of one of the candidate's results.
    signals : dict of str to Signal
        The thresholded signal of each video, by the video's name in the labels.
    """

    label: str
    n_sp: int
    params: Parameters | None
    by_sequence: bool
    record: Record
    signals: dict[str, Signal] = field(default_factory=dict)

    @property
    def rule(self) -> Rule | None:
        """The rule of the model's alarms; None for a baseline."""
        if self.params is None:
            return None
        params = params_at_scale(self.params, by_sequence=self.by_sequence)
        return rule_of(params, by_sequence=self.by_sequence)

    @property
    def rule_name(self) -> str:
        """The name of the rule; empty for a baseline."""
        return "" if self.params is None else self.params.alarm

    def level(self, strength: float) -> float:
        """The threshold, in the rule's unit, at a strength; for a baseline, the strength."""
        return strength if self.rule is None else self.rule.value_at(strength)

    def excitation(self, strength: float) -> float:
        """The mean excitation at a strength; NaN if the rule does not compare the excitation."""
        return strength if self.rule is None else self.rule.excitation_at(strength)

    def strength_of(self, row: Mapping[str, Any]) -> float:
        """The strength at the threshold in a row of scores."""
        excitation, rule = float(row["excitation"]), self.rule
        if rule is None or not math.isnan(excitation):
            return excitation
        return rule.strength_at(float(row["threshold"]))

    def described(self) -> Record:
        """The entry of the record: label, parameters, and the size of the processed frames."""
        if self.params is not None:
            return model_entry(self.label, self.record, self.params)
        size = part_of(self.record["processed"], Size)
        return {**extended({"label": self.label}, {"n_sp": self.n_sp}), **size}


@dataclass(frozen=True)
class Stopping:
    """The speed of drones at a contact, and who brakes.

    Attributes
    ----------
    brake : Brake
        Who brakes, with the reaction, which is that of all brakes.
    speed_m_s : float or None
        The speed at every contact; None for the speed in each label.
    for_all : bool
        Whether `brake` is in place of the brakes in the labels.
    """

    brake: Brake = field(default_factory=Brake)
    speed_m_s: float | None = None
    for_all: bool = False

    def contact(self, label: Label, time_s: float, approach_s: float) -> Contact:
        """The contact of a label at a time, with the stops that it needs if its speed is known."""
        speed_m_s = label.speed_m_s if self.speed_m_s is None else self.speed_m_s
        if speed_m_s is None:
            return contact_of(time_s, approach_s)
        theirs = self.brake if self.for_all or not label.brake else Brake.parse(label.brake)
        brakes = (replace(one, react_s=self.brake.react_s) for one in (theirs, *BRAKES.values()))
        stop_s, *stops_s = (brake.stop_s(speed_m_s) for brake in brakes)
        return contact_of(time_s, stop_s=stop_s)._replace(stops_s=tuple(stops_s))


def signal_of(
    result: Result, case: Case, stopping: Stopping, strength: Series | None = None
) -> Signal:
    """The thresholded signal of a result, with the contacts of a labelled video.

    `strength` is the result's strength unless given. Raises SourceError if the video was not read
    to its end, or ends before a contact.
    """
    if result.interrupted:
        raise SourceError(case.name, "its result was interrupted", "Run again.")
    frame, time_s = result.frame, result.time_s
    frame_s = 1.0 / float(result.record["input"]["fps"])
    # The last frames may have been dropped to reduce the frame rate.
    first, last = int(frame[0]), max(int(frame[-1]), result.record["input"]["frames"] - 1)
    contacts = []

    def time_of(number: int) -> float:
        after_s = max(number - int(frame[-1]), 0) * frame_s
        return float(np.interp(number, frame, time_s)) + after_s

    for label, collision in zip(case.labels, case.collisions, strict=False):
        if not first <= collision <= last + _LATE_FRAMES:
            raise SourceError(
                case.name,
                f"its collision is at frame {collision}, but frames {first} to {last} were read",
                f"Check the label, {argument('start')} and {argument('end')}.",
            )
        start = label.approach_start
        approach_s = -math.inf if start is None else time_of(start)
        contacts.append(stopping.contact(label, time_of(collision), approach_s))
    near_s = np.array([time_of(number) for number in case.near if first <= number <= last])
    ttc_s = blind = None
    if strength is None:
        strength, ttc_s, blind = result.strength, result.ttc_s, result.blind != ""
    common = frame_s, result.is_repeat, frame, near_s
    return Signal(time_s, strength, tuple(contacts), *common, ttc_s=ttc_s, blind=blind)


class Candidates:
    """The candidates, and the videos on which they are scored; videos are added one by one.

    Parameters
    ----------
    stopping : Stopping, optional
        The speed and braking of drones before the contacts.
    baselines : bool
        Whether the sum of P and the LK divergence are candidates, too.

    Attributes
    ----------
    by_label : dict of str to Candidate
        The candidates by label, models first.
    cases : list of Case
        The videos for which all candidates have a result.
    failed : dict of str to str
        The reason why each of the other videos cannot be scored, by name.
    """

    def __init__(self, stopping: Stopping | None = None, *, baselines: bool = False) -> None:
        self.by_label: dict[str, Candidate] = {}
        self.cases: list[Case] = []
        self.failed: dict[str, str] = {}
        self.stopping, self._has_baselines = stopping or Stopping(), baselines

    def signals(self, label: str) -> list[Signal]:
        """The signals of a candidate, in the order of the videos."""
        return [self.by_label[label].signals[case.name] for case in self.cases]

    def add(self, case: Case, results: Results) -> None:
        """Add the results of a video, or note why it cannot be scored."""
        try:
            self._add(case, results)
        except DlgmdError as error:
            self.failed[case.name] = error.reason.rstrip(".")

    def _add(self, case: Case, results: Results) -> None:
        """Add the results of a video; raises DlgmdError if it cannot be scored."""
        if isinstance(results, DlgmdError):
            raise results
        entries: list[tuple[str, Result, Parameters | None, Signal]] = [
            (label, result, result.params, signal_of(result, case, self.stopping))
            for label, result in results.items()
            if label != FLOW
        ]
        first = entries[0][1]
        if self._has_baselines:
            flow = results.get(FLOW)
            # Stored results have no flow: the baseline then uses the first model's result.
            basis = first if flow is None else flow
            signal = signal_of(basis, case, self.stopping, basis.p_sum / basis.n_cells)
            entries.append((P_SUM, basis, None, signal))
            if flow is not None:
                signal = signal_of(flow, case, self.stopping, flow.mp / flow.n_cells)
                entries.append((FLOW, flow, None, signal))
        if case.truth is not None:
            n_frames = first.record["input"]["frames"] if first.complete else math.inf
            if line := misfit(case.truth, n_frames, first.frame, first.time_s):
                warn(line)
        for label, _, params, _ in entries:
            if label in self.by_label and self.by_label[label].params != params:
                why = f"the result of {case.name} ({label}) has other parameters than those before"
                raise ResultError(case.name, why, "Run 'dlgmd batch' again.")
        for label, result, params, signal in entries:
            n_sp = result.params.n_sp if params is None else result.rule.n_in_a_row
            by_sequence = result.by_sequence
            candidate = Candidate(label, n_sp, params, by_sequence, result.record)
            self.by_label.setdefault(label, candidate).signals[case.name] = signal
        self.cases.append(case)


def add_all(
    candidates: Candidates,
    labels: Path,
    cases: Sequence[Case],
    outcomes: Iterator[tuple[Case, Results]],
    progress: Progress,
) -> None:
    """Add the videos to the candidates, in their order; logs those that fail.

    Raises SourceError if no video can be scored.
    """
    by_name = {}
    with progress("evaluate", len(cases), "video") as advance:
        for number, (case, results) in enumerate(outcomes, start=1):
            by_name[case.name] = results
            advance(number)
    for case in cases:
        candidates.add(case, by_name[case.name])
    for name, why in candidates.failed.items():
        _log.error("%s: %s", name, why)
    doubts = {
        name: doubt
        for name, results in by_name.items()
        if not isinstance(results, DlgmdError)
        for result in results.values()
        for doubt in result.warnings[:1]
    }
    for name, doubt in [*doubts.items()][:1]:
        warn(f"{counted(len(doubts), 'video')} with warnings, such as {name}: {doubt}")
    if not candidates.cases:
        raise SourceError(str(labels), "no video could be scored")


def run_cases(
    cases: Sequence[Case], request: Request, jobs: int | None
) -> Iterator[tuple[Case, Results]]:
    """Run all models over every video; yields each video with its results, or its error.

    Videos come in order of completion. Each video is decoded once, in one of `jobs` processes. An
    error other than a DlgmdError is raised.
    """
    return results_of(partial(_run, request), cases, jobs)


def _run(request: Request, case: Case) -> dict[str, Result]:
    """The results of all models on one video."""
    try:
        angles = {name: getattr(case.labels[0], name) for name in ANGLES}
        missing = {name: v for name, v in angles.items() if getattr(request.options, name) is None}
        options = replace(request.options.beside(case.path), **missing)
        if any(setup.params.alarm == CORRIDOR for setup in request.setups):
            options = replace(options, heading=case.heading)
        request = replace(request, options=options)
        with request.open(case.path) as video:
            results = run_models(video, request)
            require_response(video, request, results)
    except SourceError:
        if is_url(case.path) or Path(case.path).exists():
            raise
        folder = Path(os.path.abspath(case.path)).parent
        hint = "Paths in labels start at the folder of their table."
        raise SourceError(case.name, f"it is not in {folder}", hint) from None
    return {setup.label: result for setup, result in zip(request.setups, results, strict=True)}


def flow_setup() -> Setup:
    """The baseline of tracked corners' expansion rate, on the same frames as the preset flight."""
    flight = call.choose()
    config = replace(flight.config, named={})
    return replace(flight, params=LkDivergenceParameters(), label=FLOW, config=config)


def left_out(failed: Mapping[str, str], n_scored: int) -> DlgmdError | None:
    """The error if some videos could not be scored."""
    if not failed:
        return None
    why = f"{len(failed)} of {len(failed) + n_scored} videos could not be scored and are left out"
    return DlgmdError("", why, "Fix or remove them, then run again.")


def stored_results(folder: Path, cases: Sequence[Case]) -> Iterator[tuple[Case, Results]]:
    """Every video with its results, read from the folder of a batch, or with its error.

    Raises ResultError if `folder` is not the folder of a batch.
    """
    is_single = (folder / SUMMARY).is_file()
    pattern = SUMMARY if is_single else f"*/{SUMMARY}"
    places = [path.parent for path in sorted(folder.glob(pattern))]
    if not places:
        why = f"it holds no results of a batch (no {SUMMARY})"
        raise ResultError(str(folder), why, "Run 'dlgmd batch' first.")
    label, stored = "", {place.name: StoredResults(place) for place in places}
    others = {}
    for case in cases:
        try:
            results = {
                name: read_result(batch.folder_of(case.path, case.name))
                for name, batch in stored.items()
            }
        except DlgmdError as error:
            yield case, error
            continue
        if is_single:
            (result,) = results.values()
            record = result.record
            name = f"set{record['set']}" if "set" in record else record.get("preset")
            label = label or str(name or record["model"])
            results = {label: result}
        if other := next(filter(None, (_other_angles(case, one) for one in results.values())), ""):
            others[case.name] = other
        yield case, results
    for name, other in [*others.items()][:1]:
        what = f"the results of {counted(len(others), 'video')} were made with other camera angles"
        warn(f"{what} than the labels have, such as {name}: {other}; run 'dlgmd batch' with them")


def _other_angles(case: Case, result: Result) -> str:
    """The camera angles of a stored result that are not those of the labels; empty for none."""
    if not result.rule.uses_expansion:
        return ""
    wanted = {name: getattr(case.labels[0], name) for name in ANGLES}
    camera = {**wanted, **result.record.get("camera", {})}
    return ", ".join(
        f"{name} {camera[name]:g} instead of {angle:g}"
        for name, angle in wanted.items()
        if angle is not None and camera[name] != angle
    )
