"""A model's layers at several frames as a contact sheet, like the paper's Figs. 8 and 17."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.heat import INPUT_SCALE, FloatImage, Scale, add_bar, strongest
from dlgmd_cli.plots.style import (
    GREY,
    LIGHT_GREY,
    Figure,
    house_style,
    new_figure,
    plain,
    width_in,
)
from dlgmd_cli.results.layers import LayerSheet

_WIDTH_IN = width_in("two")
# In inches: a tile at most, and beside the tiles the names, the colour bars and the titles.
_MAX_TILE_IN, _MIN_ROW_IN, _BESIDE_IN, _ABOVE_IN = 1.9, 0.62, 1.25, 0.65
# Between tiles, as a share of their width.
_GAP = 0.06


def plot_layers(sheet: LayerSheet) -> Figure:
    """Input, P, S and G: one row each with its colour bar, one column per frame.

    All tiles of a row share one scale, from 0 to the greatest value in the row; where values have
    signs, it is symmetric about 0. Where a layer has more cells than its tile has pixels, a pixel
    shows the strongest of its cells, so that single active cells are not lost; the input is
    averaged instead.

    Up to 12 frames are readable at the width of two columns; few make the figure narrower.
    """
    n_frames, height, width_px = sheet.luminance.shape
    tile = min(_MAX_TILE_IN, (_WIDTH_IN - _BESIDE_IN) / n_frames)
    tile = min(tile, _MAX_TILE_IN * width_px / height)
    row_in = max(_MIN_ROW_IN, tile * height / width_px)
    rows = {"Input": sheet.luminance, "P": sheet.p, "S": sheet.s, "G": sheet.g}
    units = ("luminance", *sheet.units)
    with house_style():
        figure = new_figure(4 * (row_in + 0.06) + _ABOVE_IN, "two")
        # Titles of narrow tiles need room, too.
        figure.set_figwidth(min(_WIDTH_IN, n_frames * max(tile, 0.7) + _BESIDE_IN))
        grid: Any = figure.subplots(4)
        for axes, (name, images), unit in zip(grid, rows.items(), units, strict=True):
            scale = INPUT_SCALE if name == "Input" else Scale.of(images)
            _draw_row(axes, images, scale)
            axes.set_ylabel(name, rotation=0, ha="right", va="center")
            _add_bar(figure, axes, scale, unit)
        _write_titles(grid[0], sheet)
        label = plain(sheet.label, 30 if n_frames < 3 else 80)
        figure.suptitle(label, color=GREY, fontsize=7)
        # The tiles' proportions move what the layout was made for: it is made twice, and leaves
        # some room on the left.
        left = 0.08 / figure.get_figwidth()
        layout: Any = figure.get_layout_engine()
        layout.set(rect=(left, 0, 1 - left, 1))
        figure.draw_without_rendering()
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # everything stays where it is
        for picture in (picture for axes in grid[1:] for picture in axes.get_images()):
            box, image = picture.get_window_extent(), np.asarray(picture.get_array())
            picture.set_data(strongest(image, max(1, int(box.height)), max(1, int(box.width))))
    return figure


def _draw_row(axes: Axes, images: FloatImage, scale: Scale | None) -> None:
    """The layers of all frames side by side; a grey box where one is not defined."""
    n_frames, height, width = images.shape
    for place, image in enumerate(images):
        left = place * width * (1 + _GAP)
        if scale is None or np.isnan(image).any():
            axes.add_patch(Rectangle((left, 0), width, height, color=LIGHT_GREY, linewidth=0))
            look: Any = {"ha": "center", "va": "center", "color": GREY, "fontsize": 6.5}
            axes.text(left + width / 2, height / 2, "undefined", **look)
            continue
        low, high = scale.limits
        axes.imshow(
            image,
            cmap=scale.colours,
            vmin=low,
            vmax=high,
            interpolation="auto" if scale is INPUT_SCALE else "nearest",
            extent=(left, left + width, height, 0),
        )
    axes.set_xlim(0, n_frames * width * (1 + _GAP) - width * _GAP)
    axes.set_ylim(height, 0)
    axes.set_aspect("equal", anchor="E")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)


def _write_titles(axes: Axes, sheet: LayerSheet) -> None:
    """The number and the time of every frame over its column."""
    n_frames, _, width = sheet.luminance.shape
    texts = [
        f"frame {frame}\n{time_s:.3f} s"
        for frame, time_s in zip(sheet.frame, sheet.time_s, strict=True)
    ]
    middles = (np.arange(n_frames) * (1 + _GAP) + 0.5) * width
    axes.set_xticks(middles, texts, fontsize=7 if n_frames <= 8 else 6)
    axes.tick_params(top=False, bottom=False, labeltop=True, labelbottom=False, pad=1)


def _add_bar(figure: Figure, axes: Axes, scale: Scale | None, unit: str) -> None:
    """The scale of a row, right of it; where all is 0, words say so."""
    ticks = MaxNLocator(4, steps=[1, 2, 5, 10])
    bar = add_bar(figure, axes, scale, unit, ticks=ticks, fraction=0.05, pad=0.01, aspect=9)
    bar.ax.yaxis.labelpad = 2
    bar.ax.yaxis.label.set_fontsize(7)
    bar.ax.tick_params(pad=1.5, length=2, labelsize=6.5)
    bar.outline.set_linewidth(0.4)  # type: ignore[operator]
    if scale is not None and scale.is_flat:
        look: Any = {"transform": axes.transAxes, "va": "center", "rotation": 90, "fontsize": 6.5}
        axes.text(1.01, 0.5, f"0 {unit}\neverywhere", parse_math=False, in_layout=False, **look)
