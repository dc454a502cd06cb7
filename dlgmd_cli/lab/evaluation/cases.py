"""Labelled videos, and the results of models on them: computed here, or read from a batch."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from dlgmd_cli import cancel
from dlgmd_cli.errors import DlgmdError, ResultError, SourceError
from dlgmd_cli.lab.evaluation.scoring import CONTACT_FRAMES, Signal
from dlgmd_cli.models.detection import Flags, Series, absolute
from dlgmd_cli.parameters import FlowDivergenceParameters, Parameters
from dlgmd_cli.pool import run_tasks
from dlgmd_cli.results import store
from dlgmd_cli.results.labels import Label, read_labels
from dlgmd_cli.results.result import Result, read_result
from dlgmd_cli.runs.run import run_input
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.video.options import InputOptions

SUMMARY = "summary.csv"
P_SUM, FLOW = "ΣP alone", "flow divergence"


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
    """

    name: str
    path: str
    collisions: tuple[int, ...]
    targets: tuple[str, ...]

    def of_target(self, chosen: Iterable[str]) -> Flags:
        """Which collisions are with one of these targets."""
        wanted = set(chosen)
        return np.array([self.targets[i] in wanted for i in range(len(self.collisions))], np.bool_)


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
    return Case(video, where, collisions, tuple(one.target for one in ordered))


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
    signals : dict of str to Signal
        The thresholded signal of each video, by the video's name in the labels.
    record : dict
        The record (run.yaml) of one of its results.
    """

    label: str
    n_sp: int
    params: Parameters | None
    by_sequence: bool = False
    signals: dict[str, Signal] = field(default_factory=dict)
    record: dict[str, Any] = field(default_factory=dict)

    @property
    def threshold(self) -> float | None:
        """The strength at which the normalised potential reaches T_MP; None for a baseline."""
        if self.params is None or self.by_sequence:
            return None if self.params is None else self.params.t_mp
        return strength_at(self.params.t_mp, self.params.kappa)

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
    cases: Sequence[Case], setups: Sequence[Setup], options: InputOptions, jobs: int
) -> Iterator[tuple[Case, "list[Result] | DlgmdError"]]:
    """Run all setups over every video; yields each video with one result per setup, or its error.

    Videos come in the order in which they end. Each is decoded once, in one of `jobs` processes. An
    error that is not a DlgmdError is raised.
    """
    if jobs == 1:
        for case in cases:
            try:
                yield case, _run(tuple(setups), options, case)
            except DlgmdError as error:
                yield case, error
            cancel.check()
        return
    for case, outcome in run_tasks(partial(_run, tuple(setups), options), cases, jobs):
        if outcome.error is not None and not isinstance(outcome.error, DlgmdError):
            raise outcome.error
        yield case, outcome.error or outcome.value


def _run(setups: tuple[Setup, ...], options: InputOptions, case: Case) -> list[Result]:
    """All models over one video."""
    return run_input(case.path, setups, options)


def with_flow(setups: Sequence[Setup]) -> list[Setup]:
    """The setups, and the divergence of optical flow at the frame size and rate of the first."""
    first = setups[0]
    params = FlowDivergenceParameters(n_sp=first.params.n_sp)
    return [*setups, replace(first, params=params, label=FLOW, engine="auto")]


def stored_results(
    folder: Path, cases: Sequence[Case]
) -> Iterator[tuple[Case, "dict[str, Result] | DlgmdError"]]:
    """Every video with its results by label, read from the folder of a batch, or its error."""
    places = stored_models(folder)
    for case in cases:
        try:
            yield case, {label: _stored(place, case) for label, place in places.items()}
        except DlgmdError as error:
            yield case, error


def stored_models(folder: Path) -> dict[str, Path]:
    """The folder of each model of a batch, by label; raises ResultError if there is none."""
    if (folder / SUMMARY).is_file():
        return {"": folder}
    found = {path.parent.name: path.parent for path in sorted(folder.glob(f"*/{SUMMARY}"))}
    if not found:
        why = f"it holds no results of a batch (no {SUMMARY})"
        raise ResultError(str(folder), why, "Run 'dlgmd batch' first.")
    return found


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
    """

    def __init__(self, *, baselines: bool = True) -> None:
        self.candidates: dict[str, Candidate] = {}
        self.cases: list[Case] = []
        self._has_baselines = baselines

    def add(self, case: Case, results: Mapping[str, Result]) -> None:
        """Add the results of a video, by label; raises DlgmdError if it cannot be scored."""
        found: dict[str, tuple[Result, Signal]] = {
            label: (result, signal_of(result, case)) for label, result in results.items()
        }
        first = next(iter(results.values()))
        if self._has_baselines:
            p_sum = first.p_sum / first.n_cells
            found.pop(FLOW, None)
            found[P_SUM] = (first, signal_of(first, case, p_sum))
            if FLOW in results:
                flow = results[FLOW]
                found[FLOW] = (flow, signal_of(flow, case, flow.mp / flow.n_cells))
        for label, (result, _) in found.items():
            known = self.candidates.get(label)
            if known and known.params not in (None, result.params):
                why = f"the result of {case.name} ({label}) has other parameters than those before"
                raise ResultError(case.name, why, "Run 'dlgmd batch' again.")
        for label, (result, signal) in found.items():
            if label not in self.candidates:
                is_baseline = label in (P_SUM, FLOW)
                self.candidates[label] = Candidate(
                    label,
                    first.params.n_sp if is_baseline else result.params.n_sp,
                    None if is_baseline else result.params,
                    result.by_sequence and not is_baseline,
                    record=result.record,
                )
            self.candidates[label].signals[case.name] = signal
        self.cases.append(case)
