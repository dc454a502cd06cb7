"""Figures of stored results: the kinds of `annotations.KINDS`, or any column of a result."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from dlgmd_cli.errors import ParameterError, ResultError, argument, printable, warn
from dlgmd_cli.parameters.checks import refuse, require_known
from dlgmd_cli.parameters.facts import stating
from dlgmd_cli.results import store
from dlgmd_cli.results.annotations import KINDS, NONE, PLOT_ARGUMENTS, Annotations
from dlgmd_cli.results.csv import write_values
from dlgmd_cli.results.files import COMPARED, FIGURE_FORMATS
from dlgmd_cli.results.labels import read_by_video
from dlgmd_cli.results.names import distinct_names, numbered
from dlgmd_cli.results.outcome import Written, drawn_by
from dlgmd_cli.results.reading import labelled_frames, read_comparison, read_result, readable
from dlgmd_cli.results.result import Result
from dlgmd_cli.tasks.call import require_one_each
from dlgmd_cli.tasks.compare import Comparison

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_log = logging.getLogger(__name__)

_LEVEL_COLUMNS = {"absolute": "mp_abs", "sequence": "mp_seq"}
# The table of the curves and means of a figure with `align` and `mean`.
ALIGNED = "aligned.csv"
# Greatest number of characters of a figure's name.
_MAX_NAME = 100


@stating(PLOT_ARGUMENTS)
def plot(
    results: Result | Comparison | Mapping[str, Result] | Iterable[Result],
    kind: str = "mp",
    *,
    align: str | None = None,
    mean: bool = False,
    **options: Any,
) -> Figure:
    """Draw results over time in one figure, as `dlgmd plot` does.

    Parameters
    ----------
    results : Result, Comparison, mapping of str to Result, or iterable of Result
        Results without labels are called by their titles, such as "group2 · set9".
    kind : {"mp", "attenuation", "spikes", "ttc", "overview"} or str
        The membrane potential above the expansion, the attenuation, the potential above spikes and
        alarms, the expansion and the time to contact, all of these, or the name of a column.
    align : "collision", optional
        Draw the highest panel over the time to the first collision of each result.
    mean : bool
        With `align`, draw the mean over the results of each model, and its standard error.
    options
        ``ax``: Axes of an existing figure, into which the highest panel is drawn. ``mark``:
        texts at frames, as ``[(40, "pitching")]``; for one result, as ``[("flight", 40,
        "pitching")]``. ``span``: texts over frames, as ``[(40, 75, "accelerating")]``.
        ``collision_frame``, ``false_positive_frame``: frames. ``collisions``: frames of collisions
        by label. ``emphasise``: the label of the strongest line. ``until``:
        "collision", to show only the time up to it. ``one_panel``: the highest panel alone.
        ``xlim`` (s), ``ylim`` (potential or dB): pairs. ``column``: "mp_abs" or "mp_seq", a
        potential that the spikes do not follow. ``width``: columns of a paper, "one" or "two".
        `Result.plot` and `Comparison.plot` take these options too. `align` allows only ``ax``,
        ``collision_frame``, ``collisions``, ``xlim``, ``ylim``, ``column`` and ``width``.

    Returns
    -------
    matplotlib.figure.Figure
        With ``ax``, the figure of these axes.

    Raises
    ------
    ParameterError
        If an annotation is not valid.
    ValueError
        If there is no result, or an option has a value that is not listed.

    Examples
    --------
    >>> figure = plot({"a": one, "b": other}, mark=[("a", 64, "x")])  # doctest: +SKIP
    """
    if isinstance(results, Comparison):
        results = results.results
    if isinstance(results, Result):
        results = [results]
    if isinstance(results, str | os.PathLike):
        raise ParameterError("", "results are no path", f"Write read_results({str(results)!r}).")
    if not isinstance(results, Mapping):
        results = list(results)
        results = dict(zip(numbered([result.title for result in results]), results, strict=True))
    return _drawer(align, mean=mean)(kind, results, **options)


def _drawer(align: str | None, *, mean: bool) -> Callable[..., Figure]:
    """The function that draws results over video time, or over the time to their collisions."""
    if align is None:
        align_option = argument("align", "collision")
        refuse({"mean": mean}, f"works only with {align_option}", f"Add {align_option}.")
        return drawn_by("traces.plot")
    require_known("align", align, ("collision",))
    return partial(drawn_by("aligned.plot"), mean=mean)


def plot_files(
    kind: str,
    paths: Sequence[Path],
    out: Path,
    annotations: Annotations = NONE,
    *,
    labels: Sequence[str] = (),
    emphasise: str | None = None,
    collisions: Path | None = None,
    until: str | None = None,
    one_panel: bool = False,
    xlim: tuple[float, float] | None = None,
    ylim: tuple[float, float] | None = None,
    normalise: str | None = None,
    align: str | None = None,
    mean: bool = False,
    width: Literal["one", "two"] = "one",
    overwrite: bool = False,
) -> Written:
    """Draw stored results, and write the figure.

    `paths` are folders of results, trees of them, or a ``compare.csv``; `out` is a folder for
    ``KIND-NAME.png``, or a file with the suffix of a figure; with `mean`, ALIGNED is beside it.
    Results are called by their folders unless there are `labels`. `collisions` is a table of
    labels: each result shows its own. `normalise` is "absolute" or "sequence". For the others, see
    `plots.traces.plot`.

    Raises ParameterError for labels or limits that do not fit the results, ResultError for a result
    that is missing or damaged, and OutputError or OutputExistsError for a figure that cannot be
    written.
    """
    named = _read(store.with_results(paths))
    require_one_each(labels, len(named), "result")
    shown = labels or numbered([name for name, _ in named])
    results = {label: result for label, (_, result) in zip(shown, named, strict=True)}
    columns = set.intersection(*(set(result.own_columns) for result in results.values()))
    require_known("figure", kind, (*KINDS, *sorted(columns)))
    if emphasise and emphasise not in results:
        known = ", ".join(map(printable, results))
        why = f"no result is called {printable(emphasise)}"
        raise ParameterError(argument("emphasise"), why, f"Choose from {known}.")
    contacts = _collisions(collisions, results) if collisions else {}
    draw, name = _drawer(align, mean=mean), f"{kind}-{_stem(paths)}"
    column, tables = _column(kind, normalise, results), dict[str, store.Write]()
    options: dict[str, Any] = {"width": width, "xlim": xlim, "ylim": ylim}
    if align:
        others = {
            "mark": annotations.marks,
            "span": annotations.spans,
            "label": labels,
            "emphasise": emphasise,
            "until": until,
            "one_panel": one_panel or None,
            "false_positive_frame": annotations.false_positive_frame,
        }
        refuse(others, f"does not work with {argument('align')}")
        options |= {"collisions": contacts, "collision_frame": annotations.collision_frame}
        name = f"{kind}-aligned-{_stem(paths)}"
        if mean:
            frame = annotations.collision_frame
            trials = drawn_by("aligned.trials_of")(kind, results, column, contacts, frame)
            header, rows = drawn_by("aligned.rows")(trials)
            tables[ALIGNED] = partial(write_values, header=header, rows=rows)
    else:
        _check_times(results, annotations, xlim)
        annotations.require(results)
        titles = {
            label: label if labels or result.label in label else f"{label} · {result.label}"
            for label, result in results.items()
        }
        results = {titles[label]: result for label, result in results.items()}
        options |= {
            "annotations": annotations.renamed(titles),
            "until": until,
            "one_panel": one_panel,
            "emphasise": titles[emphasise] if emphasise else None,
            "collisions": {titles[label]: frames for label, frames in contacts.items()},
        }
    figure = draw(kind, results, column=column, **options)
    is_file = out.suffix.lower().endswith(FIGURE_FORMATS)
    folder, name = (out.parent, out.name) if is_file else (out, f"{name}.png")
    save: store.Write = partial(drawn_by("style.save_figure"), figure)
    files = {name: save, **tables}
    # Without a lock: a batch may be writing into its own folders below.
    with store.claimed(folder, names=files, overwrite=overwrite, locks=False) as claim:
        return Written(claim.write(files))


def _folder(path: Path) -> Path:
    """The folder of a path; for a table of a comparison or batch, the folder of the table."""
    return path.absolute().parent if path.name in (COMPARED, store.SUMMARY) else path


def _stem(paths: Sequence[Path]) -> str:
    """The names of all given paths, cut off where too long for a file name."""
    names = "-".join(Path(os.path.abspath(_folder(path))).name or "root" for path in paths)
    return store.fitting(names[:_MAX_NAME])


def _read(paths: Sequence[Path]) -> list[tuple[str, Result]]:
    """Every result with its name.

    With several comparisons, each name begins with the name of its comparison.
    """
    folders = [_folder(path) for path in paths]
    are_compared = []
    for path, folder in zip(paths, folders, strict=True):
        if path.suffix.lower() == ".csv" and path.name != COMPARED:
            why = "is one file of a result"
            raise ResultError(str(path), why, "Give the folder that holds it.")
        has_run, has_comparison = (
            (folder / record).exists() for record in (store.RUN, store.COMPARISON)
        )
        are_compared.append(folder is not path or (has_comparison and not has_run))
        if has_run and has_comparison and folder is path:
            table = path / COMPARED
            _log.info("Note: %s holds a run and a comparison; for that, give %s.", path, table)
    is_named = sum(are_compared) > 1
    each = zip(folders, distinct_names(folders), are_compared, strict=True)
    return list(chain(*readable(partial(_read_one, *one, is_named=is_named) for one in each)))


def _read_one(
    folder: Path, name: str, is_compared: bool, *, is_named: bool
) -> list[tuple[str, Result]]:
    """The result in a folder, or those of a comparison; with `is_named`, by its name and label."""
    if not is_compared:
        return [(name, read_result(folder))]
    prefix = f"{name}: " if is_named else ""
    return [(f"{prefix}{label}", result) for label, result in read_comparison(folder).items()]


def _collisions(path: Path, results: Mapping[str, Result]) -> dict[str, list[int]]:
    """The labelled collision frames of each result; warns of collisions that cannot be shown."""
    known = read_by_video(path)
    found = {label: labelled_frames(known, result, label) for label, result in results.items()}
    return {label: frames for label, frames in found.items() if frames is not None}


def _column(kind: str, normalise: str | None, results: Mapping[str, Result]) -> str:
    """The column of the potential to draw; warns if the results were normalised differently."""
    if normalise:
        return _LEVEL_COLUMNS[normalise]
    has_level = kind in KINDS and "level" in KINDS[kind]
    if has_level and len({result.by_sequence for result in results.values()}) > 1:
        warn(
            "the results were normalised in different ways before the threshold was applied; "
            f"{argument('normalise')} draws them alike"
        )
    return "level"


def _check_times(
    results: Mapping[str, Result], annotations: Annotations, xlim: tuple[float, float] | None
) -> None:
    """Raise ParameterError if the limits show no frame, and warn of annotations outside."""
    from dlgmd_cli.plots.timeline import Timeline

    timeline = replace(Timeline.of(results.values()), limits=xlim)
    if xlim and not (xlim[0] < timeline.end_s and timeline.start_s < xlim[1]):
        times = f"{timeline.start_s:.6g} to {timeline.end_s:.6g} s"
        raise ParameterError("", f"{argument('xlim')} shows no frame: the results are from {times}")
    for line in annotations.outside(*timeline.frames):
        warn(line)
