"""`dlgmd plot`: draw stored results."""

import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands.console import Command, note, print_path, warn, warn_outside
from dlgmd_cli.commands.defaults import OwnDefault
from dlgmd_cli.commands.options import (
    FORMATS,
    FRAME,
    Parsed,
    collisions_option,
    distinct,
    dpi_option,
    format_option,
    is_file_name,
    option_group,
    overwrite_option,
    require_one_each,
    width_option,
)
from dlgmd_cli.errors import ParameterError, ResultError, printable
from dlgmd_cli.plots.kinds import KINDS
from dlgmd_cli.results.annotations import Annotations
from dlgmd_cli.results.names import distinct_names, numbered

if TYPE_CHECKING:
    from dlgmd_cli.results.result import Result

_COLUMNS = {"absolute": "mp_abs", "sequence": "mp_seq"}
# Greatest number of characters of a figure's name, and of a wrong value that an error quotes.
_MAX_NAME, _MAX_SHOWN = 100, 60


def _remark(name: str, pattern: str, example: str) -> Callable[[str], tuple[Any, ...]]:
    """A parser of frames and text: `40:pitching` -> (40, "pitching")."""

    def convert(value: str) -> tuple[Any, ...]:
        given = printable(value)
        match = re.fullmatch(rf"{pattern}:\s*(.*\S)\s*", given.strip(), re.ASCII | re.DOTALL)
        if match is None:
            shown = given if len(given) <= _MAX_SHOWN else f"{given[:_MAX_SHOWN]}…"
            raise click.BadParameter(f"{shown!r} is not {name}. Write {example}.")
        *numbers, text = match.groups()
        frames = [int(number) for number in numbers]
        if frames != sorted(frames):
            raise click.BadParameter(f"{given!r} ends before it starts. Write {example}.")
        return (*frames, text)

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


LIMITS = Parsed("FROM:TO", _limits)

annotation_options = option_group(
    "annotations",
    Annotations,
    click.option(
        "--mark",
        "marks",
        type=_remark("FRAME:TEXT", r"(\d{1,9})", "40:pitching"),
        metavar="FRAME:TEXT",
        multiple=True,
        help="Label a frame, such as 40:pitching; repeatable.",
    ),
    click.option(
        "--span",
        "spans",
        type=_remark("FRAME-FRAME:TEXT", r"(\d{1,9})-(\d{1,9})", "40-75:accelerating"),
        metavar="FRAME-FRAME:TEXT",
        multiple=True,
        help="Shade a range of frames, such as 40-75:accelerating; repeatable.",
    ),
    click.option("--collision-frame", type=FRAME, metavar="N", help="Frame of the true collision."),
    click.option("--false-positive-frame", type=FRAME, metavar="N", help="Frame of a false alarm."),
)


