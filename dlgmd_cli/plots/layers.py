"""A model's layers at several frames as a contact sheet, like the paper's Figs. 8 and 17."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.heat import FloatImage, Scale, strongest
from dlgmd_cli.plots.style import DPI, GREY, Width, add_axes, figure_width_in, house_style
from dlgmd_cli.plots.text import shortened
from dlgmd_cli.results.layers import LayerSheet

# Of the sheet, in inches: the names left of the tiles, the room right of them, and the gaps.
_NAMES, _BESIDE, _GAP, _EDGE = 0.42, 0.62, 0.05, 0.04
_BAR_GAP, _BAR_WIDTH = 0.05, 0.08
_TITLE, _LABEL = 0.3, 0.16
_MAX_TILE = 1.9
# A tick label, or a unit on its side, needs that much height.
_MIN_ROW = 0.62
# How wide a character of a title is.
_CHARACTER = 0.062
_UNDEFINED = "#DDDDDD"


def plot_layers(sheet: LayerSheet, width: Width = "two") -> Figure:
    """Input, P, S and G, a row each, with a column a frame and a colour bar a row.

    All tiles of a row share one scale, from 0 to the greatest value in the row; where values have
    signs, it is symmetric about 0. Where a layer has more cells than its tile has pixels, a pixel
    shows the strongest of its cells, so that single active cells are not lost; the input is
    averaged instead.

    Parameters
    ----------
    sheet : LayerSheet
        At least one frame; up to 12 are readable at the width of two columns, up to 5 at that of
        one.
    width : "two" or "one"
        How many columns of a paper the figure may be wide; few frames make it narrower.

    Returns
    -------
    Figure
        At the resolution at which tiles have the pixels that cells were chosen for.
    """
    n_frames, *shape = sheet.luminance.shape
    cell_width, tile_wh = _tile_size(n_frames, (shape[0], shape[1]), figure_width_in(width))
    row_height = max(tile_wh[1], _MIN_ROW)
    above = _TITLE + (_LABEL if sheet.label else 0.0)
    content = _NAMES + n_frames * (cell_width + _GAP) + _BESIDE
    size = content, above + 4 * (row_height + _GAP) + _EDGE
    rows = (
        ("Input", sheet.luminance, "luminance"),
        ("P", sheet.p, sheet.units[0]),
        ("S", sheet.s, sheet.units[1]),
        ("G", sheet.g, sheet.units[2]),
    )
    with house_style():
        figure = Figure(figsize=size, dpi=DPI)
        top = size[1] - above
        _write_titles(figure, sheet, cell_width, top)
        for number, (name, images, unit) in enumerate(rows):
            bottom = top - (number + 1) * row_height - number * _GAP
            middle = bottom + row_height / 2
            _text(figure, _EDGE, middle, name, va="center", fontsize=8)
            scale = Scale(0.0, 1.0, "gray") if name == "Input" else Scale.of(images)
            picture = None
            for column, image in enumerate(images):
                x = _NAMES + column * (cell_width + _GAP) + (cell_width - tile_wh[0]) / 2
                box = (x, middle - tile_wh[1] / 2, *tile_wh)
                picture = _draw_tile(add_axes(figure, box), image, scale, tile_wh) or picture
            x = content - _BESIDE + _BAR_GAP - _GAP
            if picture is not None and scale is not None:
                box = (x, bottom + 0.06, _BAR_WIDTH, row_height - 0.12)
                _add_bar(figure, picture, box, scale, unit)
        if sheet.label:
            label = shortened(sheet.label, content - _NAMES, 7)
            _text(figure, _NAMES, size[1] - 0.03, label, va="top", color=GREY, fontsize=7)
    return figure


def _tile_size(
    n_frames: int, shape: tuple[int, int], width_in: float
) -> tuple[float, tuple[float, float]]:
    """Width of a column, and width and height of a tile in it, in inches."""
    height, width = shape
    room = (width_in - _NAMES - _BESIDE) / n_frames - _GAP
    cell_width = min(room, _MAX_TILE)
    scale = min(cell_width / width, _MAX_TILE / height)
    # A line of pixels at least, of very long frames.
    tile = max(width * scale, 1 / DPI), max(height * scale, 1 / DPI)
    # Narrow tiles stand closer, as far as their titles allow.
    return min(cell_width, max(tile[0], 11 * _CHARACTER)), tile


def _write_titles(figure: Figure, sheet: LayerSheet, cell_width: float, top: float) -> None:
    """The number and the time of every frame over its column, with words as far as they fit."""
    numbers = [f"{frame}" for frame in sheet.frame]
    times = [f"{time_s:.3f}" for time_s in sheet.time_s]
    longest = max(max(map(len, numbers)) + len("frame "), max(map(len, times)) + len(" s"))
    fits = longest * _CHARACTER <= cell_width + _GAP
    if fits:
        numbers = [f"frame {number}" for number in numbers]
        times = [f"{time_s} s" for time_s in times]
    else:
        _text(figure, _EDGE, top + 0.17, "frame", fontsize=7)
        _text(figure, _EDGE, top + 0.05, "time (s)", fontsize=7)
    widest = _CHARACTER * (max(map(len, numbers + times)) + 1)
    fontsize = min(7.0, 7.0 * (cell_width + _GAP) / widest)
    for column, lines in enumerate(zip(numbers, times, strict=True)):
        x = _NAMES + column * (cell_width + _GAP) + cell_width / 2
        for line, y in zip(lines, (0.17, 0.05), strict=True):
            _text(figure, x, top + y, line, ha="center", fontsize=fontsize)


def _draw_tile(
    axes: Axes, image: FloatImage, scale: Scale | None, tile_wh: tuple[float, float]
) -> AxesImage | None:
    """One layer of one frame; None if it is not defined."""
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_linewidth(0.3)
        spine.set_color(GREY)
    if scale is None or np.isnan(image).any():
        axes.set_facecolor(_UNDEFINED)
        axes.text(
            *(0.5, 0.5, "undefined"),
            transform=axes.transAxes,
            ha="center",
            va="center",
            color=GREY,
            fontsize=6.5,
            bbox={"facecolor": _UNDEFINED, "edgecolor": "none", "pad": 1},
        )
        return None
    is_input = scale.colours == "gray"
    # No more cells than pixels: then drawing each as a block leaves out none. Matplotlib would
    # average the others away, or pick some.
    width_px, height_px = (max(1, int(side * DPI)) for side in tile_wh)
    shown = image if is_input else strongest(image, height_px, width_px)
    fits = shown.shape[0] <= height_px and shown.shape[1] <= width_px
    low, high = scale.limits
    return axes.imshow(
        shown,
        cmap=scale.colours,
        vmin=low,
        vmax=high,
        aspect="auto",
        interpolation="nearest" if fits else "auto",
    )


def _add_bar(
    figure: Figure,
    picture: AxesImage,
    box: tuple[float, float, float, float],
    scale: Scale,
    unit: str,
) -> None:
    """The scale of a row, right of it; where all is 0 there is none, and words say so."""
    x, y, _, height = box
    if scale.is_flat:
        _text(figure, x, y + height / 2, f"0 {unit}\neverywhere", va="center", fontsize=6.5)
        return
    axes = add_axes(figure, box)
    bar = figure.colorbar(picture, cax=axes, ticks=MaxNLocator(4, steps=[1, 2, 5, 10]))
    bar.set_label(unit, labelpad=2, fontsize=7, parse_math=False)
    bar.ax.tick_params(pad=1.5, length=2, labelsize=6.5)
    bar.outline.set_linewidth(0.4)  # type: ignore[operator]


def _text(figure: Figure, x_in: float, y_in: float, text: str, **look: Any) -> None:
    """Plain text at a place in inches; a $ is no mathematics."""
    width, height = figure.get_size_inches()
    figure.text(x_in / width, y_in / height, text, parse_math=False, **look)
