"""Images side by side: a model's layers at several frames, and its kernels."""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.frame import FloatImage
from dlgmd_cli.plots import style
from dlgmd_cli.plots.heat import INPUT_SCALE, Scale, add_bar, strongest
from dlgmd_cli.plots.style import GREY, LIGHT_GREY, Figure, house_style, new_figure, plain, width_in
from dlgmd_cli.results.sheet import LayerSheet

_WIDTH_IN = width_in("two")
# Inches: greatest and least legible width of a tile, least height of a row, width of names and
# colour bars beside the tiles; then heights of a block's titles, of the figure's title, of a page.
_MAX_TILE_IN, _LEGIBLE_IN, _MIN_ROW_IN, _BESIDE_IN = 1.9, 0.95, 0.5, 1.25
_TITLES_IN, _ABOVE_IN, _PAGE_IN = 0.35, 0.3, 9.4
_MAX_BLOCKS = 4
# Gap between tiles, as a share of their width.
_GAP = 0.06
_KERNEL_ROW_IN = 1.6
# A kernel's least value is stated only if it is at least this share of the greatest value.
_NEGLIGIBLE = 1e-3

Kernel = npt.NDArray[np.float64]


def plot_layers(sheet: LayerSheet) -> Figure:
    """Draw input, P, S and G: a row each with its colour bar, a column per frame: Figs. 8 and 17.

    Many frames are arranged in several blocks of four rows. All tiles of a layer share one scale,
    from 0 to the greatest value; with negative values it is symmetric about 0. If a layer has more
    cells than its tile has pixels, a pixel shows the strongest of its cells, so that single active
    cells stay visible. The input is averaged.

    Up to 12 frames are readable at the width of two columns. Figures of few frames are narrower.
    """
    n_frames, height, width_px = sheet.luminance.shape
    n_blocks, n_columns, tile = _arranged(n_frames, height / width_px)
    rows = {"Input": sheet.luminance, "P": sheet.p, "S": sheet.s, "G": sheet.g}
    units = ("luminance", *sheet.units)
    with house_style():
        figure = new_figure(1.0, "two")
        # At least 0.7 in, which the titles of narrow tiles need.
        wide_in = min(_WIDTH_IN, n_columns * max(tile, 0.7) + _BESIDE_IN)
        row_in = max(_MIN_ROW_IN, tile * height / width_px)
        figure.set_size_inches(wide_in, _height_in(n_blocks, row_in))
        grid: list[Axes] = [*figure.subplots(4 * n_blocks)]
        for block in range(n_blocks):
            part = slice(block * n_columns, (block + 1) * n_columns)
            axes_of = grid[4 * block : 4 * block + 4]
            for axes, (name, images), unit in zip(axes_of, rows.items(), units, strict=True):
                scale = INPUT_SCALE if name == "Input" else Scale.of(images)
                _draw_row(axes, images[part], scale, n_columns)
                axes.set_ylabel(name, rotation=0, ha="right", va="center")
                _add_bar(figure, axes, scale, unit)
            _write_titles(axes_of[0], sheet, part, n_columns)
        figure.suptitle(plain(sheet.label, 30 if n_frames < 3 else 80), color=GREY, fontsize=7)
        # The tiles' aspect changes the layout, which is thus computed twice; the left has a margin.
        left = 0.08 / figure.get_figwidth()
        figure.set_layout_engine("constrained", rect=(left, 0, 1 - left, 1))
        figure.draw_without_rendering()
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # keep the computed positions
        layers = [axes for place, axes in enumerate(grid) if place % 4]
        for picture in (picture for axes in layers for picture in axes.get_images()):
            box, image = picture.get_window_extent(), np.asarray(picture.get_array())
            picture.set_data(strongest(image, max(1, int(box.height)), max(1, int(box.width))))
    return figure


