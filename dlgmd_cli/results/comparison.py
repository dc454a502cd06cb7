"""`Comparison`: the results of several models on one video."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from dlgmd_cli.errors import counted
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.annotations import KINDS, WRITTEN_TOGETHER, Annotations
from dlgmd_cli.results.names import numbered
from dlgmd_cli.results.outcome import Outcome, Shown, drawn_by
from dlgmd_cli.results.record import identity_in, record_text
from dlgmd_cli.results.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INFINITE_DISTINGUISHABILITY = (
    "inf: the membrane potential is 0 within 5 frames of the false positive."
)
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
        What the figures show beside; the frame of a false positive is one to measure at.
    remarks : list of str
        Warnings beside those of the results.
    """

    RECORD = store.COMPARISON
    TABLES = store.TABLES[store.COMPARISON]
    STEM = "compare-{}"
    FIGURES = dict.fromkeys(KINDS, "traces.plot")
    WRITTEN = WRITTEN_TOGETHER

    results: Mapping[str, Result]
    annotations: Annotations = field(default_factory=Annotations)
    remarks: list[str] = field(default_factory=list)

    def __repr__(self) -> str:
        said = "; ".join(
            f"{label} {counted(result.summary['alarms'], 'alarm')}"
            for label, result in self.results.items()
        )
        first = next(iter(self.results.values()))
        return f"<Comparison on {first.name}, {counted(len(first), 'frame')}: {said}>"

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """Whether the input was read to the requested end."""
        return next(iter(self.results.values())).complete

    @property
    def warnings(self) -> list[str]:
        """The warnings, each once; with a label and a number unless they are about every result."""
        lines, about = [*self.remarks], dict[str, list[str]]()
        for label, result in self.results.items():
            doubt = [] if result.n_valid else ["too few frames for an answer"]
            for line in dict.fromkeys([*result.warnings, *doubt]):
                about.setdefault(line, []).append(label)
        for line, (label, *others) in about.items():
            more = f" and {counted(len(others), 'other model')}" if others else ""
            is_common = len(others) + 1 == len(self.results)
            lines.append(line if is_common else f"{label}{more}: {line}")
        first = next(iter(self.results.values()))
        lines += self.annotations.outside(int(first.frame[0]), int(first.frame[-1]))
        return list(dict.fromkeys(lines))

    def cells(self) -> dict[str, Any]:
        """The rows of compare.csv, in long form."""
        rows = (
            [label, *values]
            for label, result in self.results.items()
            for values in csv.table_from(result.columns(csv.COMPARISON[1:])).tolist()
        )
        return {"compare.csv": (csv.COMPARISON, rows)}

    @property
    def record(self) -> dict[str, Any]:
        """Contents of compare.yaml without the versions."""
        first, contact = next(iter(self.results.values())).record, self.annotations.collision_frame
        return {
            "input": first["input"],
            **({} if contact is None else {"collision_frame": contact}),
            **{key: first[key] for key in ("settings",) if key in first},
            "models": [self._described(*item) for item in self.summaries().items()],
            "options": first["options"],
            "warnings": self.warnings,
            "complete": self.complete,
        }

    def record_text(self) -> str:
        """The text of compare.yaml."""
        return record_text(self.record, [r.record["engine"] for r in self.results.values()])

    def identity(self) -> dict[str, Any]:
        """What identifies the input."""
        return identity_in(next(iter(self.results.values())).record)

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """The kind, the results by their labels, and the annotations."""
        return kind, self.results, self.annotations

    def summaries(self) -> dict[str, dict[str, Any]]:
        """The summary of each result, with its sharpness and distinguishability, by label."""
        false_positive, by_label = self.annotations.false_positive_frame, {}
        for label, result in self.results.items():
            by_label[label] = {**result.summary, "sharpness": _defined(result.sharpness)}
            if false_positive is not None:
                ratio = result.distinguishability(false_positive)
                by_label[label]["distinguishability"] = _defined(ratio)
        return by_label

    def facts(self) -> dict[str, Any]:
        """What --json prints; infinity as text."""
        models = {
            label: {key: "inf" if value == math.inf else value for key, value in summary.items()}
            for label, summary in self.summaries().items()
        }
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
            if not summary["mp_max"]:  # a potential that is 0 throughout has no peak
                summary["mp_max_frame"] = None
            cells = (
                "–" if summary.get(key) is None else form.format(summary[key])
                for key, (_, form) in columns.items()
            )
            rows.append((label, *cells))
        yield ("model", *(title for title, _ in columns.values())), rows
        if any(summary.get("distinguishability") == math.inf for summary in summaries.values()):
            yield INFINITE_DISTINGUISHABILITY
        yield from self.paths

    def kept(self) -> str:
        """What there is after an interruption."""
        n_frames = counted(len(next(iter(self.results.values()))), "frame")
        part = f"the {n_frames} processed before the interruption"
        return f"{self.paths[0]} holds {'the whole result' if self.complete else part}"

    def _described(self, label: str, summary: dict[str, Any]) -> dict[str, Any]:
        """A model in the record."""
        result = self.results[label]
        processed = result.record["processed"]
        return {
            "label": label,
            "model": result.record["model"],
            "engine": result.record["engine"],
            **{key: processed[key] for key in ("width", "height", "cells") if key in processed},
            **result.params.to_dict(),
            "summary": summary,
        }


def plot(
    results: Result | Comparison | Mapping[str, Result] | Iterable[Result],
    kind: str = "mp",
    **look: Any,
) -> "Figure":
    """Draw results over time in one figure, as `dlgmd plot` does.

    Parameters
    ----------
    results : Result, Comparison, mapping of str to Result, or iterable of Result
        Without labels, they are called by their titles, such as "group2 · set9".
    kind : {"mp", "attenuation", "spikes", "ttc", "overview"} or str
        The membrane potential above the expansion, the attenuation, the potential above spikes and
        alarms, the expansion and the time to contact, all of these, or the name of a column.
    look
        ``ax``: Axes of an existing figure, into which the highest panel is drawn. ``mark``:
        texts at frames, as ``[(40, "pitching")]``; of one result, as ``[("flight", 40,
        "pitching")]``. ``span``: texts over frames, as ``[(40, 75, "accelerating")]``.
        ``collision_frame``, ``false_positive_frame``: frames. ``collisions``: frames of collisions
        by label. ``emphasise``: the label of the strongest line. ``xlim`` (s), ``ylim`` (potential
        or dB): pairs. ``column``: "mp_abs" or "mp_seq", another potential than the one that the
        spikes follow. ``width``: columns of a paper, "one" or "two". `Result.plot` and
        `Comparison.plot` take them, too.

    Returns
    -------
    matplotlib.figure.Figure
        With ``ax``, the figure of these axes.

    Raises
    ------
    ParameterError
        If an annotation is not valid.
    ValueError
        If there is no result, or an option has another value.

    Examples
    --------
    >>> figure = plot({"a": one, "b": other}, mark=[("a", 64, "x")])  # doctest: +SKIP
    """
    if isinstance(results, Comparison):
        results = results.results
    if isinstance(results, Result):
        results = [results]
    if not isinstance(results, Mapping):
        results = list(results)
        results = dict(zip(numbered([result.title for result in results]), results, strict=True))
    return drawn_by("traces.plot")(kind, results, **look)


def _defined(value: float) -> float | None:
    return None if math.isnan(value) else value
