"""Kinds of value that options take, and options in groups."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

CommandT = TypeVar("CommandT", bound=Callable[..., Any])


class Size(click.ParamType):
    """Width and height in px, as 480x270."""

    name = "WxH"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        """`480x270` -> (480, 270)."""
        match = re.fullmatch(r"(\d{1,6})[x×X](\d{1,6})", str(value).strip(), re.ASCII)
        if match is None:
            self.fail(f"{value!r} is not WIDTHxHEIGHT. Write 480x270.", param, ctx)
        return int(match[1]), int(match[2])


class Time(click.ParamType):
    """Seconds, or HH:MM:SS.mmm."""

    name = "TIME"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """`00:01:30.250` -> 90.25."""
        match = re.fullmatch(
            r"(?:(?:(\d+):)?([0-5]?\d):)?(\d+(?:\.\d*)?|\.\d+)", str(value).strip(), re.ASCII
        )
        if match is None or (match[2] and float(match[3]) >= 60.0):
            self.fail(f"{value!r} is not a time. Write 12.5 or 00:01:30.250.", param, ctx)
        hours, minutes, seconds = (float(part or 0) for part in match.groups())
        return hours * 3600 + minutes * 60 + seconds


class FiniteRange(click.FloatRange):
    """A range of numbers that leaves out NaN and infinity."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """A finite float within the range."""
        number: float = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


class OptionGroup:
    """Several options as one decorator."""

    def __init__(self, *options: Callable[[Any], Any]) -> None:
        self._options = options

    def __call__(self, command: CommandT) -> CommandT:
        """Add the options to `command`, in the order given."""
        for option in reversed(self._options):
            command = option(command)
        return command


output_options = OptionGroup(
    click.option(
        "--out",
        type=click.Path(path_type=Path),
        default=Path("dlgmd-out"),
        show_default=True,
        help="Where results go.",
    ),
    click.option(
        "--format",
        "formats",
        type=click.Choice(["png", "pdf", "svg"]),
        multiple=True,
        default=["png"],
        show_default=True,
        help="Format of the plots; repeatable.",
    ),
    click.option("--no-plots", is_flag=True, help="Draw no plots."),
    click.option("--overwrite", is_flag=True, help="Replace an earlier result."),
)
