"""Heat maps of the model's kernels, as in the paper's Fig. 5."""

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.style import GREY, LIGHT_GREY, Figure, house_style, new_figure

Kernel = npt.NDArray[np.float64]

_ROW_IN = 1.6
# If a kernel's least value is below this share of its greatest, only the greatest is stated.
_NEGLIGIBLE = 1e-3


def plot_kernels(excitation: Kernel, inhibition: dict[int, Kernel], latency: Kernel) -> Figure:
    """Draw excitation, inhibition at each delay, and latency, one panel each.

    All strengths share one scale from 0, so that they can be compared. The range of a kernel's
    values is written below the title of its panel. Kernels have the shape (2r + 1, 2r + 1).

    Parameters
    ----------
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
    n_rows = -(-(len(strengths) + 1) // 2)
    with house_style():
        figure = new_figure(n_rows * _ROW_IN + 0.3)
        grid: Any = figure.subplots(n_rows, 2, sharex=True, sharey=True)
        panels: list[Axes] = list(grid.flat)
        for axes, (title, kernel) in zip(panels, strengths.items(), strict=False):
            # Taps of exactly 0 stay grey, unlike small ones.
            connected = np.ma.masked_equal(kernel, 0.0)
            picture = _draw(axes, title, connected, "viridis", greatest)
        _add_bar(figure, picture, panels[1], "strength (grey: none)")
        axes = panels[len(strengths)]
        picture = _draw(axes, r"Latency $\tau$ (frames)", latency, "cividis", float(latency.max()))
        if not _is_constant(latency):
            _add_bar(figure, picture, axes, "frames")
        for unused in panels[len(strengths) + 1 :]:
            unused.set_axis_off()
        for axes in grid[:, 0]:
            axes.set_ylabel("y (px)")
        for axes in panels[len(strengths) - 1 : len(strengths) + 1]:
            axes.set_xlabel("x (px)")
            axes.tick_params(labelbottom=True)
    return figure


def _draw(axes: Axes, title: str, kernel: Kernel, colors: str, greatest: float) -> AxesImage:
    radius, edge = kernel.shape[0] // 2, kernel.shape[0] / 2
    axes.set_facecolor(LIGHT_GREY)
    axes.spines["right"].set_visible(True)
    axes.set_title(title, pad=12)
    look: Any = {"transform": axes.transAxes, "ha": "center", "color": GREY, "fontsize": 6.5}
    axes.text(0.5, 1.03, _values(kernel), **look)
    axes.set_xticks([-radius, 0, radius])
    axes.set_yticks([-radius, 0, radius])
    extent = (-edge, edge, edge, -edge)
    return axes.imshow(
        kernel, extent=extent, cmap=colors, vmin=0.0, vmax=greatest or 1.0, interpolation="nearest"
    )


def _add_bar(figure: Figure, picture: AxesImage, beside: Axes, label: str) -> None:
    """Add the colour bar of `picture`, right of its map."""
    bar = figure.colorbar(picture, ax=beside, ticks=MaxNLocator(4, steps=[1, 2, 5, 10]), pad=0.02)
    bar.set_label(label, color=GREY, labelpad=1, fontsize=7)
    bar.ax.tick_params(pad=1.5, length=2)
    bar.outline.set_linewidth(0.4)  # type: ignore[operator]


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
