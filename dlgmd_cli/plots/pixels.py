"""Figures and letters as pixels, for pictures that are put together faster than Matplotlib can."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib import font_manager
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dlgmd_cli.plots.style import house_style

BgrImage = npt.NDArray[np.uint8]

PIXEL_DPI = 100

_RC: Any = {
    "font.size": 12,
    "axes.labelsize": 12,
    "xtick.labelsize": 11,
    "ytick.labelsize": 11,
    "axes.linewidth": 1.0,
    "xtick.major.width": 1.0,
    "ytick.major.width": 1.0,
}


@contextmanager
def film_style() -> Iterator[None]:
    """The look of our figures at the size of a screen."""
    with house_style(), matplotlib.rc_context(_RC):
        yield


def pixel_figure(width: int, height: int) -> Figure:
    """An empty figure of `width` x `height` px."""
    # Matplotlib cuts off what its inches, times the resolution, lack of a whole pixel.
    width_in, height_in = ((side + 0.01) / PIXEL_DPI for side in (width, height))
    return Figure(figsize=(width_in, height_in), dpi=PIXEL_DPI)


def rasterised(figure: Figure) -> BgrImage:
    """What `figure` looks like, (H, W, 3); off-screen."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[:, :, 2::-1])


def drawable(text: str, longest: int = 60) -> str:
    """`text` with a box for what the font lacks, and an ellipsis for what is too long."""
    if len(text) > longest:
        text = text[: longest - 1] + "…"
    font = font_manager.get_font(font_manager.findfont("DejaVu Sans"))
    known = font.get_charmap()
    return "".join(c if c.isprintable() and ord(c) in known else "□" for c in text)


class Lettering:
    """Letters of equal width that are drawn once and then copied.

    Parameters
    ----------
    letters : str
        Those that there are to be.
    size_pt : float
        Their size.
    """

    def __init__(self, letters: str, size_pt: float) -> None:
        # DejaVu Sans Mono advances by 0.602 of its size.
        pixels = size_pt * PIXEL_DPI / 72
        self.width, self.height = round(0.602 * pixels), round(1.4 * pixels)
        figure = pixel_figure(self.width * len(letters), self.height)
        for place, letter in enumerate(letters):
            figure.text(
                *((place + 0.5) / len(letters), 0.3, letter),
                ha="center",
                family="DejaVu Sans Mono",
                fontsize=size_pt,
                parse_math=False,
            )
        sheet = rasterised(figure)
        self._images = {
            letter: sheet[:, place * self.width : (place + 1) * self.width]
            for place, letter in enumerate(letters)
        }

    def write(self, canvas: BgrImage, x: int, y: int, text: str) -> None:
        """Put `text` on `canvas`, its upper left corner at (x, y); cut off at the right edge."""
        line = np.hstack([self._images[letter] for letter in text])[:, : canvas.shape[1] - x]
        canvas[y : y + line.shape[0], x : x + line.shape[1]] = line
