"""The PNGs of one result, put together from one drawing.

A figure takes longer than the decoding of a short clip, most of it for axes and text, which the
figures of a result share. So one figure with all panels is kept, and drawn once for each result;
its rows of pixels are put together to the pictures that `traces.plot` would draw.
"""

from collections.abc import Callable, Collection
from functools import cache, partial
from io import BytesIO
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from dlgmd_cli.plots.curves import DRAWS, AxisScale, traces_of
from dlgmd_cli.plots.style import (
    DPI,
    PNG_OPTIONS,
    check_letters,
    figure_files,
    fit_legend,
    house_style,
    new_figure,
)
from dlgmd_cli.plots.timeline import Timeline
from dlgmd_cli.plots.traces import ABOVE_IN, BELOW_IN, BETWEEN_IN, fix_margins, heights_alone
from dlgmd_cli.results.annotations import KINDS
from dlgmd_cli.results.result import Result

Picture = npt.NDArray[np.uint8]

_ABOVE, _BELOW, _BETWEEN = (round(DPI * inches) for inches in (ABOVE_IN, BELOW_IN, BETWEEN_IN))
# The panels of the drawing: the highest has nothing at its upper edge, the lowest at its lower one.
_NAMES = ("raster", "level", "attenuation")
# The pictures, and which of the two legends each has.
_KINDS = {"mp": 0, "attenuation": 1, "spikes": 0}
# Rows that are free for a legend, and that the line along the upper edge of a panel takes in it.
_LEGEND, _LINE = 160, 2


class _Drawing:
    """A figure with two legends, the axis of frames, all panels, and the time axis."""

    def __init__(self) -> None:
        heights = heights_alone(_NAMES)
        between_in, legends_in = 2 * BETWEEN_IN, 2 * _LEGEND / DPI
        with house_style():
            figure = new_figure(legends_in + ABOVE_IN + sum(heights) + 2 * between_in + BELOW_IN)
            self._panels: Any = figure.subplots(len(_NAMES), sharex=True, height_ratios=heights)
            fix_margins(figure, heights, between_in, ABOVE_IN + legends_in)
            for axes in self._panels:
                axes.spines["top"].set_visible(False)
            for axes in self._panels[:-1]:
                axes.spines["bottom"].set_visible(False)
                axes.tick_params(axis="x", bottom=False)
        self._figure = figure
        self._canvas: Any = FigureCanvasAgg(figure)
        height = figure.bbox.height
        self._heights_in = heights
        boxes = [axes.get_window_extent() for axes in self._panels]
        self._left = round(boxes[0].x0) - 1
        self._rows = [(round(height - box.y1), round(height - box.y0)) for box in boxes]

    def pictures(self, result: Result) -> dict[str, Picture]:
        """The pictures by kind, each (height, width, 3) RGB."""
        figure = self._figure
        with house_style():
            for axes in self._panels:
                for artist in (*axes.lines, *axes.collections, *axes.texts):
                    artist.remove()
            for legend in tuple(figure.legends):
                legend.remove()
            traces = traces_of({result.name: result})
            _, of_level, of_attenuation = (
                DRAWS[name](axes, traces, AxisScale(height_in))
                for name, axes, height_in in zip(
                    _NAMES, self._panels, self._heights_in, strict=True
                )
            )
            Timeline.of([result]).label(self._panels[-1], self._panels[0])
            place: Any = {"loc": "upper center"}
            second = {"bbox_to_anchor": (0.0, 0.0, 1.0, 1.0 - _LEGEND / figure.bbox.height)}
            heights = (
                fit_legend(figure, of_level, place),
                fit_legend(figure, of_attenuation, place | second),
            )
            self._canvas.draw()
        pixels = np.asarray(self._canvas.buffer_rgba())[:, :, :3]
        return {
            kind: self._put_together(pixels, KINDS[kind], place, heights[place])
            for kind, place in _KINDS.items()
        }

    def _put_together(
        self, pixels: Picture, names: tuple[str, ...], place: int, legend: int
    ) -> Picture:
        """The picture of some panels below a legend, given by its place and its height in px."""
        rows = [self._rows[_NAMES.index(name)] for name in names]
        first, last = self._rows[0][0], self._rows[-1][1]
        everywhere = slice(None)
        # Begin and end of each part in the drawing, its begin in the picture, its columns.
        at = legend + _ABOVE
        parts = [
            (place * _LEGEND, (place + 1) * _LEGEND, 0, everywhere),
            (first - _ABOVE, first + _LINE, legend, everywhere),
        ]
        for begin, end in rows:
            if begin == first:  # its upper edge has the axis of frames; take the next panel's
                edge, side = self._rows[1][0], slice(self._left, self._left + _LINE)
                parts.append((edge - 1, edge + _LINE, at - 1, side))
                parts.append((begin + _LINE, end + _BETWEEN, at + _LINE, everywhere))
            else:  # the numbers beside a panel may reach beyond it
                parts.append((begin - _BETWEEN, end + _BETWEEN, at - _BETWEEN, everywhere))
            at += end - begin + _BETWEEN
        # The time axis without the numbers beside the lowest panel, and the numbers below it.
        line = last - _LINE, last + _BETWEEN, at - _BETWEEN - _LINE, slice(self._left, None)
        parts += [line, (last + _BETWEEN, last + _BELOW, at, everywhere)]
        picture = np.full((at - _BETWEEN + _BELOW, pixels.shape[1], 3), 255, np.uint8)
        for begin, end, start, columns in parts:
            target = picture[start : start + end - begin, columns]
            np.minimum(target, pixels[begin:end, columns], out=target)
        return picture


_kept, _lock = cache(_Drawing), Lock()


def result_files(
    result: Result, formats: Collection[str], dpi: int | None = None
) -> dict[str, Callable[[Path], None]]:
    """The figures of a result, as `figure_files` gives them; PNGs of the usual `dpi` from here."""

    @cache
    def pictures() -> dict[str, Picture]:
        check_letters(result.name)
        with _lock:
            return _kept().pictures(result)

    def write(kind: str, path: Path) -> None:
        encoded = BytesIO()
        Image.fromarray(pictures()[kind]).save(encoded, "png", dpi=(DPI, DPI), **PNG_OPTIONS)
        path.write_bytes(encoded.getvalue())

    figures = {kind: partial(result.plot, kind) for kind in _KINDS}
    files = figure_files(figures, formats, dpi or DPI)
    if "png" in formats and dpi in (None, DPI):
        files |= {f"{kind}.png": partial(write, kind) for kind in _KINDS}
    return files
