"""Labelled videos, and the results of models on them: computed here, or read from a batch."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from dlgmd_cli.checks import shown
from dlgmd_cli.errors import DlgmdError, ParameterError, ResultError, SourceError
from dlgmd_cli.lab.evaluation.scoring import CONTACT_FRAMES, Signal
from dlgmd_cli.models.detection import Flags, Series, absolute
from dlgmd_cli.parameters import FlowDivergenceParameters, Parameters
from dlgmd_cli.pool import results_of
from dlgmd_cli.results import store
from dlgmd_cli.results.labels import Label, read_labels
from dlgmd_cli.results.result import Result, read_result
from dlgmd_cli.runs.run import run_input
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.threads import n_processors
from dlgmd_cli.video.options import InputOptions

SUMMARY = "summary.csv"
P_SUM, FLOW = "ΣP alone", "flow divergence"

# The results of a video by the models' labels, or why there are none.
Results = dict[str, Result] | DlgmdError


@dataclass(frozen=True)
class Case:
    """A labelled video.

    Attributes
    ----------
    name : str
        Its name in the labels.
    path : str
        Its path.
    collisions : tuple of int
        The frames of its collisions, increasing; empty if there is none.
    targets : tuple of str
        The target of each label, in the order of the collisions.
    kind, manner : str
        The kind of footage, and how it was flown, see `Label`.
    """

    name: str
    path: str
    collisions: tuple[int, ...]
    targets: tuple[str, ...]
    kind: str = ""
    manner: str = ""

    def of_target(self, wanted: Collection[str]) -> Flags:
        """Which collisions are with one of these targets."""
        targets = self.targets[: len(self.collisions)]
        return np.array([target in wanted for target in targets], np.bool_)


def read_cases(path: Path) -> list[Case]:
    """The videos that labels list, in their order; raises ResultError."""
    by_video: dict[str, list[Label]] = {}
    for label in read_labels(path):
        by_video.setdefault(label.video, []).append(label)
    if not by_video:
        raise ResultError(str(path), "lists no video", "Add a line for each, as flight.mp4,120.")
    return [_case(path, video, labels) for video, labels in by_video.items()]


def _case(path: Path, video: str, labels: Sequence[Label]) -> Case:
    """The labels of one video as a case; raises ResultError if they contradict each other."""
    frames = [one.collision_frame for one in labels]
    if len(set(frames)) < len(frames):
        what = "no frame" if None in frames else f"frame {max(f for f in frames if f is not None)}"
        raise ResultError(str(path), f"{video} is listed twice with {what}", "Remove one line.")
    if None in frames and len(frames) > 1:
        why = f"{video} is listed with a collision and without one"
        raise ResultError(str(path), why, "Remove one of the lines.")
    ordered = sorted(labels, key=lambda one: one.collision_frame or 0)
    collisions = tuple(one.collision_frame for one in ordered if one.collision_frame is not None)
    where = str(path.parent / video)
    targets = tuple(one.target for one in ordered)
    return Case(video, where, collisions, targets, ordered[0].kind, ordered[0].manner)


def of_kind(cases: Sequence[Case], kind: str | None) -> Flags:
    """Which videos are of a kind; all of them for None. Raises ParameterError if none is."""
    if kind is None:
        return np.ones(len(cases), np.bool_)
    kinds = {case.kind for case in cases} - {""}
    if kind not in kinds:
        mend = (
            f"Choose from {', '.join(sorted(kinds))}." if kinds else "Add the column kind to them."
        )
        why = f"no video in the labels is of the kind {shown(kind)}"
        raise ParameterError("Invalid value for '--max-false-per-min'", why, mend)
    return np.array([case.kind == kind for case in cases], np.bool_)


@dataclass
class Candidate:
    """A model that is scored, or a baseline, which has no threshold of its own.

    Attributes
    ----------
    label : str
        Its name in tables.
    n_sp : int
        Number of successive spikes that raise an alarm.
    params : Parameters or None
        The model's parameters; None for a baseline.
    by_sequence : bool
        Whether the potential is normalised by its own sequence.
    record : dict
        The record (run.yaml) of one of its results.
    signals : dict of str to Signal
        The thresholded signal of each video, by the video's name in the labels.
    """

    label: str
    n_sp: int
    params: Parameters | None
    by_sequence: bool
    record: dict[str, Any]
    signals: dict[str, Signal] = field(default_factory=dict)

    @property
    def threshold(self) -> tuple[float, float] | None:
        """T_MP, and the strength at which the potential reaches it; None for a baseline."""
        if self.params is None:
            return None
        t_mp, kappa = self.params.t_mp, self.params.kappa
        return t_mp, t_mp if self.by_sequence else strength_at(t_mp, kappa)

    def level(self, strength: float) -> float:
        """The normalised potential at a strength; for a baseline, the strength itself."""
        if self.params is None or self.by_sequence or np.isinf(strength):
            return strength
        return float(absolute(strength, 1, self.params.kappa))


def strength_at(level: float, kappa: float | None) -> float:
    """The mean excitation at which `detection.absolute` is `level`."""
    with np.errstate(divide="ignore"):
        odds = float(np.divide(level, 1.0 - level))
        return float(np.log(odds)) if kappa is None else kappa * odds


def run_cases(
    cases: Sequence[Case], setups: Sequence[Setup], options: InputOptions, jobs: int | None
) -> Iterator[tuple[Case, Results]]:
    """Run all setups over every video; yields each video with its results, or its error.

    Videos come in the order in which they end. Each is decoded once, in one of `jobs` processes. An
    error that is not a DlgmdError is raised.
    """
    run = partial(_run, tuple(setups), options)
    return results_of(run, cases, max(1, min(jobs or n_processors(), len(cases))))


def _run(setups: tuple[Setup, ...], options: InputOptions, case: Case) -> dict[str, Result]:
    """All models over one video."""
    results = run_input(case.path, setups, options)
    return {setup.label: one for setup, one in zip(setups, results, strict=True)}


def with_flow(setups: Sequence[Setup]) -> list[Setup]:
    """The setups, and the divergence of optical flow at the frame size and rate of the first."""
    first = setups[0]
    params = FlowDivergenceParameters(n_sp=first.params.n_sp)
    return [*setups, replace(first, params=params, label=FLOW, engine="auto")]


def stored_results(folder: Path, cases: Sequence[Case]) -> Iterator[tuple[Case, Results]]:
    """Every video with its results, read from the folder of a batch, or its error.

    Raises ResultError if it is not the folder of a batch.
    """
    is_single = (folder / SUMMARY).is_file()
    pattern = SUMMARY if is_single else f"*/{SUMMARY}"
    places = [path.parent for path in sorted(folder.glob(pattern))]
    if not places:
        why = f"it holds no results of a batch (no {SUMMARY})"
        raise ResultError(str(folder), why, "Run 'dlgmd batch' first.")
    label = ""
    for case in cases:
        try:
            found = {place.name: _stored(place, case) for place in places}
        except DlgmdError as error:
            yield case, error
            continue
        if is_single:
            (result,) = found.values()
            record = result.record
            own = f"set{record['set']}" if "set" in record else record.get("preset")
            label = label or str(own or record["model"])
            found = {label: result}
        yield case, found


def _stored(place: Path, case: Case) -> Result:
    """The result of a video; its folder has the video's name, with or without the extension."""
    name = PurePosixPath(case.name)
    for folder in (place / name, place / name.with_suffix("")):
        if (folder / store.RUN).is_file():
            result = read_result(folder)
            if PurePosixPath(str(result.record["input"].get("path"))).name == name.name:
                return result
    raise ResultError(str(place), f"there is no result of {case.name}", "Run 'dlgmd batch' again.")