def _arranged(n_frames: int, aspect: float) -> tuple[int, int, float]:
    """Number of blocks, columns per block, and width of a tile in inches; `aspect` is height/width.

    The result has the fewest blocks with legible tiles; if no tiles are legible, the largest tiles.
    """
    arranged: list[tuple[int, int, float]] = []
    for n_blocks in range(1, min(_MAX_BLOCKS, n_frames) + 1):
        n_columns = -(-n_frames // n_blocks)
        tile = min(_MAX_TILE_IN, (_WIDTH_IN - _BESIDE_IN) / n_columns, _MAX_TILE_IN / aspect)
        room_in = (_PAGE_IN - _height_in(n_blocks, 0.0)) / (4 * n_blocks)
        tile = min(tile, room_in / aspect) if n_blocks > 1 else tile
        arranged.append((n_blocks, n_columns, tile))
        if tile >= _LEGIBLE_IN:
            return arranged[-1]
    return max(arranged, key=lambda blocks: blocks[2])


def _height_in(n_blocks: int, row_in: float) -> float:
    return n_blocks * (4 * (row_in + 0.06) + _TITLES_IN) + _ABOVE_IN


def _draw_row(axes: Axes, images: FloatImage, scale: Scale | None, n_columns: int) -> None:
    """Draw the layers of some frames side by side; a grey box if one is undefined."""
    _, height, width = images.shape
    for place, image in enumerate(images):
        left = place * width * (1 + _GAP)
        if scale is None or np.isnan(image).any():
            axes.add_patch(Rectangle((left, 0), width, height, color=LIGHT_GREY, linewidth=0))
            style.write_centred(axes, left + width / 2, height / 2, "undefined", fontsize=6.5)
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
    right = n_columns * width * (1 + _GAP) - width * _GAP
    axes.set(xlim=(0, right), ylim=(height, 0), xticks=[], yticks=[])
    axes.set_aspect("equal", anchor="E")
    axes.spines[:].set_visible(False)


def _write_titles(axes: Axes, sheet: LayerSheet, part: slice, n_columns: int) -> None:
    texts = [
        f"frame {frame}\n{time_s:.3f} s"
        for frame, time_s in zip(sheet.frame[part], sheet.time_s[part], strict=True)
    ]
    middles = (np.arange(len(texts)) * (1 + _GAP) + 0.5) * sheet.luminance.shape[2]
    axes.set_xticks(middles, texts, fontsize=7 if n_columns <= 8 else 6)
    axes.tick_params(top=False, bottom=False, labeltop=True, labelbottom=False, pad=1)


def _add_bar(figure: Figure, axes: Axes, scale: Scale | None, unit: str) -> None:
    """Add the colour bar to the right of a row; if all values are 0, a text says so."""
    ticks = MaxNLocator(4, steps=[1, 2, 5, 10])
    bar = add_bar(figure, axes, scale, unit, ticks=ticks, fraction=0.05, pad=0.01, aspect=9)
    bar.ax.yaxis.labelpad = 2
    bar.ax.yaxis.label.set_fontsize(7)
    bar.ax.tick_params(pad=1.5, length=2, labelsize=6.5)
    bar.outline.set_linewidth(0.4)  # type: ignore[operator]
    if scale is not None and scale.is_flat:
        axes.text(
            1.01,
            0.5,
            f"0 {unit}\neverywhere",
            va="center",
            rotation=90,
            fontsize=6.5,
            parse_math=False,
            in_layout=False,
            transform=axes.transAxes,
        )


def plot_kernels(
    label: str, excitation: Kernel, inhibition: dict[int, Kernel], latency: Kernel
) -> Figure:
    """Draw excitation, inhibition at each delay, and latency, one panel each, as in Fig. 5.

    All strengths share one scale from 0 and can be compared. The title of a panel states the range
    of the kernel's values. A latency that is the same everywhere is stated in the figure's title
    and has no panel. Kernels have the shape (2r + 1, 2r + 1).

    Parameters
    ----------
    label : str
        The model's name, for the title.
    excitation : ndarray
        K_E, strength per unit of luminance change.
    inhibition : dict of int to ndarray
        K_d by delay in frames; at least one.
    latency : ndarray
        τ in frames.
    """
    strengths = {"Excitation $K_E$": excitation}
    for delay in sorted(inhibition):
        strengths[f"Inhibition $K_{{{delay}}}$"] = inhibition[delay]
    greatest = max(float(kernel.max()) for kernel in strengths.values())
    is_constant = _is_constant(latency)
    n_panels = len(strengths) + (not is_constant)
    n_rows = -(-n_panels // 2)
    with house_style():
        figure = new_figure(n_rows * _KERNEL_ROW_IN + 0.3)
        grid = figure.subplots(n_rows, 2, sharex=True, sharey=True, squeeze=False)
        panels: list[Axes] = list(grid.flat)
        for axes, (what, kernel) in zip(panels, strengths.items(), strict=False):
            # Taps of exactly 0 stay grey; small taps are coloured.
            connected = np.ma.masked_equal(kernel, 0.0)
            picture = _draw_kernel(axes, what, connected, "viridis", greatest)
        bars = [(picture, panels[1], "strength (grey: none)")]
        title = plain(label)
        if is_constant:
            title += rf" · latency $\tau$: {latency.max():.3g} frames everywhere"
        else:
            axes, what = panels[n_panels - 1], r"Latency $\tau$ (frames)"
            picture = _draw_kernel(axes, what, latency, "cividis", float(latency.max()))
            bars.append((picture, axes, "frames"))
        figure.suptitle(title.replace(" 1 frames", " 1 frame"), fontsize=7, color=GREY)
        for place, (picture, axes, meaning) in enumerate(bars):
            ticks = MaxNLocator(4, steps=[1, 2, 5, 10])
            if n_panels == len(panels):
                bar = figure.colorbar(picture, ax=axes, pad=0.02, ticks=ticks)
            else:  # an empty cell of the grid has room for both colour bars
                panels[-1].set_axis_off()
                cell = panels[-1].inset_axes((0.05, 0.75 - 0.45 * place, 0.9, 0.08))
                bar = figure.colorbar(picture, cax=cell, orientation="horizontal", ticks=ticks)
            bar.set_label(meaning, color=GREY, labelpad=1, fontsize=7)
            bar.ax.tick_params(pad=1.5, length=2)
            bar.outline.set_linewidth(0.4)  # type: ignore[operator]
        for axes in grid[:, 0]:
            axes.set_ylabel("y (px)")
        for axes in panels[n_panels - 2 : n_panels]:
            axes.set_xlabel("x (px)")
            axes.tick_params(labelbottom=True)
    return figure


def _draw_kernel(axes: Axes, title: str, kernel: Kernel, colors: str, greatest: float) -> AxesImage:
    radius, edge = kernel.shape[0] // 2, kernel.shape[0] / 2
    ticks = [-radius, 0, radius]
    axes.set(facecolor=LIGHT_GREY, xticks=ticks, yticks=ticks)
    axes.spines[:].set_visible(True)
    axes.set_title(title, pad=12)
    axes.text(
        0.5, 1.03, _values(kernel), ha="center", color=GREY, fontsize=6.5, transform=axes.transAxes
    )
    extent = (-edge, edge, edge, -edge)
    return axes.imshow(
        kernel, extent=extent, cmap=colors, vmin=0.0, vmax=greatest or 1.0, interpolation="nearest"
    )


def _is_constant(kernel: Kernel) -> bool:
    return bool(np.isclose(kernel.min(), kernel.max(), rtol=1e-9, atol=0.0))


def _values(kernel: Kernel) -> str:
    """The range of a kernel's values, in words."""
    if np.ma.count(kernel) == 0:
        return "no connections"
    if _is_constant(kernel):
        return f"only {kernel.max():.3g}"
    if kernel.min() < _NEGLIGIBLE * kernel.max():
        return f"up to {kernel.max():.2g}"
    return f"{kernel.min():.2g} to {kernel.max():.2g}"
