"""How every figure looks: readable in a two-column paper, and without colour vision."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's palette, told apart by all common kinds of colour vision.
BLUE, ORANGE, GREEN, VERMILION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
GREY, LIGHT_BLUE = "#666666", "#A6CFE8"

COLUMN_WIDTH_IN = 3.5
DPI = 200

# x, y, width and height of something on a figure, in inches from its lower left corner.
Box = tuple[float, float, float, float]

_RC: Any = {
    "font.size": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.spines.right": False,
    # An offset such as "1e-7-8.348" would stand where the frame numbers are.
    "axes.formatter.useoffset": False,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "svg.hashsalt": "dlgmd",
    "pdf.fonttype": 42,
}


@contextmanager
def house_style() -> Iterator[None]:
    """The look of our figures, for as long as one is being made; the host's is left alone."""
    with matplotlib.rc_context(_RC):
        yield


def new_figure(height_in: float) -> Figure:
    """A figure as wide as a column. Without a layout engine, which takes a third of the time."""
    return Figure(figsize=(COLUMN_WIDTH_IN, height_in))


def add_axes(figure: Figure, box: Box) -> Axes:
    """Axes whose frame stands exactly at `box`."""
    x, y, width, height = box
    figure_width, figure_height = figure.get_size_inches()
    return figure.add_axes(
        (x / figure_width, y / figure_height, width / figure_width, height / figure_height)
    )


def save_figure(figure: Figure, path: Path) -> None:
    """Write `figure` as png, pdf or svg, by the suffix; without dates, so that runs compare.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    undated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    with house_style():
        figure.savefig(path, dpi=DPI, metadata=undated.get(path.suffix, {}))
