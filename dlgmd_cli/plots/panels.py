"""Panels that stand on one time axis, with room above them for annotations and a legend."""

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dlgmd_cli.plots.legend import Keys, LegendPlan
from dlgmd_cli.plots.marks import Marks
from dlgmd_cli.plots.series import Trace, traces_of
from dlgmd_cli.plots.style import (
    LEFT_IN,
    Width,
    axes_width_in,
    figure_width_in,
    fractions,
    new_figure,
)
from dlgmd_cli.plots.time_axis import label_time
from dlgmd_cli.plots.timeline import Timeline
from dlgmd_cli.results.annotations import Annotations
from dlgmd_cli.results.tables import Result

# Room in inches: for the seconds, between panels, for the frame numbers or nothing in their
# place, and for the first row of a legend.
_BOTTOM_IN, _GAP_IN, _FRAMES_IN, _NO_FRAMES_IN, _LEGEND_IN = 0.38, 0.07, 0.41, 0.08, 0.13


class Panels:
    """A figure on its way: `add` its panels from the top down, then `finish` it.

    Parameters
    ----------
    results : mapping of str to Result
        What the panels show, by label; at least one, each with at least one frame.
    annotations : Annotations
        What goes across all panels.
    width : "one" or "two"
        Columns of the paper that the figure takes.

    Raises
    ------
    ValueError
        If there is no result, or no such width.
    """

    def __init__(
        self, results: Mapping[str, Result], annotations: Annotations, width: Width
    ) -> None:
        if not results:
            raise ValueError("there is no result to draw")
        self._width = width
        self.width_in = axes_width_in(width)
        self.timeline = Timeline.of(results.values())
        self.traces: list[Trace] = traces_of(results, self.timeline, self.width_in)
        self._marks = Marks(annotations, self.timeline, self.width_in)
        self._figure = new_figure(1.0, width)
        self._panels: list[tuple[Axes, float]] = []

    def add(self, height_in: float) -> Axes:
        """Empty axes of that height, below those before."""
        axes = self._figure.add_axes((0.0, 0.0, 1.0, 1.0), label=f"panel {len(self._panels)}")
        axes.set_xlim(self.timeline.view)
        axes.set_xticks([])
        if self._panels:
            axes.spines["top"].set_visible(False)
            self._panels[-1][0].spines["bottom"].set_visible(False)
        self._panels.append((axes, height_in))
        return axes

    def finish(self, keys: Keys | None) -> Figure:
        """Put everything in its place, with the legend's entries; None leaves it no room."""
        legend = LegendPlan(keys or [], self._width, patterned=not self.traces[0].alone)
        strip_in = self._marks.height_in
        above = _FRAMES_IN if self.timeline.is_shared else _NO_FRAMES_IN
        if keys is not None:
            above += _LEGEND_IN + legend.more_in
        heights = sum(height for _, height in self._panels) + _GAP_IN * (len(self._panels) - 1)
        figure = self._figure
        figure.set_size_inches(
            figure_width_in(self._width), _BOTTOM_IN + heights + strip_in + above
        )
        y = _BOTTOM_IN
        for axes, height in reversed(self._panels):
            axes.set_position(fractions(figure, (LEFT_IN, y, self.width_in, height)))
            y += height + _GAP_IN
        highest, lowest = self._panels[0][0], self._panels[-1][0]
        if strip_in:
            box = (LEFT_IN, y - _GAP_IN, self.width_in, strip_in)
            strip = figure.add_axes(fractions(figure, box), label="annotations")
            highest.spines["top"].set_visible(False)
            self._marks.draw(strip, [axes for axes, _ in self._panels])
            highest = strip
        label_time(lowest, self.timeline, self.width_in, highest)
        legend.draw(figure)
        return figure
