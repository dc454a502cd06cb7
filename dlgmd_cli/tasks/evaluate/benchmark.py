"""The LGMD benchmark: the response of each model to each frame, scored against the truth."""

import json
import logging
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dlgmd_cli.errors import DlgmdError, SourceError, counted, warn
from dlgmd_cli.frame import Series
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.pool import results_of
from dlgmd_cli.models.base import create_model
from dlgmd_cli.parameters.checks import refuse
from dlgmd_cli.parameters.facts import Json, Value, extended, finite
from dlgmd_cli.results import benchmark, roc, store
from dlgmd_cli.results.benchmark import REST, means, response_of, separability
from dlgmd_cli.results.csv import Cell, Cells
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.results.record import record_text
from dlgmd_cli.tasks import call
from dlgmd_cli.tasks.call import ModelName, ModelNames, Progress, Request
from dlgmd_cli.tasks.evaluate.candidates import left_out
from dlgmd_cli.tasks.stepping import responses, session_on

_log = logging.getLogger(__name__)

RESPONSES = "responses.json"
COLUMNS = ("model", "class", "videos", "separability", "rank")
OF_SEQUENCES = ("model", "class", "video", "frames", "separability")
# Every frame is read, and a model gets it in its full size.
_WHOLE: dict[str, Any] = {"scale": 1.0, "fps": "all", "repeats": "keep"}
_TAKEN = ("input_fps", "decoder")


def score_benchmark(
    annotations: Path,
    model: ModelName | ModelNames | None,
    formulation: str | None,
    param: Mapping[str, Value] | None,
    options: Mapping[str, Any],
    *,
    jobs: int | None,
    progress: Progress,
) -> "Benchmark":
    """Score models on the videos of ``annotations.json``; for the arguments, see `evaluate`.

    Logs which videos cannot be scored. Raises SourceError if none can, and the errors of
    `evaluate`.
    """
    refuse(
        {name: value for name, value in options.items() if name not in _TAKEN},
        "has no effect: a response is scored, at each frame in its full size",
    )
    whole = {**_WHOLE, **{name: options.get(name) for name in _TAKEN}}
    request = call.fold(model, formulation, param, whole, repeats_record=False).by_spikes()
    setups = call.with_folder_labels(call.with_keys(request.setups, param or ()))
    for setup in setups:
        create_model(setup.params)  # raises now if a custom model cannot be created
    request = replace(request, setups=tuple(setups))
    sequences, failed = benchmark.read_annotations(annotations)
    by_name = {}
    with progress("evaluate", len(sequences), "video") as advance:
        outcomes = results_of(partial(_responses, request), sequences, jobs)
        for number, (one, outcome) in enumerate(outcomes, start=1):
            if isinstance(outcome, DlgmdError):
                failed[one.name] = outcome.reason.rstrip(".")
            else:
                by_name[one.name] = outcome
            advance(number)
    _log_failed(failed)
    if not by_name:
        raise SourceError(str(annotations), "no video could be scored")
    if names := benchmark.unlisted(annotations, {*by_name, *failed}):
        n_videos = counted(len(names), "video")
        warn(f"{annotations}: {n_videos} beside the others not listed, such as {names[0]}")
    scored = [one for one in sequences if one.name in by_name]
    of_models = {
        setup.label: {one.name: by_name[one.name][i] for one in scored}
        for i, setup in enumerate(setups)
    }
    return Benchmark(annotations, request, scored, of_models, failed)


def _log_failed(failed: Mapping[str, str]) -> None:
    """Log why videos cannot be scored: of those that differ only in numbers, the first one."""
    alike: dict[str, list[str]] = {}
    for name in sorted(failed):
        alike.setdefault(re.sub(r"\d+", "", failed[name]), []).append(name)
    for first, *others in alike.values():
        more = f", as with {counted(len(others), 'further video')}" if others else ""
        _log.error("%s: %s%s", first, failed[first], more)


def _responses(request: Request, one: benchmark.Sequence) -> list[Series]:
    """The response of each model to every frame of a video, on the benchmark's scale."""
    if not Path(one.path).is_file():
        raise SourceError(one.name, "it is missing")
    levels: list[list[float]] = []
    with request.open(one.path) as video:
        session = session_on(video, request.setups, request.options)
        for _, rows in responses(video, session):
            levels.append([row.mp_abs for row in rows])
    cancel.check()
    if len(levels) != len(one.truth):
        why = f"{counted(len(levels), 'frame')}, but {len(one.truth)} values of the truth"
        raise SourceError(one.name, why)
    every = np.array(levels, np.float64).T
    return [
        response_of(of_model, setup.params)
        for of_model, setup in zip(every, request.setups, strict=True)
    ]


