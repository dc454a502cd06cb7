"""What `synth` can be told of a clip, in sections: of all scenes, of some."""

from collections.abc import Callable
from functools import partial
from typing import Any

import click

from dlgmd_cli.commands._console import Command
from dlgmd_cli.commands._types import OptionGroup, Size

_FLIGHTS, _FLAT = "Of flights only", "Of flat scenes only"


class SectionOption(click.Option):
    """An option that the help shows in a section of its own."""

    def __init__(self, *args: Any, section: str, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.section = section


class SectionedCommand(Command):
    """A command whose help has its options in sections."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The options of no section first."""
        sections: dict[str, list[tuple[str, str]]] = {"Options": []}
        for param in self.get_params(ctx):
            line = param.get_help_record(ctx)
            if line is not None and isinstance(param, click.Option):
                sections.setdefault(getattr(param, "section", "Options"), []).append(line)
        for title, lines in sections.items():
            with formatter.section(title):
                formatter.write_dl(lines)


_flight_option: Callable[..., Callable[[Any], Any]] = partial(
    click.option, cls=SectionOption, section=_FLIGHTS
)
_flat_option: Callable[..., Callable[[Any], Any]] = partial(
    click.option, cls=SectionOption, section=_FLAT
)

clip_options = OptionGroup(
    "given",
    dict,
    click.option(
        "--size", type=Size(), help="Size of the frames.  [default: the scene's own; flat 480x270]"
    ),
    click.option("--fps", type=float, metavar="F", help="Frames per second.  [default: 30]"),
    click.option(
        "--frames",
        type=int,
        metavar="N",
        help="Length of the clip.  [default: the whole flight; flat scenes: all before contact, 75 "
        "where there is none]",
    ),
    click.option(
        "--fov",
        type=float,
        metavar="DEG",
        help="Horizontal field of view of the camera.  [default: flights 80, flat scenes 60]",
    ),
    click.option(
        "--noise",
        type=float,
        metavar="SD",
        help="Standard deviation of the noise that every pixel gets, as a share of white: of "
        "linear light in a flight, of luminance in a flat scene.  [default: 0.002; flat 0]",
    ),
    click.option(
        "--seed",
        type=int,
        metavar="N",
        help="Seed of the noise; of a flight, of all that is random in it.  [default: 0]",
    ),
    _flight_option(
        "--exposure",
        type=float,
        metavar="MS",
        help="How long the shutter is open, which blurs what moves.  [default: 0]",
    ),
    _flight_option(
        "--rolling-shutter",
        type=float,
        metavar="MS",
        help="How much later the last row is taken than the first.  [default: 0]",
    ),
    _flight_option(
        "--vignette",
        type=float,
        metavar="V",
        help="Share of the light that the corners lose, 0 to 1.  [default: 0.3]",
    ),
    _flight_option(
        "--shot-noise",
        type=float,
        metavar="SD",
        help="Standard deviation of the noise that comes with light, where it is full; the "
        "variance is proportional to the light.  [default: 0.01]",
    ),
    _flight_option(
        "--gamma",
        type=float,
        metavar="G",
        help="Grey levels are light to the power of 1/G.  [default: 2.2]",
    ),
    _flat_option(
        "--object-size",
        type=float,
        metavar="S",
        help="Side or diameter: m, or px for translating-cubes.  "
        "[default: 0.5 m; a ninth of the height]",
    ),
    _flat_option(
        "--speed",
        type=float,
        multiple=True,
        metavar="V",
        help="Speed in m/s; for translating-cubes in px/frame, negative to the left, and "
        "repeatable for more cubes.  [default: 3 m/s; 1, 2, 3 and 4 px/frame]",
    ),
    _flat_option(
        "--distance",
        type=float,
        metavar="D",
        help="Distance in m at the first frame.  [default: 7.5; 0.1 for receding-cube]",
    ),
    _flat_option(
        "--contrast",
        type=float,
        metavar="C",
        help="Weber contrast: the object is 1 + C times as bright as the background.  "
        "[default: -0.75]",
    ),
    _flat_option(
        "--background",
        type=float,
        metavar="L",
        help="Luminance of the background, 0 to 1.  [default: 0.8]",
    ),
)

count_option = _flight_option(
    "--count",
    type=click.IntRange(1, 1_000_000),
    metavar="N",
    help="Render N flights, each with the next seed, and DIR/labels.csv.",
)
jobs_option = _flight_option(
    "--jobs",
    type=click.IntRange(1, 512),
    metavar="N",
    help="Processes that share the flights of --count.  [default: all processors]",
)


def by_flag(given: dict[str, Any]) -> dict[str, Any]:
    """What the user has set, by flag, as scenes take it."""
    values = {
        f"--{name.replace('_', '-')}": value
        for name, value in given.items()
        if value not in (None, ())
    }
    if "--size" in values:
        width, height = values["--size"]
        values["--size"] = (height, width)
    return values