@click.command(
    cls=Command,
    short_help="Draw stored results.",
    epilog="Example: dlgmd plot attenuation dlgmd-out/flight --mark 40:pitching --format pdf",
)
@click.argument("kind", metavar="KIND", type=click.Choice(KINDS))
@click.argument(
    "paths", metavar="RESULT...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@annotation_options
@click.option(
    "--label",
    "labels",
    multiple=True,
    metavar="TEXT",
    callback=distinct,
    help="Name of a result in the legend; give one per result.  [default: the folders' names]",
)
@click.option(
    "--emphasise",
    metavar="LABEL",
    help="Draw this result as the strongest line: blue, thick, with dots.",
)
@collisions_option
@click.option("--xlim", type=LIMITS, metavar="FROM:TO", help="Show this time only, in s.")
@click.option(
    "--ylim", type=LIMITS, metavar="FROM:TO", help="Limits of the MP or of the dB, such as -40:5."
)
@click.option(
    "--normalise",
    type=click.Choice(list(_COLUMNS)),
    help="Which normalised membrane potential (MP) to draw.  [default: the one that the spikes "
    "follow]",
)
@width_option
@click.option(
    "-o",
    "--out",
    cls=OwnDefault,
    type=click.Path(path_type=Path),
    default=Path("dlgmd-out"),
    show_default=True,
    metavar="PATH",
    help="Folder for the figure, or a file ending in .png, .pdf or .svg.",
)
@format_option
@dpi_option
@overwrite_option
def plot(
    kind: str,
    paths: tuple[Path, ...],
    annotations: Annotations,
    labels: tuple[str, ...],
    emphasise: str | None,
    labels_path: Path | None,
    xlim: tuple[float, float] | None,
    ylim: tuple[float, float] | None,
    normalise: str | None,
    width: Any,
    out: Path,
    formats: tuple[str, ...],
    dpi: int,
    overwrite: bool,
) -> None:
    """Draw stored results: membrane potential, attenuation, spikes, or all of them.

    KIND is mp, attenuation, spikes or overview. RESULT is a folder that 'dlgmd run', 'dlgmd
    compare' or 'dlgmd batch' wrote, or the compare.csv in it.

    Writes OUT/KIND-NAME.png, or the file or formats that --out and --format name.
    """
    if normalise and kind not in ("mp", "overview"):
        raise click.UsageError(f"--normalise is for mp and overview, not for {kind}.")
    if ylim and kind == "overview":
        raise click.UsageError("--ylim is for one scale, and an overview has two.")
    if labels_path and annotations.collision_frame is not None:
        raise click.UsageError("Give --collisions or --collision-frame, not both.")
    from dlgmd_cli.results.store import SUMMARY, claimed, fitting, with_results

    given = [
        path.absolute().parent if path.name in ("compare.csv", SUMMARY) else path for path in paths
    ]
    paths = tuple(with_results(paths))
    folders = [path.absolute().parent if path.name == "compare.csv" else path for path in paths]
    # The names of all that was given, cut off if they get too long for a file name.
    names = "-".join(Path(os.path.abspath(folder)).name or "root" for folder in given)
    targets = _targets(out, f"{kind}-{fitting(names[:_MAX_NAME])}", formats)
    found = _read(paths, folders)
    require_one_each(labels, len(found), "result")
    shown = labels or numbered([name for name, _ in found])
    results = {label: result for label, (_, result) in zip(shown, found, strict=True)}
    if emphasise and emphasise not in results:
        raise click.UsageError(
            f"--emphasise: no result is called {printable(emphasise)}. Choose from "
            f"{', '.join(printable(label) for label in results)}."
        )
    collisions = _collisions(labels_path, results) if labels_path else {}
    results = {
        label: result.until(max(collisions.get(label, ()), default=annotations.collision_frame))
        for label, result in results.items()
    }
    column = _column(kind, normalise, results)
    from dlgmd_cli.plots.style import save_figure
    from dlgmd_cli.plots.timeline import Timeline
    from dlgmd_cli.plots.traces import plot as draw

    timeline = replace(Timeline.of(results.values()), limits=xlim)
    if xlim and not (xlim[0] < timeline.end_s and timeline.start_s < xlim[1]):
        times = f"{timeline.start_s:.6g} to {timeline.end_s:.6g} s"
        raise click.UsageError(f"--xlim shows no frame: the results are from {times}.")
    for line in annotations.outside(*timeline.frames):
        warn(line)
    look: Any = {"column": column, "width": width, "emphasise": emphasise}
    look |= {"collisions": collisions, "xlim": xlim, "ylim": ylim}
    figure = draw(kind, results, annotations, **look)
    files = dict.fromkeys((path.name for path in targets), partial(save_figure, figure, dpi=dpi))
    place = targets[0].parent
    with claimed(place, names=files, overwrite=overwrite, locks=False) as claim:
        claim.write(files)
    for target in targets:
        print_path(target)


def _targets(out: Path, stem: str, formats: tuple[str, ...]) -> list[Path]:
    """The files to write: `out` itself if its suffix is that of a figure, otherwise files in it."""
    suffix = out.suffix.lower().removeprefix(".")
    if is_file_name(out) and suffix not in FORMATS:
        raise click.UsageError(
            f"--out: figures are written as {', '.join(FORMATS)}, not as {suffix}. "
            f"Give {printable(out.with_suffix('.png').name)}, or the name of a folder."
        )
    if suffix not in FORMATS:
        return [out / f"{stem}.{form}" for form in dict.fromkeys(formats)]
    source = click.get_current_context().get_parameter_source("formats")
    if source is click.core.ParameterSource.COMMANDLINE and set(formats) != {suffix}:
        raise click.UsageError(
            f"--out ends in {out.suffix}, and --format says otherwise. Give one of them."
        )
    return [out]


def _read(paths: Sequence[Path], folders: Sequence[Path]) -> list[tuple[str, "Result"]]:
    """Every result with its name.

    With several comparisons, each name begins with that of its comparison.
    """
    from dlgmd_cli.results import store
    from dlgmd_cli.results.reading import read_comparison, read_result

    are_compared = []
    for path, folder in zip(paths, folders, strict=True):
        if path.suffix.lower() == ".csv" and path.name != "compare.csv":
            why = "is one file of a result"
            raise ResultError(str(path), why, "Give the folder that holds it.")
        has_run, has_comparison = (
            (folder / record).exists() for record in (store.RUN, store.COMPARISON)
        )
        are_compared.append(folder is not path or (has_comparison and not has_run))
        if has_run and has_comparison and folder is path:
            note(f"{path} holds a run and a comparison; for that, give {path / 'compare.csv'}")
    results = []
    for folder, name, is_compared in zip(
        folders, distinct_names(folders), are_compared, strict=True
    ):
        if is_compared:
            prefix = f"{name}: " if sum(are_compared) > 1 else ""
            compared = read_comparison(folder).items()
            results += [(f"{prefix}{label}", result) for label, result in compared]
        else:
            results.append((name, read_result(folder)))
    return results


def _collisions(path: Path, results: dict[str, "Result"]) -> dict[str, list[int]]:
    """The labelled collision frames of each result; warns of those that cannot be shown."""
    from dlgmd_cli.results.labels import collision_frames, labels_of, read_by_video

    known, found = read_by_video(path), {}
    for label, result in results.items():
        listed = labels_of(known, str(result.record["input"].get("path")))
        if listed is None:
            warn(f"{path} does not list the video of {label}")
            continue
        found[label] = collision_frames(listed)
        warn_outside(label, result, found[label])
    return found


def _column(kind: str, normalise: str | None, results: dict[str, "Result"]) -> str:
    """The column of the potential to draw; warns if the results were normalised differently."""
    if normalise:
        return _COLUMNS[normalise]
    if kind != "attenuation" and len({result.by_sequence for result in results.values()}) > 1:
        warn(
            "the results were normalised in different ways before the threshold was applied; "
            "--normalise draws them alike"
        )
    return "level"
