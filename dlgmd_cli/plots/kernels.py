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
    values is written below the title of its panel. A latency that is the same everywhere is written
    there, too, and has no panel. Kernels have the shape (2r + 1, 2r + 1).

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
    is_constant = _is_constant(latency)
    n_panels = len(strengths) + (not is_constant)
    n_rows = -(-n_panels // 2)
    with house_style():
        figure = new_figure(n_rows * _ROW_IN + 0.3)
        grid: Any = figure.subplots(n_rows, 2, sharex=True, sharey=True, squeeze=False)
        panels: list[Axes] = list(grid.flat)
        for axes, (title, kernel) in zip(panels, strengths.items(), strict=False):
            # Taps of exactly 0 stay grey, unlike small ones.
            connected = np.ma.masked_equal(kernel, 0.0)
            picture = _draw(axes, title, connected, "viridis", greatest)
        bars = [(picture, panels[1], "strength (grey: none)")]
        if is_constant:
            words = rf"Latency $\tau$: {latency.max():.3g} frames everywhere"
            figure.suptitle(words.replace(" 1 frames", " 1 frame"), fontsize=7, color=GREY)
        else:
            axes, title = panels[n_panels - 1], r"Latency $\tau$ (frames)"
            picture = _draw(axes, title, latency, "cividis", float(latency.max()))
            bars.append((picture, axes, "frames"))
        for place, (picture, axes, label) in enumerate(bars):
            look: Any = {"ticks": MaxNLocator(4, steps=[1, 2, 5, 10])}
            if n_panels == len(panels):
                bar = figure.colorbar(picture, ax=axes, pad=0.02, **look)
            else:  # a cell is free, where both lie
                panels[-1].set_axis_off()
                cell = panels[-1].inset_axes((0.05, 0.75 - 0.45 * place, 0.9, 0.08))
                bar = figure.colorbar(picture, cax=cell, orientation="horizontal", **look)
            bar.set_label(label, color=GREY, labelpad=1, fontsize=7)
            bar.ax.tick_params(pad=1.5, length=2)
            bar.outline.set_linewidth(0.4)  # type: ignore[operator]
        for axes in grid[:, 0]:
            axes.set_ylabel("y (px)")
        for axes in panels[n_panels - 2 : n_panels]:
            axes.set_xlabel("x (px)")
            axes.tick_params(labelbottom=True)
    return figure


def _draw(axes: Axes, title: str, kernel: Kernel, colors: str, greatest: float) -> AxesImage:
    radius, edge = kernel.shape[0] // 2, kernel.shape[0] / 2
    ticks = [-radius, 0, radius]
    axes.set(facecolor=LIGHT_GREY, xticks=ticks, yticks=ticks)
    axes.spines["right"].set_visible(True)
    axes.set_title(title, pad=12)
    look: Any = {"transform": axes.transAxes, "ha": "center", "color": GREY, "fontsize": 6.5}
    axes.text(0.5, 1.03, _values(kernel), **look)

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
