"""The models and baselines that are scored, with the signal of each labelled video."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dlgmd_cli.errors import DlgmdError, ResultError, SourceError
from dlgmd_cli.frame import Series
from dlgmd_cli.models.detection import absolute
from dlgmd_cli.parameters.presets import Parameters
from dlgmd_cli.results.labels import Case
from dlgmd_cli.results.result import Result
from dlgmd_cli.results.scoring import CONTACT_FRAMES, Signal

P_SUM, FLOW = "ΣP alone", "flow divergence"

# The results of a video by the models' labels, or why there are none.
Results = dict[str, Result] | DlgmdError


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
    ttc_s = None
    if strength is None:
        strength, ttc_s = result.mp / result.n_cells, result.ttc_s
        strength = result.mp_seq if result.by_sequence else strength
    signal = Signal(time_s, strength, tuple(contacts_s), frame_s, result.is_repeat, frame)
    return replace(signal, ttc_s=ttc_s)


class Candidates:
    """The candidates, and the videos on which they are scored; videos are added one by one.

    Attributes
    ----------
    by_label : dict of str to Candidate
        By label, models first.
    cases : list of Case
        The videos for which all candidates have a result.
    failed : dict of str to str
        Why the other videos cannot be scored, by name.
    """

    def __init__(self, *, baselines: bool = True) -> None:
        self.by_label: dict[str, Candidate] = {}
        self.cases: list[Case] = []
        self.failed: dict[str, str] = {}
        self._has_baselines = baselines

    def signals(self, label: str) -> list[Signal]:
        """The signals of a candidate, in the order of the videos."""
        return [self.by_label[label].signals[case.name] for case in self.cases]

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
            flow = results.get(FLOW)
            # Of results that are there already, those of the first model have to do.
            basis = first if flow is None else flow
            found.append((P_SUM, basis, None, signal_of(basis, case, basis.p_sum / basis.n_cells)))
            if flow is not None:
                found.append((FLOW, flow, None, signal_of(flow, case, flow.mp / flow.n_cells)))
        for label, _, params, _ in found:
            if label in self.by_label and self.by_label[label].params != params:
                why = f"the result of {case.name} ({label}) has other parameters than those before"
                raise ResultError(case.name, why, "Run 'dlgmd batch' again.")
        for label, result, params, signal in found:
            if label not in self.by_label:
                n_sp = result.params.n_sp
                by_sequence = params is not None and result.by_sequence
                self.by_label[label] = Candidate(label, n_sp, params, by_sequence, result.record)
            self.by_label[label].signals[case.name] = signal
        self.cases.append(case)
