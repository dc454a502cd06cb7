"""How every figure looks: readable in a two-column paper, and without colour vision."""

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, get_args

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's palette, told apart by all common kinds of colour vision.
BLUE, ORANGE, GREEN, VERMILION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY_BLUE, BLACK = "#CC79A7", "#56B4E9", "#000000"
GREY, LIGHT_BLUE = "#666666", "#A6CFE8"

# A figure is as wide as one column of a paper, or as two.
Width = Literal["one", "two"]
WIDTHS: tuple[str, ...] = get_args(Width)
_WIDTH_IN = {"one": 3.5, "two": 7.16}
DPI = 200

# Of axes over time, in inches: the room left of them for the labels, and right of them.
LEFT_IN, _RIGHT_IN = 0.55, 0.18

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


def figure_width_in(width: Width) -> float:
    """Width of a figure, in inches.

    Raises
    ------
    ValueError
        If `width` is neither "one" nor "two".
    """
    if width not in _WIDTH_IN:
        raise ValueError(f"width is {width!r}, neither 'one' nor 'two'")
    return _WIDTH_IN[width]


def axes_width_in(width: Width) -> float:
    """Width of axes over time on such a figure, in inches."""
    return figure_width_in(width) - LEFT_IN - _RIGHT_IN


def new_figure(height_in: float, width: Width = "one") -> Figure:
    """A figure as wide as a column. Without a layout engine, which takes a third of the time."""
    return Figure(figsize=(figure_width_in(width), height_in))


def add_axes(figure: Figure, box: Box) -> Axes:
    """Axes whose frame stands exactly at `box`."""
    return figure.add_axes(fractions(figure, box))


def fractions(figure: Figure, box: Box) -> Box:
    """`box` as fractions of the figure."""
    x, y, width, height = box
    figure_width, figure_height = figure.get_size_inches()
    return x / figure_width, y / figure_height, width / figure_width, height / figure_height


def save_figure(figure: Figure, path: Path) -> None:
    """Write `figure` as png, pdf or svg, by the suffix; without dates, so that runs compare.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    undated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    suffix = path.suffix.lower()
    # In memory first: where there is no room, Matplotlib's writers raise all kinds of errors.
    drawn = BytesIO()
    with house_style():
        figure.savefig(drawn, format=suffix[1:], dpi=DPI, metadata=undated.get(suffix, {}))
    path.write_bytes(drawn.getvalue())
