"""The style of all figures: readable in a two-column paper, and for the colour-blind."""

import math
import textwrap
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict

import matplotlib
from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.figure import Figure as MatplotlibFigure
from matplotlib.text import Text

from dlgmd_cli.errors import printable, warn

if TYPE_CHECKING:  # not in Matplotlib 3.10.0
    from matplotlib.typing import RcKeyType

# Okabe and Ito's palette, safe for all common kinds of colour blindness. Vermilion is only for
# alarms, black only for collisions.
BLUE, ORANGE, GREEN, VERMILION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY_BLUE, BLACK = "#CC79A7", "#56B4E9", "#000000"
GREY, LIGHT_GREY = "#666666", "#DDDDDD"
# Two of Paul Tol's colours, for more curves than that palette has.
INDIGO, OLIVE = "#332288", "#999933"

# In dB. Below, less than a millionth of P passes: rounding errors of a few cells, which would
# compress the axis.
FLOOR_DB = -60.0

# Place of a legend.
Outside = Literal["outside upper center", "outside lower left"]
# Width of a figure, in columns of a paper.
Width = Literal["one", "two"]

_WIDTH_IN = {"one": 3.5, "two": 7.16}
DPI = 200
# PNG files a few percent larger than by default, written in half of the time.
PNG_OPTIONS = {"compress_level": 3}
_SCREEN_DPI = 120

# Handles and labels of a legend.
Entries = list[tuple[Any, str]]
Dashes = str | tuple[float, tuple[float, ...]]


class Line(TypedDict, total=False):
    """How a line and its markers are drawn, by Matplotlib's names."""

    color: str
    linestyle: Dashes
    linewidth: float
    drawstyle: Literal["default", "steps-post", "steps-pre"]
    alpha: float
    zorder: float
    marker: str
    markersize: float
    markeredgecolor: str
    markeredgewidth: float
    clip_on: bool


