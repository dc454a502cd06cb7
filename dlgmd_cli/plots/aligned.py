"""Results of several videos over the time to their collisions, with the mean of each model."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from dlgmd_cli.errors import ParameterError, argument, counted, warn
from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.plots import curves, style
from dlgmd_cli.plots.traces import require_axes, with_contacts
from dlgmd_cli.results.csv import Cell, text_cell
from dlgmd_cli.results.result import Result

_HEIGHT_IN = 1.9
# Kind of figure -> column of its highest panel; column -> name of the vertical axis.
_COLUMNS = {"expansion": "expansion", "ttc": "ttc_s", "attenuation": "attenuation_db"}
_NAMES = {**curves.SIGNAL_NAMES, "attenuation_db": "Attenuation (dB)"}

# The first columns of aligned.csv; each result has a further column.
COLUMNS = ("model", "time_to_collision_s", "mean", "sem", "n")
# A time counts as one of a trial if it is less than this share of a step outside.
_ROUNDING = 1e-6


class Trial(NamedTuple):
    """A result from its first to its last defined value.

    Attributes
    ----------
    at_s, values : ndarray, shape (n,)
        Time to the collision in s, decreasing, and the values; NaN where undefined.
    video : str
        The path of the input.
    """

    at_s: Series
    values: Series
    video: str


# Model -> label of the result -> trial.
Trials = dict[str, dict[str, Trial]]


def plot(
    kind: str,
    results: Mapping[str, Result],
    *,
    mean: bool = False,
    column: str | None = None,
    collisions: Mapping[str, Sequence[int]] | None = None,
    collision_frame: int | None = None,
    width: style.Width = "one",
    xlim: tuple[float, float] | None = None,
    ylim: tuple[float, float] | None = None,
    ax: Axes | None = None,
) -> style.Figure:
    """Draw the highest panel of a kind of figure over the time to each result's first collision.

    Each result is a thin line in the colour of its model. `mean` adds the mean over a model's
    results, plus and minus its standard error, at the times that all these results have. Results
    without a known collision are left out, with a warning. For the other arguments, see
    `traces.plot`; `xlim` is in seconds to the collision.

    Raises
    ------
    ParameterError
        If no result has a known collision, or the results of a model have no time in common.
    """
    by_model = trials_of(kind, results, column, collisions, collision_frame)
    n_left_out = len(results) - sum(map(len, by_model.values()))
    if n_left_out:
        warn(f"{counted(n_left_out, 'result')} without a known collision left out")
    name = _column_of(kind, results, column)
    with style.house_style():
        figure = style.new_figure(_HEIGHT_IN, width)
        axes = figure.subplots() if ax is None else require_axes(ax)
        entries = _draw(axes, by_model, mean=mean)
        axes.axvline(0.0, color=style.BLACK, linewidth=1.4, zorder=2.4)
        every = [trial for trials in by_model.values() for trial in trials.values()]
        longest_s = max(trial.at_s.max() for trial in every)
        least_s = min(trial.at_s.min() for trial in every)
        if xlim and not (xlim[0] < longest_s and least_s < xlim[1]):
            times = f"{least_s:.3g} to {longest_s:.3g} s before the collision"
            why = f"{argument('xlim')} shows no frame: the results are from {times}"
            raise ParameterError("", why)
        axes.set_xlim(*sorted(xlim or (min(0.0, -0.02 * longest_s), longest_s), reverse=True))
        if ylim or name in curves.MP_COLUMNS:
            axes.set_ylim(ylim or curves.LEVEL_LIMITS)
        axes.set(xlabel="Time to collision (s)", ylabel=_name(name, results))
        if ax is not None:
            handles, texts = zip(*entries, strict=True)
            axes.legend(handles, map(style.plain, texts), fontsize="small")
            return ax.figure  # type: ignore[return-value]
        style.add_legend(figure, entries)
    return figure


def trials_of(
    kind: str,
    results: Mapping[str, Result],
    column: str | None = None,
    collisions: Mapping[str, Sequence[int]] | None = None,
    collision_frame: int | None = None,
) -> Trials:
    """The results with a known collision, by model and label; for the arguments, see `plot`.

    Raises ParameterError if no result has a known collision.
    """
    name, by_model = _column_of(kind, results, column), Trials()
    for trace in curves.traces_of(results):
        contacts_s = with_contacts(trace, collisions or {}, collision_frame).contacts_s
        if contacts_s:
            trial = _trial(trace.result, name, min(contacts_s))
            by_model.setdefault(trace.result.label, {})[trace.label] = trial
    if not by_model:
        hint = f"Give {argument('collisions')}, a table of labels."
        raise ParameterError("", "no result has a known collision", hint)
    return by_model


def rows(by_model: Trials) -> tuple[list[str], Iterator[list[Cell]]]:
    """The columns and the rows of aligned.csv: for each model, its mean and its single curves.

    `mean` is empty where not all trials of the model are defined, `sem` is empty for one trial, and
    `n` is the number of defined trials.
    """
    labels = [label for trials in by_model.values() for label in trials]

    def every() -> Iterator[list[Cell]]:
        for model, trials in by_model.items():
            at_s, values, mean, sem = mean_of([*trials.values()])
            own = dict(zip(trials, values, strict=True))
            for i, numbers in enumerate(np.stack((at_s, mean, sem), axis=1).tolist()):
                n = int(np.isfinite(values[:, i]).sum())
                yield [
                    model,
                    *numbers,
                    n,
                    *(float(own[k][i]) if k in own else None for k in labels),
                ]

    return [*COLUMNS, *map(text_cell, labels)], every()


def _column_of(kind: str, results: Mapping[str, Result], column: str | None) -> str:
    """The column of the results that the highest panel of a kind of figure shows."""
    panel = curves.panels_of(kind, [*results.values()])[0]
    return (column or "level") if panel == "level" else _COLUMNS.get(panel, panel)


def _trial(result: Result, name: str, contact_s: float) -> Trial:
    """The new frames of a result from its first to its last defined value."""
    new = ~result.is_repeat
    to_contact_s = contact_s - result.time_s[new]
    values = curves.compared(result, name)[new]
    values = np.where(np.isfinite(values), values, np.nan)
    known = np.flatnonzero(~np.isnan(values))
    within = slice(known[0], known[-1] + 1) if known.size else slice(None)
    video = str(result.record["input"].get("path", ""))
    return Trial(to_contact_s[within], values[within], video)


def mean_of(trials: Sequence[Trial]) -> tuple[Series, Series, Series, Series]:
    """The mean of at least one trial, and its standard error.

    Returns
    -------
    at_s : ndarray, shape (n,)
        Multiples of the shortest interval between frames, 0 included, from the last to the first
        time of any trial.
    values : ndarray, shape (trials, n)
        Each trial at these times, interpolated; NaN where undefined.
    mean, sem : ndarray, shape (n,)
        The mean, and the sample's standard deviation over the root of the number of trials. NaN
        where a trial is undefined.

    Raises
    ------
    ParameterError
        If the trials have no time in common.
    """
    step_s = min(np.median(-np.diff(trial.at_s)) for trial in trials)
    ends = np.array([(trial.at_s[-1], trial.at_s[0]) for trial in trials]) / step_s
    ends += -_ROUNDING, _ROUNDING
    at = np.arange(np.ceil(ends[:, 0].min()), np.floor(ends[:, 1].max()) + 1.0)
    within: Flags = (at >= ends[:, :1]) & (at <= ends[:, 1:])
    if not within.all(axis=0).any():
        raise ParameterError("", "the results have no time to the collision in common")
    values = np.array([np.interp(at * step_s, t.at_s[::-1], t.values[::-1]) for t in trials])
    values[~within] = np.nan
    n = len(trials)
    spread = values.std(axis=0, ddof=1) if n > 1 else np.full(len(at), np.nan)
    return at * step_s, values, values.mean(axis=0), spread / np.sqrt(n)


def _draw(axes: Axes, by_model: Trials, *, mean: bool) -> style.Entries:
    """Draw the trials of each model, with `mean` also their mean; returns the legend's entries."""
    entries: style.Entries = []
    for place, (model, by_label) in enumerate(by_model.items()):
        trials = [*by_label.values()]
        color, dashes = curves.LOOKS[place % len(curves.LOOKS)]
        for trial in trials:
            (line,) = axes.plot(trial.at_s, trial.values, color=color, linewidth=0.4, alpha=0.6)
        # Trials repeat one video; different videos are no trials.
        are_videos = len({trial.video for trial in trials}) == len(trials)
        number = counted(len(trials), "video" if are_videos else "trial")
        text = f"{model}, {number}"
        if mean and len(trials) > 1:
            at_s, _, middle, error = mean_of(trials)
            (line,) = axes.plot(at_s, middle, color=color, linestyle=dashes, linewidth=1.6)
            band = axes.fill_between(at_s, middle - error, middle + error)
            band.set(color=color, alpha=0.25, linewidth=0.0)
            text = f"{model}, mean ± SEM of {number}"
        entries.append((line, text))
    return entries


def _name(name: str, results: Mapping[str, Result]) -> str:
    """The name of the vertical axis."""
    if name not in curves.MP_COLUMNS:
        return _NAMES.get(name, name)
    scales = {name == "mp_seq" or (name == "level" and r.by_sequence) for r in results.values()}
    return curves.LEVEL_NAMES[scales.pop()] if len(scales) == 1 else curves.EITHER