def signal_of(result: Result, case: Case, strength: Series | None = None) -> Signal:
    """The thresholded signal of a result, with the times of the labelled collisions.

    Unless given, `strength` is the mean excitation per cell; if the spikes follow the potential
    normalised by its own sequence, it is that potential. Raises SourceError if the video was not
    read up to its end, or ends before a collision.
    """
    if not result.record.get("complete", True):
        raise SourceError(case.name, "its result was interrupted", "Run again.")
    frame, time_s = result.frame, result.time_s
    frame_s = 1.0 / float(result.record["input"]["fps"])
    # The last frames may have been dropped to reduce the frame rate.
    first, last = int(frame[0]), max(int(frame[-1]), result.record["input"]["frames"] - 1)
    for collision in case.collisions:
        if not first <= collision <= last + CONTACT_FRAMES:
            raise SourceError(
                case.name,
                f"its collision is at frame {collision}, but frames {first} to {last} were read",
                "Check the label, --start and --end.",
            )
    contacts_s = [
        float(np.interp(one, frame, time_s)) + max(one - int(frame[-1]), 0) * frame_s
        for one in case.collisions
    ]
    if strength is None:
        strength = result.mp_seq if result.by_sequence else result.mp / result.n_cells
    return Signal(time_s, strength, tuple(contacts_s), frame_s, result.is_repeat, frame)


class Evaluation:
    """The candidates, and the videos on which they are scored; videos are added one by one.

    Attributes
    ----------
    candidates : dict of str to Candidate
        By label, models first.
    cases : list of Case
        The videos for which all candidates have a result.
    failed : dict of str to str
        Why the other videos cannot be scored, by name.
    """

    def __init__(self, *, baselines: bool = True) -> None:
        self.candidates: dict[str, Candidate] = {}
        self.cases: list[Case] = []
        self.failed: dict[str, str] = {}
        self._has_baselines = baselines

    def signals(self, label: str) -> list[Signal]:
        """The signals of a candidate, in the order of the videos."""
        return [self.candidates[label].signals[case.name] for case in self.cases]

    def add(self, case: Case, results: Results) -> None:
        """Add the results of a video, or note why it cannot be scored."""
        try:
            self._add(case, results)
        except DlgmdError as error:
            self.failed[case.name] = f"{error.why}. {error.mend}".strip().rstrip(".")

    def _add(self, case: Case, results: Results) -> None:
        """Add the results of a video; raises DlgmdError if it cannot be scored."""
        if isinstance(results, DlgmdError):
            raise results
        found: list[tuple[str, Result, Parameters | None, Signal]] = [
            (label, result, result.params, signal_of(result, case))
            for label, result in results.items()
            if label != FLOW
        ]
        first = found[0][1]
        if self._has_baselines:
            found.append((P_SUM, first, None, signal_of(first, case, first.p_sum / first.n_cells)))
            if FLOW in results:
                flow = results[FLOW]
                found.append((FLOW, flow, None, signal_of(flow, case, flow.mp / flow.n_cells)))
        for label, _, params, _ in found:
            if label in self.candidates and self.candidates[label].params != params:
                why = f"the result of {case.name} ({label}) has other parameters than those before"
                raise ResultError(case.name, why, "Run 'dlgmd batch' again.")
        for label, result, params, signal in found:
            if label not in self.candidates:
                n_sp = (params or first.params).n_sp
                by_sequence = params is not None and result.by_sequence
                self.candidates[label] = Candidate(label, n_sp, params, by_sequence, result.record)
            self.candidates[label].signals[case.name] = signal
        self.cases.append(case)
