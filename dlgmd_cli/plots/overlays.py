"""What models say over time, one result or several on the same axes. Data in, Figure out."""

from collections.abc import Mapping

from matplotlib.figure import Figure

from dlgmd_cli.plots.draw import (
    SILENCE_IN,
    draw_attenuation,
    draw_events,
    draw_level,
    is_silent,
)
from dlgmd_cli.plots.legend import Keys
from dlgmd_cli.plots.panels import Panels
from dlgmd_cli.plots.raster import draw_raster, raster_height_in
from dlgmd_cli.plots.series import range_key
from dlgmd_cli.plots.style import Width, house_style
from dlgmd_cli.results.annotations import Annotations
from dlgmd_cli.results.tables import Result

_HEIGHT_IN = 1.25
_UNDER_RASTER_IN = 1.3

_NO_ANNOTATIONS = Annotations()


def overlay_mp(
    results: Mapping[str, Result],
    annotations: Annotations = _NO_ANNOTATIONS,
    *,
    column: str = "level",
    width: Width = "one",
) -> Figure:
    """Normalised membrane potential of every result.

    One result is shown with its threshold, spikes and collisions; several with the threshold
    only, and that if it is the same for all.

    Parameters
    ----------
    results : mapping of str to Result
        By label, in the order of the legend; at least one, each with at least one frame. Frames
        without a level leave a gap. Of a long result the line is the highest level of every
        column of pixels, over a band down to the lowest.
    annotations : Annotations
        Placed by the times that the frames have in the first result.
    column : "level", "mp_abs" or "mp_seq"
        What is drawn: the level that was held against the threshold, the potential normalised
        without later frames, or the one scaled to each sequence's own extremes.
    width : "one" or "two"
        Columns of the paper that the figure takes.

    Raises
    ------
    ValueError
        If there is no result, or `column` or `width` is none of these.
    """
    with house_style():
        panels = Panels(results, annotations, width)
        return panels.finish(add_mp(panels, column, _HEIGHT_IN))


def overlay_attenuation(
    results: Mapping[str, Result],
    annotations: Annotations = _NO_ANNOTATIONS,
    *,
    width: Width = "one",
) -> Figure:
    """Attenuation 10 lg(ΣS/ΣP) of every result, in dB.

    There is a gap where it is undefined, and a mark at the bottom where next to nothing passes;
    of several results the marks have a row each, in the order of the legend.

    Parameters
    ----------
    results, annotations, width
        As `overlay_mp` takes them.

    Raises
    ------
    ValueError
        If there is no result, or no such width.
    """
    with house_style():
        panels = Panels(results, annotations, width)
        return panels.finish(add_attenuation(panels, _HEIGHT_IN))


def overlay_spikes(
    results: Mapping[str, Result],
    annotations: Annotations = _NO_ANNOTATIONS,
    *,
    width: Width = "one",
) -> Figure:
    """Raster of spikes and collisions above the levels that caused them.

    Of several results every one has a row, with a sample of its line beside it. Spikes too near
    each other to be told apart are one bar.

    Parameters
    ----------
    results, annotations, width
        As `overlay_mp` takes them.

    Raises
    ------
    ValueError
        If there is no result, or no such width.
    """
    with house_style():
        panels = Panels(results, annotations, width)
        raster = panels.add(raster_height_in(panels.traces))
        keys = draw_raster(raster, panels.traces, panels.width_in)
        keys = draw_level(panels.add(_UNDER_RASTER_IN), panels.traces) + keys
        if panels.traces[0].alone:
            return panels.finish(None)
        return panels.finish(keys + range_key(panels.traces))


def add_mp(panels: Panels, column: str, height_in: float) -> Keys:
    """A panel of membrane potential; returns what belongs into the legend."""
    axes, traces = panels.add(height_in), panels.traces
    keys = draw_level(axes, traces, column)
    if traces[0].alone:
        keys += draw_events(axes, traces[0], getattr(traces[0].result, column))
    return keys + range_key(traces)


def add_attenuation(panels: Panels, height_in: float) -> Keys:
    """A panel of attenuation, higher by the rows of marks that it needs; as `add_mp`."""
    n_silent = sum(bool(is_silent(trace).any()) for trace in panels.traces)
    height_in += max(n_silent - 1, 0) * SILENCE_IN
    keys = draw_attenuation(panels.add(height_in), panels.traces, height_in)
    return keys + range_key(panels.traces)
