"""The model's connections as heat maps, like the paper's Fig. 5."""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dlgmd_cli.plots.style import COLUMN_WIDTH_IN, GREY, house_style

Kernel = npt.NDArray[np.float64]


def plot_kernels(excitation: Kernel, inhibition: dict[int, Kernel], latency: Kernel) -> Figure:
    """Excitation, inhibition at each delay, and latency, one panel each.

    Parameters
    ----------
    excitation : ndarray, shape (2r + 1, 2r + 1)
        K_E, strength per unit of luminance change.
    inhibition : dict of int to ndarray
        Delay in frames -> K_d, of the same shape.
    latency : ndarray, same shape
        τ in frames.
    """
    panels = [("Excitation $K_E$", excitation, "viridis", "strength")]
    panels += [
        (f"Inhibition $K_{{{delay}}}$", kernel, "viridis", "strength")
        for delay, kernel in sorted(inhibition.items())
    ]
    panels.append((r"Latency $\tau$", latency, "cividis", "frames"))
    columns = 2
    rows = -(-len(panels) // columns)
    with house_style():
        figure = Figure(figsize=(COLUMN_WIDTH_IN, 1.45 * rows + 0.1), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False)
        for axes, panel in zip(grid.flat, panels, strict=False):
            _draw(figure, axes, *panel)
        for axes in grid.flat[len(panels) :]:
            axes.set_visible(False)
        for axes in grid[:, 0]:
            axes.set_ylabel("y (px)")
        for column in range(columns):
            shown = [axes for axes in grid[:, column] if axes.get_visible()]
            shown[-1].set_xlabel("x (px)")
    return figure


def _draw(figure: Figure, axes: Axes, title: str, kernel: Kernel, colors: str, unit: str) -> None:
    """One kernel; taps that are exactly zero are left grey, apart from small ones."""
    radius = kernel.shape[0] // 2
    edge = radius + 0.5
    axes.set_facecolor("#DDDDDD")
    picture = axes.imshow(
        np.ma.masked_equal(kernel, 0.0),
        extent=(-edge, edge, edge, -edge),
        cmap=colors,
        interpolation="nearest",
    )
    ticks = [-radius, 0, radius]
    axes.set_xticks(ticks)
    axes.set_yticks(ticks)
    axes.spines["right"].set_visible(True)
    axes.set_title(title, fontsize=8)
    bar = figure.colorbar(picture, ax=axes, shrink=0.9)
    bar.set_label(unit, color=GREY)
    bar.outline.set_linewidth(0.4)  # type: ignore[operator]