@dataclass(eq=False, repr=False)
class Benchmark(Outcome):
    """The scores of models on the LGMD benchmark, as `evaluate` returns them.

    Attributes
    ----------
    annotations : Path
        The file of the annotations.
    request : Request
        The models, by label.
    sequences : list of Sequence
        The videos that were scored.
    responses : dict of str to dict of str to ndarray
        The responses of each model, by label, to each video, by name, 0.5 to 1, shape (n,).
    failed : dict of str to str
        The reasons why the other videos are left out.
    scores : dict of str to dict of str to float
        The score SA of each model and video.
    """

    RECORD: ClassVar[str] = "benchmark.yaml"
    TABLES: ClassVar[tuple[str, ...]] = (
        *("benchmark.csv", "sequences.csv", roc.AUC, roc.ROC),
        RESPONSES,
    )
    STEM: ClassVar[str] = "benchmark-{}"
    FIGURES: ClassVar[Mapping[str, str]] = {
        "scores": "separation.scores",
        "roc": "separation.curves",
    }

    annotations: Path
    request: Request
    sequences: list[benchmark.Sequence]
    responses: dict[str, dict[str, Series]]
    failed: dict[str, str]
    scores: dict[str, dict[str, float]] = field(init=False)
    separations: roc.Separations = field(init=False)

    def __post_init__(self) -> None:
        """Score the responses."""
        self.scores = {
            label: {one.name: separability(own[one.name], one.truth) for one in self.sequences}
            for label, own in self.responses.items()
        }
        self.separations = roc.separations(
            {
                label: [roc.Judged(own[one.name], one.truth > REST) for one in self.sequences]
                for label, own in self.responses.items()
            }
        )

    def __repr__(self) -> str:
        last = {label: [*own.values()][-1][1] for label, own in self.means().items()}
        scores = ", ".join(f"{label} {mean:.3f}" for label, mean in last.items())
        return f"<Benchmark on {counted(len(self.sequences), 'video')}: SA {scores}>"

    def means(self) -> dict[str, dict[str, tuple[int, float]]]:
        """Model -> class, or mean of several -> number of videos and score."""
        return {label: means(own, self.sequences) for label, own in self.scores.items()}

    @staticmethod
    def rank(score: float, others: Iterable[float]) -> float:
        """1 for the highest score; equal scores have equal ranks."""
        return math.nan if math.isnan(score) else 1 + sum(other > score for other in others)

    @property
    def failure(self) -> DlgmdError | None:  # type: ignore[override]
        """The error behind the exit code 1: some videos could not be scored."""
        return left_out(self.failed, len(self.sequences))

    def cells(self) -> Cells:
        """Columns and rows: scores by class and by video, AUC and the curves."""
        found = self.means()
        rows: list[list[Cell]] = []
        for label, own in found.items():
            for title, (n, score) in own.items():
                rank = self.rank(score, (other[title][1] for other in found.values()))
                rows.append([label, title, n, score, rank])
        by_video: list[list[Cell]] = [
            [label, one.group, one.name, len(one.truth), own[one.name]]
            for label, own in self.scores.items()
            for one in self.sequences
        ]
        return {
            "benchmark.csv": (COLUMNS, rows),
            "sequences.csv": (OF_SEQUENCES, by_video),
            **roc.cells(self.separations),
        }

    def tables(self) -> dict[str, store.Write]:
        """The functions that write the tables, and the responses as the benchmark stores them."""
        stored = {
            label: {"results": {name: own.tolist() for name, own in of_model.items()}}
            for label, of_model in self.responses.items()
        }
        return {**super().tables(), RESPONSES: store.file_of(json.dumps(stored))}

    def record_text(self) -> str:
        """The text of benchmark.yaml."""
        record = {
            "annotations": str(self.annotations.absolute()),
            "videos": len(self.sequences),
            "failed": dict(self.failed),
            "models": [
                extended(
                    {"label": setup.label, "model": setup.params.model}, setup.params.to_dict()
                )
                for setup in self.request.setups
            ],
            "options": self.request.options.to_record(),
        }
        return record_text(record)

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """The arguments of each figure, see `plots.separation`."""
        if kind == "roc":
            return (self.separations,)
        found = self.means().items()
        return ({label: {k: score for k, (_, score) in own.items()} for label, own in found},)

    def shown(self) -> Iterator[Shown]:
        """The scores of each class and their means, the response, and the AUC."""
        found = self.means()
        titles = [*next(iter(found.values()))]
        last = {label: own[titles[-1]][1] for label, own in found.items()}
        rows = [
            (
                label,
                *("–" if math.isnan(score) else f"{100 * score:.1f}" for _, score in own.values()),
                f"{self.rank(last[label], last.values()):g}",
            )
            for label, own in found.items()
        ]
        yield ("model", *titles, "rank"), rows
        yield f"{counted(len(self.sequences), 'video')}. SA in %, the benchmark's score."
        yield from self._responses_in_words()
        if areas := roc.table(self.separations):
            yield f"Frames and videos with a truth above {REST:g} against the others (95 %):"
            yield areas
        yield from self.paths

    def _responses_in_words(self) -> Iterator[str]:
        """What is scored of each model."""
        scaled: dict[str, list[str]] = {}
        for setup in self.request.setups:
            at_zero = float(response_of(np.zeros(1), setup.params)[0])
            what = "0.5 + mp_abs / 2" if at_zero == REST else "mp_abs, which is 0.5 at rest"
            scaled.setdefault(what, []).append(setup.label)
        yield from (f"Response of {', '.join(own)}: {what}." for what, own in scaled.items())

    def facts(self) -> dict[str, Json]:
        """The contents of the JSON output."""
        folder = str(self.paths[0].parent) if self.paths else None
        models: dict[str, Json] = {}
        for label, own in self.means().items():
            scores: dict[str, Json] = {title: finite(score) for title, (_, score) in own.items()}
            models[label] = {"separability": scores, **roc.areas_json(self.separations[label])}
        counts: dict[str, Json] = {"videos": len(self.sequences), "failed": {**self.failed}}
        return {"result": folder, **counts, "models": models}
