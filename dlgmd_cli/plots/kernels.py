"""The model's connections as heat maps, like the paper's Fig. 5."""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.style import GREY, Box, add_axes, house_style, new_figure

Kernel = npt.NDArray[np.float64]

# Of the figure, in inches: a map's side, the room right of it and above it, and the outer margins.
_SIDE, _BESIDE, _TITLE, _LEFT, _BOTTOM = 1.16, 0.18, 0.4, 0.45, 0.36
_BAR_WIDTH = 0.08


def plot_kernels(excitation: Kernel, inhibition: dict[int, Kernel], latency: Kernel) -> Figure:
    """Excitation, inhibition at each delay, and latency, one panel each.

    All strengths share one scale from 0, so that they can be compared; under its title, every
    panel says between which values its connections lie.

    Parameters
    ----------
    excitation : ndarray, shape (2r + 1, 2r + 1)
        K_E, strength per unit of luminance change.
    inhibition : dict of int to ndarray
        Delay in frames -> K_d, of the same shape; at least one.
    latency : ndarray, same shape
        τ in frames.
    """
    strengths = {"Excitation $K_E$": excitation}
    for delay in sorted(inhibition):
        strengths[f"Inhibition $K_{{{delay}}}$"] = inhibition[delay]
    greatest = max(float(kernel.max()) for kernel in strengths.values())
    n_panels = len(strengths) + 1
    n_rows = -(-n_panels // 2)
    with house_style():
        figure = new_figure(_BOTTOM + n_rows * (_SIDE + _TITLE))
        for place, (title, kernel) in enumerate(strengths.items()):
            axes = add_axes(figure, _map_box(place, n_rows))
            # Taps that are exactly zero are left grey, apart from small ones.
            connected = np.ma.masked_equal(kernel, 0.0)
            picture = _draw(axes, title, connected, "viridis", greatest)
            _label_pixels(axes, kernel, place, n_panels)
        _add_bar(figure, picture, _map_box(1, n_rows), "strength (grey: none)")

        box = _map_box(n_panels - 1, n_rows)
        axes = add_axes(figure, box)
        picture = _draw(axes, r"Latency $\tau$ (frames)", latency, "cividis", float(latency.max()))
        _label_pixels(axes, latency, n_panels - 1, n_panels)
        if not _is_constant(latency):
            _add_bar(figure, picture, box, "")
    return figure


def _map_box(place: int, n_rows: int) -> Box:
    """Where the map stands that is number `place` from the upper left."""
    row, column = divmod(place, 2)
    x = _LEFT + column * (_SIDE + _BESIDE)
    y = _BOTTOM + (n_rows - 1 - row) * (_SIDE + _TITLE)
    return x, y, _SIDE, _SIDE


def _draw(axes: Axes, title: str, kernel: Kernel, colors: str, greatest: float) -> AxesImage:
    """One kernel, coloured from 0 to `greatest`."""
    edge = kernel.shape[0] / 2
    axes.set_facecolor("#DDDDDD")
    axes.spines["right"].set_visible(True)
    axes.set_title(title, fontsize=8, pad=11)
    axes.text(
        0.5, 1.03, _values(kernel), transform=axes.transAxes, ha="center", color=GREY, fontsize=6.5
    )
    return axes.imshow(
        kernel,
        extent=(-edge, edge, edge, -edge),
        cmap=colors,
        vmin=0.0,
        vmax=greatest or 1.0,
        interpolation="nearest",
    )


def _label_pixels(axes: Axes, kernel: Kernel, place: int, n_panels: int) -> None:
    """Name the pixels on the left of every row and at the foot of both columns."""
    radius = kernel.shape[0] // 2
    ticks = [-radius, 0, radius]
    leftmost, lowest = place % 2 == 0, place >= n_panels - 2
    axes.set_xticks(ticks, None if lowest else [""] * 3)
    axes.set_yticks(ticks, None if leftmost else [""] * 3)
    if leftmost:
        axes.set_ylabel("y (px)", labelpad=1)
    if lowest:
        axes.set_xlabel("x (px)", labelpad=1)


def _add_bar(figure: Figure, picture: AxesImage, beside: Box, label: str) -> None:
    """The scale of `picture`, right of the map at `beside`."""
    x, y, width, height = beside
    axes = add_axes(figure, (x + width + _BAR_WIDTH, y, _BAR_WIDTH, height))
    bar = figure.colorbar(picture, cax=axes, ticks=MaxNLocator(4, steps=[1, 2, 5, 10]))
    bar.set_label(label, color=GREY, labelpad=1, fontsize=7)
    bar.ax.tick_params(pad=1.5, length=2)
    bar.outline.set_linewidth(0.4)  # type: ignore[operator]


def _is_constant(kernel: Kernel) -> bool:
    return bool(np.isclose(kernel.min(), kernel.max(), rtol=1e-9, atol=0.0))


def _values(kernel: Kernel) -> str:
    """Between which values the connections lie."""
    if np.ma.count(kernel) == 0:
        return "no connections"
    if _is_constant(kernel):
        return f"only {kernel.max():.3g}"
    return f"{kernel.min():.2g} to {kernel.max():.2g}"
