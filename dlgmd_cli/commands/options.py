"""The options that several commands share, in groups, and the kinds of value that they take."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.names import numbered
from dlgmd_cli.parameters import (
    DEFAULT_MODEL_FPS,
    DEFAULT_WIDTH_PX,
    FORMULATIONS,
    MODELS,
    PRESETS,
    parse_overrides,
)
from dlgmd_cli.video.base import DECODERS, REPEATS, Crop, parse_crop, parse_size

if TYPE_CHECKING:
    from dlgmd_cli.runs.run import Setup

ENGINES = ("opencv", "numba")


class Size(click.ParamType):
    """Width and height in px, as 480x270."""

    name = "WxH"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        """`480x270` -> (480, 270)."""
        try:
            return parse_size(str(value))
        except ParameterError as error:
            self.fail(str(error), param, ctx)


class Rectangle(click.ParamType):
    """A part of a picture in px, as 640x360+0+60."""

    name = "WxH+X+Y"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Crop:
        """`640x360+0+60` -> Crop(640, 360, 0, 60)."""
        try:
            return parse_crop(str(value))
        except ParameterError as error:
            self.fail(str(error), param, ctx)


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


Option = Callable[[Any], Any]


def option_group(argument: str, collect: Callable[..., Any], *options: Option) -> Option:
    """Several options as one decorator, which hands them to the command as one argument.

    Parameters
    ----------
    argument : str
        Name of the command's argument.
    collect : callable
        Makes its value from the options' values, by name.
    options : click.option decorators
        In the order of the help.
    """

    def bare() -> None: ...

    for option in options:
        option(bare)
    parameters: list[click.Parameter] = bare.__click_params__  # type: ignore[attr-defined]
    names = [str(parameter.name) for parameter in parameters]

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def collecting(*arguments: Any, **values: Any) -> Any:
            own = {name: values.pop(name) for name in names}
            values[argument] = collect(**own)
            return command(*arguments, **values)

        for option in reversed(options):
            option(collecting)
        return collecting

    return decorate


# The model and its parameters.

param_option = click.option(
    "--param",
    "pairs",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override one parameter; repeatable.",
)
formulation_option = click.option(
    "--formulation",
    type=click.Choice(FORMULATIONS),
    help="How delays that are not whole frames are rounded. released also divides FFI by 200000 "
    "whatever the frames' size, which leaves little of FFI-GD at 480x270.  [default: default]",
)
engine_option = click.option(
    "--engine",
    type=click.Choice(ENGINES),
    help="What computes the model; numba needs dlgmd[fast].  "
    "[default: numba for large frames if installed, else opencv]",
)
ONE_MODEL = (
    click.option("--set", "set_name", metavar="N", help="The paper's set, 1 to 9."),
    click.option(
        "--config",
        type=click.Path(path_type=Path),
        help="A preset's name, or a YAML file of parameters; a run.yaml repeats its run.  "
        f"[default: {PRESETS[0]}]",
    ),
    param_option,
    click.option(
        "--model",
        type=click.Choice(list(MODELS)),
        help="A model with its published values; dlgmd stands for set 9.",
    ),
    formulation_option,
)


def _setup(
    set_name: str | None,
    config: Path | None,
    pairs: tuple[str, ...],
    model: str | None,
    formulation: str | None,
    engine: str | None = None,
) -> "Setup":
    """The model that the options ask for."""
    from dlgmd_cli.runs.run import choose  # brings in NumPy

    return choose(set_name, config, model, parse_overrides(pairs), formulation, engine)


model_options = option_group("setup", _setup, *ONE_MODEL, engine_option)
parameter_options = option_group("setup", _setup, *ONE_MODEL)


def setup_options(collect: Callable[..., Any], *more: Option, argument: str = "setups") -> Option:
    """Options for several models: --set, --config and --model are repeatable.

    `collect` gets `set_names`, `configs`, `models` and the values of the options `more`.
    """
    return option_group(
        argument,
        collect,
        click.option(
            "--set",
            "set_names",
            multiple=True,
            metavar="N",
            help="One of the paper's sets, 1 to 9; repeatable.",
        ),
        click.option(
            "--config",
            "configs",
            multiple=True,
            type=click.Path(path_type=Path),
            help="A preset's name, or a YAML file of parameters; repeatable.  "
            f"[default: {PRESETS[0]}]",
        ),
        click.option(
            "--model",
            "models",
            multiple=True,
            type=click.Choice(list(MODELS)),
            help="A model with its published values; dlgmd stands for set 9; repeatable.",
        ),
        *more,
    )


def labelled(setups: "list[Setup]") -> "list[Setup]":
    """The setups under labels that differ."""
    labels = numbered([one.label for one in setups])
    return [replace(one, label=label) for one, label in zip(setups, labels, strict=True)]


# What is read of an input.


class RateOrAll(FiniteRange):
    """A frame rate above 0, or all."""

    name = "rate"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """`25` -> 25.0, `all` -> all."""
        return value if value == "all" else super().convert(value, param, ctx)


_RATE = FiniteRange(min=0, min_open=True, max=100_000)
decoder_option = click.option(
    "--decoder",
    type=click.Choice(DECODERS),
    help="What decodes a video; pyav needs dlgmd[fast].  [default: opencv]",
)
input_options = option_group(
    "given",
    dict,
    click.option(
        "--scale",
        type=FiniteRange(min=0, min_open=True, max=1),
        metavar="S",
        help="Linear scale of the processed frame.  [default: fits the width to the preset's, "
        f"{DEFAULT_WIDTH_PX} px for the paper's sets]",
    ),
    click.option("--size", type=Size(), help="An exact processed size instead."),
    click.option(
        "--fps",
        type=RateOrAll(min=0, min_open=True, max=100_000),
        metavar="F|all",
        help="Process at most F frames a second, every k-th; times stay true.  [default: "
        f"{DEFAULT_MODEL_FPS:g}, the preset's, in videos; all of pictures]",
    ),
    click.option(
        "--repeats",
        type=click.Choice(REPEATS),
        help="Frames that merely repeat the one before: skip them, or show them to the model.  "
        "[default: skip in videos, keep in pictures]",
    ),
    click.option(
        "--input-fps",
        type=_RATE,
        metavar="F",
        help="Frame rate of pictures, or of a video that states none.  [default: 30]",
    ),
    decoder_option,
    click.option("--start", type=Time(), help="Seconds or HH:MM:SS.mmm."),
    click.option("--end", type=Time(), help="Seconds or HH:MM:SS.mmm, excluded."),
    click.option(
        "--crop",
        type=Rectangle(),
        help="Look at this part of the picture only; X and Y are its upper left corner, in px.",
    ),
    click.option(
        "--mask",
        type=click.Path(exists=True, dir_okay=False),
        metavar="FILE",
        help="Ignore what is black in this picture, which covers the input, or its --crop.",
    ),
    click.option(
        "--normalise",
        type=click.Choice(["absolute", "sequence"]),
        help="Which normalised MP drives the spikes.  [default: absolute]",
    ),
)

# What is written.


@dataclass(frozen=True)
class Output:
    """Where results go, and the formats and resolution of their plots; none for no plots."""

    out: Path
    formats: tuple[str, ...]
    dpi: int
    overwrite: bool


def _output(
    out: str, formats: tuple[str, ...], dpi: int, no_plots: bool, overwrite: bool
) -> Output:
    """What the options ask for, each format once."""
    if not out.strip():
        raise ParameterError("--out", "it is empty", "Give the name of a folder.")
    return Output(Path(out), () if no_plots else tuple(dict.fromkeys(formats)), dpi, overwrite)


out_option = click.option(
    "--out", default="dlgmd-out", show_default=True, metavar="DIR", help="Where results go."
)
format_option = click.option(
    "--format",
    "formats",
    type=click.Choice(["png", "pdf", "svg"]),
    multiple=True,
    default=["png"],
    show_default=True,
    help="Format of the plots; repeatable.",
)
dpi_option = click.option(
    "--dpi",
    type=click.IntRange(50, 1200),
    default=200,
    show_default=True,
    metavar="N",
    help="Resolution of PNG figures, in dots per inch.",
)
no_plots_option = click.option("--no-plots", is_flag=True, help="Draw no plots.")
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace an earlier result.")
output_options = option_group(
    "output", _output, out_option, format_option, dpi_option, no_plots_option, overwrite_option
)
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print the summary as one JSON object."
)
width_option = click.option(
    "--width",
    type=click.Choice(["one", "two"]),
    default="one",
    show_default=True,
    help="Columns of a paper that a figure is as wide as.",
)
