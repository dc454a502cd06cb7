"""Everything that models say over time in one figure."""

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from dlgmd_cli.plots.legend import Keys
from dlgmd_cli.plots.overlays import add_attenuation, add_mp
from dlgmd_cli.plots.panels import Panels
from dlgmd_cli.plots.raster import draw_raster, raster_height_in
from dlgmd_cli.plots.series import UNDEFINED
from dlgmd_cli.plots.style import Width, house_style
from dlgmd_cli.results.annotations import Annotations
from dlgmd_cli.results.tables import Result

_HEIGHT_IN = 1.1
# Where the labels of the vertical axes stand, left of these, so that they are in line.
_LABELS_IN = 0.4

_NO_ANNOTATIONS = Annotations()


def plot_overview(
    results: Mapping[str, Result],
    annotations: Annotations = _NO_ANNOTATIONS,
    *,
    column: str = "level",
    width: Width = "one",
) -> Figure:
    """Membrane potential, attenuation and spikes on one time axis.

    Where no result knows of spikes, their panel is left out.

    Parameters
    ----------
    results, annotations, column, width
        As `overlay_mp` takes them.

    Raises
    ------
    ValueError
        If there is no result, or `column` or `width` is none of these.
    """
    with house_style():
        panels = Panels(results, annotations, width)
        keys = add_mp(panels, column, _HEIGHT_IN) + add_attenuation(panels, _HEIGHT_IN)
        if any(result.has_spikes for result in results.values()):
            raster = panels.add(raster_height_in(panels.traces))
            keys += draw_raster(raster, panels.traces, panels.width_in)
        figure = panels.finish(_without_repeats(keys))
        for axes in figure.axes:
            axes.yaxis.set_label_coords(-_LABELS_IN / panels.width_in, 0.5)
    return figure


def _without_repeats(keys: Keys) -> Keys:
    """Each entry once; a line is undefined only if all panels say so."""
    kept: dict[str, tuple[Any, str]] = {}
    for handle, label in keys:
        name = label.removesuffix(UNDEFINED)
        if name not in kept or kept[name][1] != name:
            kept[name] = (handle, label)
    return list(kept.values())
