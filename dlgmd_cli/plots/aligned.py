"""Results of several videos over the time to their collisions, with the mean of each model."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from dlgmd_cli.errors import ParameterError, argument, counted, warn
from dlgmd_cli.frame import Series
from dlgmd_cli.plots import curves, style
from dlgmd_cli.plots.traces import require_axes, with_contacts
from dlgmd_cli.results.result import Result

_HEIGHT_IN = 1.9
# Kind of figure -> column of its highest panel; column -> name of the vertical axis.
_COLUMNS = {"expansion": "expansion", "ttc": "ttc_s", "attenuation": "attenuation_db"}
_NAMES = {"expansion": "Expansion (1/s)", "ttc_s": "TTC (s)", "attenuation_db": "Attenuation (dB)"}

# Time to the collision in s, decreasing, and the values; NaN where undefined.
Trial = tuple[Series, Series]


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
    panel = curves.panels_of(kind, [*results.values()])[0]
    name = (column or "level") if panel == "level" else _COLUMNS.get(panel, panel)
    by_model: dict[str, list[Trial]] = {}
    for trace in curves.traces_of(results):
        contacts_s = with_contacts(trace, collisions or {}, collision_frame).contacts_s
        if contacts_s:
            trial = _trial(trace.result, name, min(contacts_s))
            by_model.setdefault(trace.result.label, []).append(trial)
    n_left_out = len(results) - sum(map(len, by_model.values()))
    if not by_model:
        hint = f"Give {argument('collisions')}, a table of labels."
        raise ParameterError("", "no result has a known collision", hint)
    if n_left_out:
        warn(f"{counted(n_left_out, 'result')} without a known collision left out")
    with style.house_style():
        figure = style.new_figure(_HEIGHT_IN * style.text_scale(), width)
        axes = figure.subplots() if ax is None else require_axes(ax)
        entries = _draw(axes, by_model, mean=mean)
        axes.axvline(0.0, color=style.BLACK, linewidth=1.4, zorder=2.4)
        longest_s = max(trial[0].max() for trials in by_model.values() for trial in trials)
        axes.set_xlim(*sorted(xlim or (min(0.0, -0.02 * longest_s), longest_s), reverse=True))
        if ylim or panel == "level":
            axes.set_ylim(ylim or curves.LEVEL_LIMITS)
        axes.set(xlabel="Time to collision (s)", ylabel=_name(name, results))
        if ax is not None:
            handles, texts = zip(*entries, strict=True)
            axes.legend(handles, map(style.plain, texts), fontsize="small")
            return ax.figure  # type: ignore[return-value]
        style.add_legend(figure, entries)
    return figure


def _trial(result: Result, name: str, contact_s: float) -> Trial:
    """The new frames of a result from its first to its last defined value."""
    new = ~result.is_repeat
    to_contact_s, values = contact_s - result.time_s[new], getattr(result, name)[new]
    values = np.where(np.isfinite(values), values, np.nan)
    known = np.flatnonzero(~np.isnan(values))
    if not known.size:
        return to_contact_s, values
    within = slice(known[0], known[-1] + 1)
    return to_contact_s[within], values[within]


def mean_of(trials: Sequence[Trial]) -> tuple[Series, Series, Series]:
    """The mean of at least two trials, and its standard error, at the times common to all trials.

    Returns
    -------
    at_s, mean, sem : ndarray, shape (n,)
        Multiples of the shortest interval between frames, 0 included; the mean and the sample's
        standard deviation over the root of the number of trials. NaN where a trial is undefined.
    """
    step_s = min(np.median(-np.diff(at_s)) for at_s, _ in trials)
    first, last = max(at_s[-1] for at_s, _ in trials), min(at_s[0] for at_s, _ in trials)
    at = np.arange(np.ceil(first / step_s - 1e-6), np.floor(last / step_s + 1e-6) + 1.0) * step_s
    if not at.size:
        raise ParameterError("", "the results have no time to the collision in common")
    every = np.array([np.interp(at, at_s[::-1], values[::-1]) for at_s, values in trials])
    return at, every.mean(axis=0), every.std(axis=0, ddof=1) / np.sqrt(len(trials))


def _draw(axes: Axes, by_model: Mapping[str, Sequence[Trial]], *, mean: bool) -> style.Entries:
    """Draw the trials of each model, with `mean` also their mean; returns the legend's entries."""
    entries: style.Entries = []
    for place, (model, trials) in enumerate(by_model.items()):
        color, dashes = curves.LOOKS[place % len(curves.LOOKS)]
        for at_s, values in trials:
            (line,) = axes.plot(at_s, values, color=color, linewidth=0.4, alpha=0.6)
        text = f"{model}, {counted(len(trials), 'trial')}"
        if mean and len(trials) > 1:
            at_s, middle, error = mean_of(trials)
            (line,) = axes.plot(at_s, middle, color=color, linestyle=dashes, linewidth=1.6)
            band = axes.fill_between(at_s, middle - error, middle + error)
            band.set(color=color, alpha=0.25, linewidth=0.0)
            text = f"{model}, mean ± SEM of {counted(len(trials), 'trial')}"
        entries.append((line, text))
    return entries


def _name(name: str, results: Mapping[str, Result]) -> str:
    """The name of the vertical axis."""
    if name not in curves.MP_COLUMNS:
        return _NAMES.get(name, name)
    scales = {name == "mp_seq" or (name == "level" and r.by_sequence) for r in results.values()}
    return curves.LEVEL_NAMES[scales.pop()] if len(scales) == 1 else curves.EITHER