# The white ground behind a text, which hides lines.
GROUND = {"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8}

_MAX_LABEL = 44
_MAX_COLUMNS = 6
# Up to this multiple of our font size, figures have the width of a column.
_MOST_IN_WIDTH = 1.25
# Size of the font, and further sizes, in points.
_FONT_SIZE = 8.0
_SIZES: "dict[RcKeyType, float]" = {
    "axes.labelsize": 8.0,
    "axes.titlesize": 8.0,
    "figure.labelsize": 8.0,
    "figure.titlesize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
}
_RC: "dict[RcKeyType, bool | int | float | str]" = {
    **_SIZES,
    "font.family": "DejaVu Sans",
    "font.size": _FONT_SIZE,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    # An axis offset such as "1e-7-8.348" would overlap the frame numbers.
    "axes.formatter.useoffset": False,
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "legend.columnspacing": 1.2,
    "legend.labelspacing": 0.3,
    "figure.constrained_layout.h_pad": 0.03,
    "figure.constrained_layout.w_pad": 0.03,
    "figure.constrained_layout.hspace": 0.0,
    "figure.constrained_layout.wspace": 0.0,
    "svg.hashsalt": "dlgmd",
    # Text stays text: TrueType fonts in PDF, which journals require, and editable text in SVG.
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
}
# Set always: a matplotlibrc in the working folder could turn this setting on, which starts LaTeX.
_ALWAYS: "dict[RcKeyType, bool]" = {"text.usetex": False}
_LACKS_LETTERS = "the figure's font lacks some letters; the figure shows boxes instead"


class Figure(MatplotlibFigure):
    """A figure that a notebook shows if it is the last value of a cell."""

    def _repr_png_(self) -> bytes:
        """The figure as PNG, for IPython."""
        drawn = BytesIO()
        self.savefig(drawn, format="png", dpi=_SCREEN_DPI)
        return drawn.getvalue()

    def savefig(self, fname: Any, **options: Any) -> None:
        """Write the figure in the style in which it was drawn."""
        with house_style():
            super().savefig(fname, **options)


@contextmanager
def house_style() -> Iterator[None]:
    """Use our style within a `with` block; the caller's Matplotlib settings are restored after.

    Settings that the caller changed from Matplotlib's defaults stay; sizes follow the font size.
    """
    now, usual = matplotlib.rcParams, matplotlib.rcParamsDefault
    ours = {key: value for key, value in _RC.items() if now[key] == usual[key]}
    if "font.size" not in ours:
        ours |= {key: size * text_scale() for key, size in _SIZES.items() if key in ours}
    with matplotlib.rc_context({**ours, **_ALWAYS}), warnings.catch_warnings():
        # `save_figure` warns once per figure instead.
        warnings.filterwarnings("ignore", r"Glyph .* missing from")
        yield


def text_scale() -> float:
    """The caller's font size over the default size; 1 unless the caller changed it."""
    size = float(matplotlib.rcParams["font.size"])
    return 1.0 if size == matplotlib.rcParamsDefault["font.size"] else size / _FONT_SIZE


def width_in(width: Width) -> float:
    """Width of a figure, in inches.

    Raises
    ------
    ValueError
        If `width` is neither "one" nor "two".
    """
    if width not in _WIDTH_IN:
        raise ValueError(f"width is {width!r}, neither 'one' nor 'two'")
    return _WIDTH_IN[width]


def points(size: float) -> float:
    """A font size in points, in proportion to the caller's font size."""
    return size * text_scale()


def _wider() -> float:
    """How much wider than usual figures are, for large fonts."""
    return max(1.0, text_scale() / _MOST_IN_WIDTH)


def longest_label() -> int:
    """Number of letters of a label that fits into a panel: fewer in large fonts."""
    return round(_MAX_LABEL * _wider() / max(1.0, text_scale()))


def new_figure(height_in: float, width: Width = "one") -> Figure:
    """An empty figure with constrained layout; large fonts enlarge the figure."""
    size_in = width_in(width) * _wider(), height_in * text_scale()
    return Figure(figsize=size_in, dpi=DPI, layout="constrained")


def add_legend(figure: Figure, entries: Entries, place: Outside = "outside upper center") -> float:
    """Add a legend outside the axes, in as many columns as fit; the figure grows by its height.

    A label occurs once, with its first handle. Returns the legend's height in inches.
    """
    by_label: dict[str, Any] = {}
    for handle, label in entries:
        by_label.setdefault(label, handle)
    handles, labels, height_in = list(by_label.values()), [*map(wrapped, by_label)], 0.0
    for n_columns in range(min(len(labels), _MAX_COLUMNS), 0, -1):
        legend = figure.legend(handles, labels, ncols=n_columns, loc=place)
        size = legend.get_window_extent()
        if n_columns == 1 or size.width <= figure.bbox.width:
            height_in = math.ceil(size.height) / figure.dpi
            break
        legend.remove()
    if (share := figure.bbox.width / size.width if labels else 1.0) < 1.0:
        legend.remove()  # the longest label alone is too wide: all are smaller
        smaller = share * float(matplotlib.rcParams["legend.fontsize"])
        legend = figure.legend(handles, labels, ncols=1, loc=place, fontsize=smaller)
        height_in = math.ceil(legend.get_window_extent().height) / figure.dpi
    figure.set_figheight(figure.get_figheight() + height_in)
    return height_in


def plain(text: str, longest: int = _MAX_LABEL) -> str:
    """`text` on one line, with dollar signs escaped, so that Matplotlib sees no formula.

    The middle of a text longer than `longest` characters is left out.
    """
    text = printable(text)
    if len(text) > longest:
        text = f"{text[: longest // 2]}…{text[len(text) - (longest - 1) // 2 :]}"
    return text.replace("$", r"\$")


def wrapped(text: str, longest: int = _MAX_LABEL) -> str:
    """`text` on as many lines as it needs, each as `plain` makes it."""
    lines = textwrap.wrap(printable(text), longest, break_long_words=False, break_on_hyphens=False)
    return "\n".join(plain(line, longest) for line in lines)


def write_centred(axes: Axes, x: float, y: float, text: str, **options: Any) -> Text:
    """Write a grey text centred at (`x`, `y`)."""
    return axes.text(x, y, text, ha="center", va="center", color=GREY, **options)


def write_on_white(axes: Axes, x: float, y: float, text: str, **options: Any) -> Text:
    """Write a text of any characters on a white background, which hides the lines behind it."""
    options |= {"fontsize": points(7), "bbox": {**GROUND, "alpha": 1.0}, "zorder": 3}
    return axes.text(x, y, f" {plain(text)} ", **options)


def save_figure(figure: MatplotlibFigure, path: Path, dpi: int = DPI) -> None:
    """Write `figure` as PNG, PDF or SVG, by the suffix of `path`; equal figures give equal files.

    `dpi` is the resolution of PNG, and of images within PDF and SVG. Warns if the font lacks
    letters. An OSError passes through.
    """
    undated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    suffix = path.suffix.lower()
    # In memory first: on a full disk, Matplotlib's writers raise all kinds of errors.
    drawn = BytesIO()
    with house_style():
        layout = figure.get_layout_engine()
        if layout is not None:  # computed here: savefig would draw the figure twice for the layout
            layout.execute(figure)
            figure.set_layout_engine(None)
        metadata = undated.get(suffix, {})
        write = partial(figure.savefig, drawn, format=suffix[1:], dpi=dpi, metadata=metadata)
        if suffix == ".png":
            write = partial(write, pil_kwargs=PNG_OPTIONS)
        write()
    path.write_bytes(drawn.getvalue())
    texts: Sequence[Text] = figure.findobj(Text)  # type: ignore[assignment]
    font = texts[0].get_fontproperties() if texts else "DejaVu Sans"
    known = font_manager.get_font(font_manager.findfont(font)).get_charmap()
    shown = {letter for text in texts for letter in text.get_text()} - {"\n"}
    if any(ord(letter) not in known for letter in shown):
        warn(_LACKS_LETTERS)


def figure_files(
    figures: Mapping[str, Callable[[], MatplotlibFigure]], formats: Collection[str], dpi: int = DPI
) -> dict[str, Callable[[Path], None]]:
    """File name -> the function that writes that file.

    `figures` maps a file name without suffix to the function that draws the figure. The function
    is called once, when the first of the figure's files is written. `formats` are "png", "pdf" or
    "svg"; `dpi` is as in `save_figure`.
    """

    def write(draw: Callable[[], MatplotlibFigure], path: Path) -> None:
        save_figure(draw(), path, dpi)

    drawing = {name: cache(draw) for name, draw in figures.items()}
    return {f"{name}.{form}": partial(write, drawing[name]) for name in figures for form in formats}
