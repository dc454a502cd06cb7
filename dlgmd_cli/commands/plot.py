"""`dlgmd plot`: draw stored results."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, show
from dlgmd_cli.errors import ParameterError, printable
from dlgmd_cli.results.annotations import KINDS, Annotations
from dlgmd_cli.results.files import FIGURE_FORMATS

# Greatest number of characters of a wrong value that an error quotes.
_MAX_SHOWN = 60


def _remark(name: str, pattern: str, example: str) -> Callable[[str], tuple[Any, ...]]:
    """A parser of frames and text: `40:pitching` -> (40, "pitching"); a label may come first."""

    def convert(value: str) -> tuple[Any, ...]:
        given = printable(value)
        match = re.fullmatch(
            rf"{pattern}:\s*(?P<text>.*\S)\s*", given.strip(), re.ASCII | re.DOTALL
        )
        if match is None:
            shown = given if len(given) <= _MAX_SHOWN else f"{given[:_MAX_SHOWN]}…"
            raise click.BadParameter(f"{shown!r} is not {name}. Write {example}.")
        facts = match.groupdict()
        label, text = facts.get("label"), facts["text"]
        frames = [int(facts[key]) for key in ("first", "last") if key in facts]
        if frames != sorted(frames):
            raise click.BadParameter(f"{given!r} ends before it starts. Write {example}.")
        return (*([label] if label else []), *frames, text)

    return convert


def _limits(text: str) -> tuple[float, float]:
    """`-40:5` -> (-40.0, 5.0)."""
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low = high = math.nan
    if not (low < high and math.isfinite(high - low)):
        raise ParameterError("", f"{text[:_MAX_SHOWN]!r} is not FROM:TO", "Write 1.5:2.5.")
    return low, high


LIMITS = options.Parsed("FROM:TO", _limits)


def _kind(text: str) -> str:
    """KIND, which is often forgotten."""
    if text not in KINDS and Path(text).exists():
        raise ParameterError("", f"{text!r} is no kind", f"Write 'dlgmd plot mp {text}'.")
    return text


def _place(value: str) -> Path:
    """A folder, or a file with the suffix of a figure."""
    out = Path(value)
    suffix = out.suffix.lower().removeprefix(".")
    if options.is_file_name(out) and suffix not in FIGURE_FORMATS:
        raise click.BadParameter(
            f"figures are written as {', '.join(FIGURE_FORMATS)}, not as {suffix}. "
            f"Give {printable(out.with_suffix('.png').name)}, or the name of a folder."
        )
    return out


annotation_options = options.option_group(
    "annotations",
    Annotations,
    click.option(
        "--mark",
        "marks",
        type=_remark("FRAME:TEXT", r"(?:(?P<label>.*?\D.*?):)??(?P<first>\d{1,9})", "40:pitching"),
        metavar="[LABEL:]FRAME:TEXT",
        multiple=True,
        help="Label a frame, such as 40:pitching; a:40:pitching labels the frame of result a "
        "alone. Repeatable.",
    ),
    click.option(
        "--span",
        "spans",
        type=_remark(
            "FRAME-FRAME:TEXT", r"(?P<first>\d{1,9})-(?P<last>\d{1,9})", "40-75:accelerating"
        ),
        metavar="FRAME-FRAME:TEXT",
        multiple=True,
        help="Shade a range of frames, such as 40-75:accelerating; repeatable.",
    ),
    click.option("--collision-frame", type=options.FRAME, help="Frame of the true collision."),
)
# The frames by which sharpness and distinguishability are measured.
frame_options = options.option_group(
    "",
    dict,
    click.option("--collision-frame", type=options.FRAME, help="Frame of the true collision."),
    click.option(
        "--false-positive-frame",
        type=options.FRAME,
        help="Frame of a false alarm, to measure distinguishability.",
    ),
)
one_panel_option = click.option(
    "--one-panel",
    is_flag=True,
    help="Draw the top panel alone, without the panels of expansion, spikes and alarms. It shows "
    "up to eight results.",
)


@click.command(cls=Command, short_help="Draw stored results.")
@click.argument("kind", metavar="KIND", type=options.Parsed("kind", _kind, lambda: KINDS))
@options.results_argument
@annotation_options
@click.option(
    "--label",
    "labels",
    multiple=True,
    metavar="TEXT",
    callback=options.distinct,
    help="Name of a result in the legend; give one per result.  [default: the folders' names]",
)
@click.option(
    "--emphasise",
    metavar="LABEL",
    help="Draw this result as the strongest line: blue, thick, with dots.",
)
@options.collisions_option
@click.option(
    "--align",
    type=click.Choice(["collision"]),
    help="Count the time from each result's first collision, see --collisions.",
)
@click.option(
    "--mean", is_flag=True, help="With --align: the mean ± SEM over the results of each model."
)
@click.option(
    "--until",
    type=click.Choice(["collision"]),
    help="Show only the time up to the collision.",
)
@one_panel_option
@click.option(
    "--xlim",
    type=LIMITS,
    metavar="FROM:TO",
    help="Show this time only, in s. With --align, the time to the collision: -0.5:2 shows from "
    "2 s before it to 0.5 s after it.",
)
@click.option(
    "--ylim", type=LIMITS, metavar="FROM:TO", help="Limits of the MP or of the dB, such as -40:5."
)
@options.input_option(
    "normalise",
    "Normalised membrane potential (MP) to draw.  [default: the one that the spikes follow]",
)
@options.width_option
@options.with_default(
    "-o",
    "--out",
    type=_place,
    default="dlgmd-out",
    metavar="PATH",
    help="Folder for the figure, or a file ending in .png, .pdf or .svg.",
)
@options.overwrite_option
def plot(
    kind: str,
    paths: tuple[Path, ...],
    annotations: Annotations,
    collisions: Path | None,
    **look: Any,
) -> None:
    """Draw stored results: membrane potential, expansion and time to contact, attenuation, spikes.

    \b
    Examples:
      dlgmd plot mp dlgmd-out/flight                     # the membrane potential
      dlgmd plot mp out/set3/flight out/set9/flight      # two results, one figure
      dlgmd plot mp dlgmd-out --align collision --mean --collisions labels.csv

    KIND is mp, attenuation, spikes, ttc (expansion and time to contact), overview (all of them), or
    a column of a custom model. RESULT is a folder that 'dlgmd run', 'dlgmd compare' or 'dlgmd
    batch' wrote, or a compare.csv.

    Writes OUT/KIND-NAME.png, or the file that --out names: .png, .pdf or .svg. With --mean,
    aligned.csv beside it has the curves, mean, SEM and number at each time.
    """
    if look["normalise"] and kind not in ("mp", "overview"):
        raise click.UsageError(f"--normalise is for mp and overview, not for {kind}.")
    if look["ylim"] and kind == "overview":
        raise click.UsageError("--ylim is for one scale, and an overview has several.")
    if collisions and annotations.collision_frame is not None:
        raise click.UsageError("Give --collisions or --collision-frame, not both.")
    from dlgmd_cli.tasks import plot as task

    show(task.plot_files(kind, paths, annotations=annotations, collisions=collisions, **look))
