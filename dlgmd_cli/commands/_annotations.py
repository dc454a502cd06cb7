"""The options that mark frames on a figure, shared by every command that draws results."""

import re
from typing import Any

import click

from dlgmd_cli.commands._types import OptionGroup
from dlgmd_cli.errors import printable
from dlgmd_cli.results.annotations import Annotations

# A figure has room for about as much.
_MAX_TEXT, _MAX_COUNT = 60, 40


class _Annotation(click.ParamType):
    """Frames and a text, with a colon between them."""

    pattern: str
    example: str

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """What stands before the colon as numbers, then the text."""
        given = printable(str(value))
        match = re.fullmatch(f"{self.pattern}:(.*)", given.strip(), re.ASCII | re.DOTALL)
        text = match[match.lastindex or 0].strip() if match else ""
        if match is None or not text:
            shown = given if len(given) <= _MAX_TEXT else f"{given[:_MAX_TEXT]}…"
            self.fail(f"{shown!r} is not {self.name}. Write {self.example}.", param, ctx)
        if len(text) > _MAX_TEXT:
            self.fail(f"a text may have {_MAX_TEXT} characters, not {len(text)}.", param, ctx)
        frames = [int(number) for number in match.groups()[:-1]]
        if frames != sorted(frames):
            self.fail(f"{given!r} ends before it starts. Write {self.example}.", param, ctx)
        return (*frames, text)


class Mark(_Annotation):
    """A frame and its text: `40:pitching` -> (40, "pitching")."""

    name, example = "FRAME:TEXT", "40:pitching"
    pattern = r"(\d{1,9})"


class Span(_Annotation):
    """Two frames and a text: `40-75:accelerating` -> (40, 75, "accelerating")."""

    name, example = "FRAME-FRAME:TEXT", "40-75:accelerating"
    pattern = r"(\d{1,9})-(\d{1,9})"


def _collect(
    marks: tuple[tuple[int, str], ...],
    spans: tuple[tuple[int, int, str], ...],
    collision_frame: int | None,
    false_positive_frame: int | None,
) -> Annotations:
    """What the options ask for."""
    if len(marks) + len(spans) > _MAX_COUNT:
        raise click.UsageError(
            f"a figure has room for {_MAX_COUNT} times --mark and --span, "
            f"not {len(marks) + len(spans)}."
        )
    return Annotations(marks, spans, collision_frame, false_positive_frame)


_frame = click.IntRange(0, 999_999_999)

annotation_options = OptionGroup(
    "annotations",
    _collect,
    click.option(
        "--mark",
        "marks",
        type=Mark(),
        multiple=True,
        help="A line at a frame, with a text: 40:pitching; repeatable.",
    ),
    click.option(
        "--span",
        "spans",
        type=Span(),
        multiple=True,
        help="A band from one frame to another: 40-75:accelerating; repeatable.",
    ),
    click.option(
        "--collision-frame", type=_frame, metavar="N", help="Where the camera truly collides."
    ),
    click.option(
        "--false-positive-frame", type=_frame, metavar="N", help="Where an alarm is a false one."
    ),
)
