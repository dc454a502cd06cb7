"""A model's layers at several frames as a contact sheet, like the paper's Figs. 8 and 17."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.heat import INPUT_SCALE, FloatImage, Scale, strongest
from dlgmd_cli.plots.style import (
    GREY,
    LIGHT_GREY,
    Width,
    house_style,
    new_figure,
    plain,
    shortened,
    width_in,
)
from dlgmd_cli.results.layers import LayerSheet

# In inches: a tile at most, and beside the tiles the names, the colour bars and the titles.
_MAX_TILE_IN, _MIN_ROW_IN, _BESIDE_IN, _ABOVE_IN = 1.9, 0.62, 1.1, 0.45


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
    n_frames, n_rows, n_columns = sheet.luminance.shape
    tile = min(_MAX_TILE_IN, (width_in(width) - _BESIDE_IN) / n_frames)
    tile = min(tile, _MAX_TILE_IN * n_columns / n_rows)
    row_in = max(_MIN_ROW_IN, tile * n_rows / n_columns)
    names = ("Input", "P", "S", "G")
    rows = zip(
        names, (sheet.luminance, sheet.p, sheet.s, sheet.g), ("luminance", *sheet.units),
        strict=True,
    )  # fmt: skip
    with house_style():
        figure = new_figure(4 * row_in + _ABOVE_IN, width)
        # Titles of narrow tiles need room, too.
        figure.set_figwidth(min(width_in(width), n_frames * max(tile, 0.7) + _BESIDE_IN))
        grid: Any = figure.subplots(4, n_frames, squeeze=False)
        _write_titles(figure, sheet, grid[0])
        drawn: list[tuple[AxesImage, FloatImage]] = []
        for axes_of_row, (name, images, unit) in zip(grid, rows, strict=True):
            axes_of_row[0].set_ylabel(name, rotation=0, ha="right", va="center")
            scale = INPUT_SCALE if name == "Input" else Scale.of(images)
            tiles = [
                _draw_tile(axes, image, scale)
                for axes, image in zip(axes_of_row, images, strict=True)
            ]
            shown = [tile for tile in tiles if tile is not None]
            if shown and scale is not None:
                _add_bar(figure, shown[0], list(axes_of_row), scale, unit)
            if name != "Input":
                drawn += [(tile, image) for tile, image in zip(tiles, images, strict=True) if tile]
        if sheet.label:
            label = plain(shortened(sheet.label, 30 if n_frames < 3 else 80))
            figure.suptitle(label, color=GREY, fontsize=7)
        figure.draw_without_rendering()
        for picture, image in drawn:
            box = picture.axes.get_window_extent()
            picture.set_data(strongest(image, max(1, int(box.height)), max(1, int(box.width))))
    return figure


def _write_titles(figure: Figure, sheet: LayerSheet, axes_of_row: Any) -> None:
    """The number and the time of every frame over its column."""
    fontsize = 7 if len(sheet.frame) <= 8 else 6
    for axes, frame, time_s in zip(axes_of_row, sheet.frame, sheet.time_s, strict=True):
        axes.set_title(f"frame {frame}\n{time_s:.3f} s", fontsize=fontsize, pad=3)


def _draw_tile(axes: Axes, image: FloatImage, scale: Scale | None) -> AxesImage | None:
    """One layer of one frame; None if it is not defined."""
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set(visible=True, linewidth=0.3, color=GREY)
    height, width = image.shape
    if scale is None or np.isnan(image).any():
        axes.set_facecolor(LIGHT_GREY)
        axes.set_aspect(height / width)
        look: Any = {"ha": "center", "va": "center", "color": GREY, "fontsize": 6.5}
        axes.text(0.5, 0.5, "undefined", transform=axes.transAxes, **look)
        return None
    low, high = scale.limits
    way = "auto" if scale is INPUT_SCALE else "nearest"
    extent = (0.0, width, height, 0.0)
    return axes.imshow(
        image, cmap=scale.colours, vmin=low, vmax=high, interpolation=way, extent=extent
    )


def _add_bar(
    figure: Figure, picture: AxesImage, beside: list[Axes], scale: Scale, unit: str
) -> None:
    """The scale of a row, right of it; where all is 0, words say so."""
    ticks = MaxNLocator(4, steps=[1, 2, 5, 10])
    bar: Colorbar = figure.colorbar(
        picture, ax=beside, ticks=[] if scale.is_flat else ticks, fraction=0.05, pad=0.01, aspect=9
    )
    label = f"0 {unit}\neverywhere" if scale.is_flat else unit
    bar.set_label(label, labelpad=2, fontsize=7, parse_math=False)
    bar.ax.tick_params(pad=1.5, length=2, labelsize=6.5)
    bar.outline.set_linewidth(0.4)  # type: ignore[operator]
