"""Kinds of value that options take, and options in groups."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any

import click


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
        time_s = hours * 3600 + minutes * 60 + seconds
        if not math.isfinite(time_s):
            self.fail("no video is as long as that.", param, ctx)
        return time_s


class FrameNumbers(click.ParamType):
    """Numbers of frames, as 1,50,65: each once, in order."""

    name = "N,N,…"

    def __init__(self, n_max: int) -> None:
        self._n_max = n_max

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, ...]:
        """`65, 1,50` -> (1, 50, 65)."""
        if isinstance(value, tuple):
            return value
        parts = [part.strip() for part in str(value).split(",")]
        for part in parts:
            if re.fullmatch(r"\d{1,9}", part, re.ASCII) is None:
                self.fail(f"{part[:40]!r} is no number of a frame. Write 1,50,65.", param, ctx)
        frames = tuple(sorted({int(part) for part in parts}))
        if len(frames) > self._n_max:
            self.fail(
                f"{len(frames)} frames are too many for one sheet. Choose up to {self._n_max}.",
                param,
                ctx,
            )
        return frames


class VideoFile(click.ParamType):
    """Where a video is to be written."""

    name = "FILE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """A path that ends in .mp4."""
        path = Path(value)
        if path.suffix.lower() != ".mp4":
            self.fail(f"{str(value)[:80]!r} does not end in .mp4. Write film.mp4.", param, ctx)
        return path


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
    """Several options as one decorator, which hands their values to the command as one argument.

    Parameters
    ----------
    argument : str
        Name of the command's argument.
    collect : callable
        Makes its value from the options' values, by name.
    options : click.option decorators
        In the order of the help.
    """

    def __init__(
        self,
        argument: str,
        collect: Callable[..., Any],
        *options: Callable[[Any], Any],
    ) -> None:
        self._argument, self._collect, self._options = argument, collect, options

    def __call__(self, command: Callable[..., Any]) -> Callable[..., Any]:
        """Add the options to `command`."""
        names = [parameter.name for parameter in self._parameters()]

        @wraps(command)
        def collecting(*arguments: Any, **values: Any) -> Any:
            own = {name: values.pop(name) for name in names}
            values[self._argument] = self._collect(**own)
            return command(*arguments, **values)

        for option in reversed(self._options):
            option(collecting)
        return collecting

    def _parameters(self) -> list[click.Parameter]:
        """The options as click has them."""

        def bare() -> None: ...

        for option in self._options:
            option(bare)
        parameters: list[click.Parameter] = bare.__click_params__  # type: ignore[attr-defined]
        return parameters


@dataclass(frozen=True)
class Output:
    """Where results go, and the formats of their plots; none for no plots."""

    out: Path
    formats: tuple[str, ...]
    overwrite: bool

    @classmethod
    def from_options(
        cls, out: Path, formats: tuple[str, ...], no_plots: bool, overwrite: bool
    ) -> "Output":
        """What the options ask for, each format once."""
        return cls(out, () if no_plots else tuple(dict.fromkeys(formats)), overwrite)


format_option = click.option(
    "--format",
    "formats",
    type=click.Choice(["png", "pdf", "svg"]),
    multiple=True,
    default=["png"],
    show_default=True,
    help="Format of the plots; repeatable.",
)
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace an earlier result.")

output_options = OptionGroup(
    "output",
    Output.from_options,
    click.option(
        "--out",
        type=click.Path(path_type=Path),
        default=Path("dlgmd-out"),
        show_default=True,
        help="Where results go.",
    ),
    format_option,
    click.option("--no-plots", is_flag=True, help="Draw no plots."),
    overwrite_option,
)

width_option = click.option(
    "--width",
    type=click.Choice(["one", "two"]),
    default="one",
    show_default=True,
    help="Columns of a paper that a figure is as wide as.",
)
