"""`compare`: several models over one video, decoded once, and their comparison."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from dlgmd_cli.errors import argument, counted
from dlgmd_cli.parameters.checks import refuse, require_known
from dlgmd_cli.parameters.facts import (
    InputFacts,
    Json,
    ModelFacts,
    Record,
    Summary,
    Value,
    defined,
    for_json,
    stating,
)
from dlgmd_cli.parameters.presets import MODELS
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.annotations import KINDS, Annotations
from dlgmd_cli.results.csv import Cells
from dlgmd_cli.results.files import COMPARED, DRAWN_TOGETHER
from dlgmd_cli.results.labels import first_collision
from dlgmd_cli.results.names import numbered
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.results.record import model_entry, record_text
from dlgmd_cli.results.result import INFINITE_DISTINGUISHABILITY, Result
from dlgmd_cli.tasks import call
from dlgmd_cli.tasks.call import RUN_ARGUMENTS, ModelName, ModelNames, Progress, Setup, no_progress
from dlgmd_cli.tasks.stepping import answers_of, require_response
from dlgmd_cli.video.opening import Openable

# The models with which the default is compared.
COMPARED_MODELS = ("lgmd", "emd-lgmd")
# Key of a summary -> title of its column and form of its cells.
_COLUMNS = {
    "rule": ("rule", "{}"),
    "mp_max_frame": ("peak frame", "{}"),
    "first_spike_time_s": ("first spike", "{:.3f} s"),
    "first_alarm_frame": ("first alarm", "frame {}"),
    "first_alarm_side": ("region", "{}"),
    "sharpness": ("sharpness", "{:.3f}"),
    "distinguishability": ("distinguishability", "{:.4g}"),
}


@dataclass(eq=False, repr=False)
class Comparison(Outcome):
    """The results of several models on one video.

    Attributes
    ----------
    results : dict of str to Result
        By the models' labels, in order.
    annotations : Annotations
        Marked frames in the figures. Distinguishability is measured at the false positive's frame.
    remarks : list of str
        Further warnings, not about a single result.
    """

    RECORD = store.COMPARISON
    STEM = "compare-{}"
    FIGURES = dict.fromkeys(KINDS, "traces.plot")
    WRITTEN = DRAWN_TOGETHER

    results: Mapping[str, Result]
    annotations: Annotations = field(default_factory=Annotations)
    remarks: list[str] = field(default_factory=list)

    def __repr__(self) -> str:
        alarms = "; ".join(
            f"{label} {counted(result.summary['alarms'], 'alarm')}"
            for label, result in self.results.items()
        )
        first = next(iter(self.results.values()))
        return f"<Comparison on {first.name}, {counted(len(first), 'frame')}: {alarms}>"

    @property
    def complete(self) -> bool:
        """Whether the whole input was used."""
        return next(iter(self.results.values())).complete

    @property
    def interrupted(self) -> bool:
        """Whether the user stopped the comparison."""
        return next(iter(self.results.values())).interrupted

    @property
    def warnings(self) -> list[str]:
        """The warnings, each once; warnings about some results have a label and a number."""
        lines, labels_of = [*self.remarks], dict[str, list[str]]()
        for label, result in self.results.items():
            doubt = [] if result.n_valid else ["too few frames for an answer"]
            for line in dict.fromkeys([*result.warnings, *doubt]):
                labels_of.setdefault(line, []).append(label)
        for line, (label, *others) in labels_of.items():
            more = f" and {counted(len(others), 'other model')}" if others else ""
            is_common = len(others) + 1 == len(self.results)
            lines.append(line if is_common else f"{label}{more}: {line}")
        first = next(iter(self.results.values()))
        lines += self.annotations.outside(int(first.frame[0]), int(first.frame[-1]))
        return list(dict.fromkeys(lines))

    def cells(self) -> Cells:
        """The rows of compare.csv, in long form."""
        rows = (
            [label, *values]
            for label, result in self.results.items()
            for values in result.columns(csv.COMPARISON[1:]).tolist()
        )
        return {COMPARED: (csv.COMPARISON, rows)}

    @property
    def record(self) -> Record:
        """Contents of compare.yaml without the versions."""
        first, contact = next(iter(self.results.values())).record, self.annotations.collision_frame
        labelled: Record = {} if contact is None else {"collision_frame": contact}
        models: list[ModelFacts] = []
        for label, summary in self.summaries().items():
            of = self.results[label]
            entry: Record = {**model_entry(label, of.record, of.params), "summary": summary}
            models.append(entry)
        return {
            "input": first["input"],
            **labelled,
            "models": models,
            "options": first["options"],
            "warnings": self.warnings,
            "complete": self.complete,
            "interrupted": self.interrupted,
        }

    def record_text(self) -> str:
        """The text of compare.yaml."""
        return record_text(self.record)

    def identity(self) -> InputFacts:
        """The facts that identify the input."""
        return next(iter(self.results.values())).identity()

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """The kind, the results by their labels, and the annotations."""
        return kind, self.results, self.annotations

    def summaries(self) -> dict[str, Summary]:
        """The summary of each result, with its sharpness and distinguishability, by label."""
        false_positive = self.annotations.false_positive_frame
        by_label: dict[str, Summary] = {}
        for label, result in self.results.items():
            by_label[label] = {**result.summary, "sharpness": defined(result.sharpness)}
            if false_positive is not None:
                ratio = result.distinguishability(false_positive)
                by_label[label]["distinguishability"] = defined(ratio)
        return by_label

    def facts(self) -> dict[str, Json]:
        """The contents of the JSON output; infinity as text."""
        models = {label: for_json(summary) for label, summary in self.summaries().items()}
        return {
            "result": str(self.paths[0]) if self.paths else None,
            "complete": self.complete,
            "warnings": self.warnings,
            "models": models,
        }

    def shown(self) -> Iterator[Shown]:
        """The summaries as a table, and where the files are."""
        summaries = self.summaries()
        first = next(iter(summaries.values()))
        columns = {k: v for k, v in _COLUMNS.items() if k != "distinguishability" or k in first}
        rows = []
        for label, summary in summaries.items():
            if not summary["mp_max"]:  # a potential of 0 in all frames has no peak
                summary["mp_max_frame"] = None
            cells = (
                "–" if summary.get(key) is None else form.format(summary.get(key))
                for key, (_, form) in columns.items()
            )
            rows.append((label, *cells))
        yield ("model", *(title for title, _ in columns.values())), rows
        if any(summary.get("distinguishability") == math.inf for summary in summaries.values()):
            yield INFINITE_DISTINGUISHABILITY
        yield from self.paths

    def kept(self) -> str:
        """A line about the frames kept after an interruption."""
        n_frames = counted(len(next(iter(self.results.values()))), "frame")
        part = f"the {n_frames} processed before the interruption"
        return f"{self.paths[0]} holds {part if self.interrupted else 'the whole result'}"


@stating(RUN_ARGUMENTS)
def compare(
    video: Openable,
    model: ModelName | ModelNames | None = None,
    *,
    formulation: str | None = None,
    param: Mapping[str, Value] | None = None,
    marks: Iterable[tuple[int, str]] = (),
    spans: Iterable[tuple[int, int, str]] = (),
    collision_frame: int | None = None,
    false_positive_frame: int | None = None,
    collisions: str | os.PathLike[str] | None = None,
    out: str | os.PathLike[str] | None = None,
    formats: Iterable[str] = (),
    dpi: int = 200,
    width: Literal["one", "two"] = "one",
    until: str | None = None,
    one_panel: bool = False,
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> Comparison:
    """Run several models over a video, as `dlgmd compare` does.

    Parameters
    ----------
    video : str, path, or iterable of ndarray
        The input, as in `run`.
    model, formulation, param
        The models, as in `run`, or "all" for every model of the package. Without any, the preset
        `flight` is compared with the LGMD and the EMD-LGMD.
    marks, spans : iterable of (int, str), of (int, int, str)
        Labels of frames and of ranges of frames in the figures; a mark of one model begins with
        the model's label.
    collision_frame, false_positive_frame : int, optional
        Frame of the true collision, and of a false alarm, to measure the distinguishability.
    collisions : str or path, optional
        A table of labels, as in `evaluate`: the video's first collision is the `collision_frame`.
    until : "collision", optional
        The figures show only the time up to the collision.
    one_panel : bool
        The figures show the highest panel alone: the potentials without spikes and alarms.
    out : str or path, optional
        Write the files of `dlgmd compare` into ``out/NAME``, with figures in `formats` (PNG with
        `dpi`, `width` in columns of a paper); `overwrite` replaces an earlier comparison.
    progress
        As in `batch`.
    options
        Options of the input, as in `run`.

    Returns
    -------
    Comparison
        `results` has the result of each model by its label; `table` has the rows of compare.csv.

    Raises
    ------
    SourceError, ParameterError, MissingExtraError, OutputError, OutputExistsError
        As in `run`.

    Examples
    --------
    >>> found = compare("flight.mp4", [3, 9, "lgmd"])  # doctest: +SKIP
    >>> found.results["lgmd"].summary["alarms"]  # doctest: +SKIP
    1
    """
    collision_frame = first_collision(video, collision_frame, collisions)
    if model is None:
        model = [call.DEFAULT_PRESET, *COMPARED_MODELS]
    elif model == "all":
        model = [*MODELS]
    request = call.fold(model, formulation, param, options, video, repeats_record=False)
    labels = numbered([setup.label for setup in request.setups])
    labelled = zip(request.setups, labels, strict=True)
    setups = tuple(replace(setup, label=label) for setup, label in labelled)
    request = replace(request, setups=setups)
    notes = Annotations(tuple(marks), tuple(spans), collision_frame, false_positive_frame)
    notes.require(labels)
    formats = store.known_formats(formats, store.COMPARISON)
    if out is not None and not formats:
        refuse(
            {"one_panel": one_panel},
            f"works only with a figure, not with {argument('formats', 'none')}",
        )
    if until is not None:
        require_known("until", until, ("collision",))
    with call.opened(video, request, store.COMPARISON, out, overwrite=overwrite) as (source, claim):
        answers = answers_of(source, request, progress)
        failure = answers[0].failure
        answers = [result.until(collision_frame) for result in answers]
        results = dict(zip(labels, answers, strict=True))
        require_response(source, request, answers)
        compared = Comparison(results, notes, _unused(request.setups))
        compared.failure = failure
        call.warn_of_input(source, request, compared.warnings)
        if claim is not None:
            look = {"width": width, "until": until, "one_panel": one_panel}
            compared.write(claim, compared.files(formats, dpi, **look))
    return compared


def _unused(setups: Sequence[Setup]) -> list[str]:
    """A warning for each file whose recorded options are not used."""
    lines = []
    for setup in setups:
        recorded = setup.options.to_record()
        described = "scale", "size", "mask_sha256", "heading_sha256"
        left_out = [key for key in recorded if key not in described]
        if left_out:
            lines.append(
                f"{setup.config.name}: its recorded options ({', '.join(left_out)}) are not used; "
                "give them on the command line"
            )
    return lines
