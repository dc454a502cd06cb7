"""`dlgmd plot`: figures from stored results, without decoding."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dlgmd_cli.commands._annotations import annotation_options
from dlgmd_cli.commands._console import Command, print_path, say, warn
from dlgmd_cli.commands._figures import letters_checked
from dlgmd_cli.commands._labels import numbered, told_apart
from dlgmd_cli.commands._types import format_option, overwrite_option, width_option
from dlgmd_cli.errors import ResultError
from dlgmd_cli.results.annotations import Annotations

if TYPE_CHECKING:
    from dlgmd_cli.plots.style import Width
    from dlgmd_cli.results.tables import Result

KINDS = ("mp", "attenuation", "spikes", "overview")
_FORMATS = ("png", "pdf", "svg")
_COLUMNS = {None: "level", "absolute": "mp_abs", "sequence": "mp_seq"}
_MAX_NAME = 100


@click.command(
    cls=Command,
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
    help="Name of a result in the legend; as often as there are results.  "
    "[default: names of the folders]",
)
@click.option(
    "--normalise",
    type=click.Choice(["absolute", "sequence"]),
    help="Which MP is drawn.  [default: the one that drove the spikes; of comparisons alone, "
    "sequence]",
)
@width_option
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("dlgmd-out"),
    show_default=True,
    help="Folder for the figure, or a file ending in .png, .pdf or .svg.",
)
@format_option
@overwrite_option
def plot(
    kind: str,
    paths: tuple[Path, ...],
    annotations: Annotations,
    labels: tuple[str, ...],
    normalise: str | None,
    width: "Width",
    out: Path,
    formats: tuple[str, ...],
    overwrite: bool,
) -> None:
    """Draw stored results: membrane potential, attenuation, spikes, or all of them.

    KIND is mp, attenuation, spikes or overview. RESULT is a folder that 'dlgmd run' or 'dlgmd
    compare' wrote, or a compare.csv; several are drawn on the same axes.

    Writes OUT/KIND-NAME.png, or what --out and --format say.
    """
    if normalise and kind not in ("mp", "overview"):
        raise click.UsageError(f"--normalise is for mp and overview, not for {kind}.")
    _check_labels(labels)
    targets = _targets(out, f"{kind}-{_file_name(paths)}", formats)
    from dlgmd_cli.results.files import appearing, refuse_existing

    for target in targets:
        refuse_existing(target, overwrite=overwrite)
    results = _named(_read(paths), labels)
    column = _COLUMNS[normalise]
    if column == "level" and not any(result.has_spikes for result in results.values()):
        column = "mp_seq"  # as in the figure that 'dlgmd compare' draws
    _look_for_spikes(kind, paths, results)
    if column == "level" and kind != "attenuation":
        _look_for_normalisations(results)
    _warn_of_annotations(annotations, results)
    with letters_checked(), appearing(*targets) as files:
        _write(files, kind, results, annotations, column, width)
    for target in targets:
        print_path(target)


def _check_labels(labels: tuple[str, ...]) -> None:
    """Refuse labels that name nothing, or two things."""
    if not all(label.strip() for label in labels):
        raise click.UsageError("--label: a label may not be empty.")
    if len(set(labels)) < len(labels):
        raise click.UsageError("--label: two results may not have the same label.")


def _targets(out: Path, stem: str, formats: tuple[str, ...]) -> list[Path]:
    """The files to write: `out` itself if it ends like a figure, otherwise some within it."""
    suffix = out.suffix.lower().removeprefix(".")
    if suffix not in _FORMATS:
        return [out / f"{stem}.{form}" for form in dict.fromkeys(formats)]
    source = click.get_current_context().get_parameter_source("formats")
    if source is click.core.ParameterSource.COMMANDLINE and set(formats) != {suffix}:
        raise click.UsageError(
            f"--out ends in {out.suffix}, and --format says otherwise. Give one of them."
        )
    return [out]


def _home(path: Path) -> Path:
    """What a result is named after: its folder, or the file if that has a name of its own."""
    if path.suffix.lower() != ".csv":
        return path
    return path.absolute().parent if path.stem == "compare" else path.with_suffix("")


def _file_name(paths: Iterable[Path]) -> str:
    """The names of all results, cut off where they get too long for a file."""
    from dlgmd_cli.results.files import fitting

    names = [Path(os.path.abspath(_home(path))).name or "root" for path in paths]
    return fitting("-".join(names)[:_MAX_NAME])


def _read(paths: Sequence[Path]) -> list[tuple[str, "Result"]]:
    """Every result with a name; those of several comparisons say which one they are from."""
    from dlgmd_cli.results.read import comparison_at, read_comparison, read_result

    comparisons = [comparison_at(path) for path in paths]
    n_comparisons = len(paths) - comparisons.count(None)
    results = []
    for path, comparison, name in zip(
        paths, comparisons, told_apart([_home(path) for path in paths]), strict=True
    ):
        if comparison is None:
            results.append((name, read_result(path)))
            if (path / "compare.csv").exists():
                say(f"Drawing the run in {path}; give {path / 'compare.csv'} for the comparison.")
        else:
            prefix = f"{name}: " if n_comparisons > 1 else ""
            results += [
                (f"{prefix}{label}", result)
                for label, result in read_comparison(comparison).items()
            ]
    return results


def _named(results: list[tuple[str, "Result"]], labels: tuple[str, ...]) -> dict[str, "Result"]:
    """The results by their labels, or by their names."""
    if labels and len(labels) != len(results):
        raise click.UsageError(
            f"--label is given {len(labels)} time{'s' * (len(labels) > 1)}, "
            f"for {len(results)} result{'s' * (len(results) > 1)}."
        )
    names = labels or numbered([name for name, _ in results])
    return {name: result for name, (_, result) in zip(names, results, strict=True)}


def _look_for_spikes(kind: str, paths: Sequence[Path], results: dict[str, "Result"]) -> None:
    """Say which results hold no spikes, if they are to be drawn."""
    if kind not in ("spikes", "overview"):
        return
    without = [name for name, result in results.items() if not result.has_spikes]
    if kind == "spikes" and len(without) == len(results):
        raise ResultError(
            str(paths[0]),
            "a comparison holds no spikes",
            "Draw its mp or attenuation, or the spikes of a run.",
        )
    if without:
        shown = ", ".join(name[:40] for name in without[:3])
        more = f" and {len(without) - 3} more" if len(without) > 3 else ""
        warn(f"no spikes are drawn of {shown}{more}: a comparison holds none")


def _look_for_normalisations(results: dict[str, "Result"]) -> None:
    """Say that levels are not alike."""
    import numpy as np

    by_sequence = {
        np.array_equal(result.level, result.mp_seq, equal_nan=True)
        for result in results.values()
        if result.has_spikes
    }
    if len(by_sequence) > 1:
        warn(
            "the results were normalised in different ways before they were held against the "
            "threshold; --normalise draws them alike"
        )


def _warn_of_annotations(annotations: Annotations, results: dict[str, "Result"]) -> None:
    """Say which annotations the figure cannot show."""
    from dlgmd_cli.plots.timeline import Timeline

    for line in annotations.outside(*Timeline.of(results.values()).frames):
        warn(line)


def _write(
    files: Iterable[Path],
    kind: str,
    results: dict[str, "Result"],
    annotations: Annotations,
    column: str,
    width: "Width",
) -> None:
    """The figure of that kind, into every file."""
    from dlgmd_cli.plots.overlays import overlay_attenuation, overlay_mp, overlay_spikes
    from dlgmd_cli.plots.overview import plot_overview
    from dlgmd_cli.plots.style import save_figure

    if kind == "attenuation":
        figure = overlay_attenuation(results, annotations, width=width)
    elif kind == "spikes":
        figure = overlay_spikes(results, annotations, width=width)
    else:
        draw = overlay_mp if kind == "mp" else plot_overview
        figure = draw(results, annotations, column=column, width=width)
    for file in files:
        save_figure(figure, file)
