"""Data for figures over time: the kinds of figures, and annotations of frames."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Any, Literal

from dlgmd_cli.errors import ParameterError, argument, printable

# (frame, text) for all results, or (label, frame, text) for the result with this label.
Mark = tuple[int, str] | tuple[str, int, str]


# Name -> type of the options of a figure over time, as arguments of a function.
PLOT_ARGUMENTS: dict[str, Any] = {
    "ax": "Axes | None",
    "mark": Iterable[Mark],
    "span": Iterable[tuple[int, int, str]],
    **dict.fromkeys(("collision_frame", "false_positive_frame"), int | None),
    "collisions": Mapping[str, Sequence[int]] | None,
    "emphasise": str | None,
    "until": Literal["collision"] | None,
    "one_panel": bool,
    **dict.fromkeys(("xlim", "ylim"), tuple[float, float] | None),
    "column": Literal["mp_abs", "mp_seq"] | None,
    "width": Literal["one", "two"],
}


# The types in a mark, with and without a label; the types in a span.
_MARKS, _SPANS = ((Integral, str), (str, Integral, str)), ((Integral, Integral, str),)


@dataclass(frozen=True)
class Annotations:
    """Annotated frames and ranges of frames; frame numbers are those of the input, from 0.

    Attributes
    ----------
    marks : tuple of (int, str) or (str, int, str)
        Frame and text for all results; with a label first, only for the result with this label.
    spans : tuple of (int, int, str)
        First frame, last frame, text.
    collision_frame : int or None
        Frame of the true collision.
    false_positive_frame : int or None
        Frame of a false alarm.
    """

    marks: tuple[Mark, ...] = ()
    spans: tuple[tuple[int, int, str], ...] = ()
    collision_frame: int | None = None
    false_positive_frame: int | None = None

    def plus(
        self,
        mark: Iterable[Mark],
        span: Iterable[tuple[int, int, str]],
        collision_frame: int | None,
        false_positive_frame: int | None,
    ) -> "Annotations":
        """These and further annotations; raises ParameterError for an invalid mark or span."""
        mark, span = tuple(mark), tuple(span)
        for name, given, forms, example in (
            ("mark", mark, _MARKS, "(40, 'pitching') or ('flight', 40, 'pitching')"),
            ("span", span, _SPANS, "(40, 75, 'accelerating')"),
        ):
            for item in given:
                parts = item if isinstance(item, tuple | list) else ()
                if not any(len(parts) == len(f) and all(map(isinstance, parts, f)) for f in forms):
                    raise ParameterError("", f"{item!r} is no {name}", f"Give a list of {example}.")
        contact = self.collision_frame if collision_frame is None else collision_frame
        false = self.false_positive_frame if false_positive_frame is None else false_positive_frame
        return Annotations((*self.marks, *mark), (*self.spans, *span), contact, false)

    def of_result(self, label: str) -> list[tuple[int, str]]:
        """Frame and text of the marks for only the result `label`."""
        return [(mark[1], mark[2]) for mark in self.marks if len(mark) > 2 and mark[0] == label]

    def renamed(self, titles: Mapping[str, str]) -> "Annotations":
        """The same annotations with new labels, by `titles`: old label -> new label."""
        marks = ((titles[mark[0]], *mark[1:]) if len(mark) > 2 else mark for mark in self.marks)
        return replace(self, marks=tuple(marks))

    def require(self, labels: Collection[str]) -> None:
        """Raise ParameterError if the label of a mark is not one of these `labels`."""
        for mark in self.marks:
            if len(mark) > 2 and mark[0] not in labels:
                why = f"no result is called {printable(mark[0])}"
                known = ", ".join(map(printable, labels))
                raise ParameterError(argument("mark"), why, f"Choose from {known}.")

    def remarks(self) -> list[tuple[int, int, str, str]]:
        """First frame, last frame, text, and `mark`, `collision`, `false positive` or `span`.

        Only annotations for all results; marks for a single result are left out.
        """
        named = {"collision": self.collision_frame, "false positive": self.false_positive_frame}
        return [
            *((mark[0], mark[0], mark[1], "mark") for mark in self.marks if len(mark) == 2),
            *((frame, frame, name, name) for name, frame in named.items() if frame is not None),
            *((start, end, text, "span") for start, end, text in self.spans),
        ]

    def outside(self, first_frame: int, last_frame: int) -> list[str]:
        """A line for each annotation that a figure of these frames cannot show in full."""
        frames = f"frames {first_frame} to {last_frame}"
        lines = []
        for start, end, text, kind in self.remarks():
            where = f"frames {start} to {end}" if kind == "span" else f"frame {start}"
            if end < first_frame or start > last_frame:
                lines.append(f"{text!r} at {where} is outside {frames} and is left out")
            elif start < first_frame or end > last_frame:
                lines.append(f"{text!r} at {where} is cut off at {frames}")
        return lines


NONE = Annotations()


# Kind of figure over time -> panels from the top down. Each column of a result is another kind of
# figure, see `panels_of`.
KINDS = {
    "mp": ("level", "signal", "expansion", "ttc"),
    "attenuation": ("attenuation",),
    "spikes": ("level", "raster"),
    "ttc": ("expansion", "ttc"),
    "overview": ("level", "signal", "expansion", "ttc", "attenuation", "raster"),
}
