"""A film of the model at work: input, S and G above a running trace of the membrane potential."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.heat import FloatImage, Scale, strongest
from dlgmd_cli.plots.pixels import (
    BgrImage,
    Lettering,
    drawable,
    film_style,
    pixel_figure,
    rasterised,
)
from dlgmd_cli.plots.ribbon import LEVELS, LIGHT_VERMILION, TICKS_PX, Ribbon
from dlgmd_cli.plots.style import BLUE, GREY, ORANGE, VERMILION
from dlgmd_cli.results.tables import Result

WIDTH, HEIGHT = 1280, 720

# All in px. Left and right of everything; the panels' tops, their room and the gaps between.
_LEFT, _RIGHT, _PANELS_Y, _GAP = 80, 30, 84, 42
_TRACE_WIDTH = WIDTH - _LEFT - _RIGHT
_PANEL_WIDTH = (_TRACE_WIDTH - 2 * _GAP) // 3
_PANEL_MAX_HEIGHT = 300
_HEADER_Y, _TITLE_ROOM = 14, 34
# From a panel down to its colour bar, and to the trace.
_BAR_GAP, _BAR_HEIGHT, _BAR_ROOM = 12, 10, 104
_BOTTOM = 34
# Room beyond the trace's ends for half of a number on the time axis.
_MARGIN = 30
_UNDEFINED = "#DDDDDD"
# Radius of the dot that marks the present.
_DOT = 6
# As OpenCV draws them, in BGR order.
_NOW, _ORANGE = (40, 40, 40), (0, 0x9F, 0xE6)


@dataclass(frozen=True)
class FilmFacts:
    """What holds for a whole film.

    Attributes
    ----------
    result : Result
        What the model said about every frame; at least one.
    shape : (int, int)
        H and W of the frames as the model takes them.
    s_scale, g_scale : Scale or None
        The scales of S and G, the same in every picture; None where they are never defined.
    units : (str, str)
        Units of S and G, in words.
    label : str
        What the film says of its origin.
    """

    result: Result
    shape: tuple[int, int]
    s_scale: Scale | None
    g_scale: Scale | None
    units: tuple[str, str]
    label: str = ""


class Film:
    """Draws the pictures of a film, 1280x720 px.

    What stays the same is drawn once, by Matplotlib; the rest is copied in. A layer with more
    cells than its panel has pixels is shown by the strongest cell of each pixel.

    Parameters
    ----------
    facts : FilmFacts
        What holds for all pictures.
    """

    def __init__(self, facts: FilmFacts) -> None:
        self._facts = facts
        height, width = facts.shape
        scale = min(_PANEL_WIDTH / width, _PANEL_MAX_HEIGHT / height)
        self._panel_wh = max(1, round(width * scale)), max(1, round(height * scale))
        trace_y = _PANELS_Y + self._panel_wh[1] + _BAR_ROOM
        self._trace_y, trace_height = trace_y, HEIGHT - _BOTTOM - trace_y
        self._ribbon = Ribbon(facts.result, _TRACE_WIDTH, trace_height)
        with film_style():
            self._ground = rasterised(self._static())
            self._letters = Lettering("0123456789.- frames", 15)
            self._alarm = rasterised(_alarm())
        self._canvas = self._ground.copy()

    def picture(
        self, row: int, luminance: FloatImage, s: FloatImage | None, g: FloatImage | None
    ) -> BgrImage:
        """The picture of one frame.

        Parameters
        ----------
        row : int
            Which row of the result it is.
        luminance : ndarray, shape (H, W), float32
            The frame, 0 to 1.
        s, g : ndarray, shape (H, W), float32, or None
            Its layers; None where they are not defined.

        Returns
        -------
        ndarray, shape (720, 1280, 3), uint8
            In BGR order; valid until the next call.
        """
        size_wh, result = self._panel_wh, self._facts.result
        grey = cv2.convertScaleAbs(luminance, alpha=255.0)
        shrinks = grey.shape[1] > size_wh[0]
        way = cv2.INTER_AREA if shrinks else cv2.INTER_NEAREST
        grey = cv2.resize(grey, size_wh, interpolation=way)
        self._fill_panel(0, np.repeat(grey[:, :, None], 3, axis=2).astype(np.uint8, copy=False))
        self._fill_panel(1, self._painted(s, self._facts.s_scale))
        self._fill_panel(2, self._painted(g, self._facts.g_scale))
        self._draw_trace(row)
        self._canvas[: _PANELS_Y - _TITLE_ROOM] = self._ground[: _PANELS_Y - _TITLE_ROOM]
        text = f"frame {result.frame[row]}  {result.time_s[row]:.3f} s"
        self._letters.write(self._canvas, _LEFT, _HEADER_Y, text)
        if result.collision[row]:
            height, width = self._alarm.shape[:2]
            x = (WIDTH - width) // 2
            self._canvas[_HEADER_Y : _HEADER_Y + height, x : x + width] = self._alarm
        return self._canvas

    def _painted(self, layer: FloatImage | None, scale: Scale | None) -> BgrImage | None:
        """A layer at the size of its panel, in colour."""
        if layer is None or scale is None:
            return None
        width, height = self._panel_wh
        colours = scale.painted(strongest(layer, height, width))
        enlarged = cv2.resize(colours, self._panel_wh, interpolation=cv2.INTER_NEAREST)
        return np.asarray(enlarged, dtype=np.uint8)

    def _fill_panel(self, number: int, image: BgrImage | None) -> None:
        """Put `image` into a panel, or what stands there by itself."""
        x, y = _panel_x(number, self._panel_wh[0]), _PANELS_Y
        region = np.s_[y : y + self._panel_wh[1], x : x + self._panel_wh[0]]
        self._canvas[region] = self._ground[region] if image is None else image

    def _draw_trace(self, row: int) -> None:
        """The trace so far; a long one scrolls past, with the present at the right."""
        ribbon, result = self._ribbon, self._facts.result
        now = ribbon.place(float(result.time_s[row]))
        left = max(0, now - ribbon.width + _DOT + 2)
        cut = ribbon.cut(left - _MARGIN, ribbon.width + 2 * _MARGIN, now + 1)
        below = ribbon.height - TICKS_PX
        y = self._trace_y
        trace = self._canvas[y : y + below, _LEFT : _LEFT + ribbon.width]
        trace[:] = cut[:below, _MARGIN:-_MARGIN]
        self._canvas[
            y + below : y + ribbon.height, _LEFT - _MARGIN : _LEFT + ribbon.width + _MARGIN
        ] = cut[below:]
        bottom = y + below
        cv2.line(self._canvas, (_LEFT, bottom), (_LEFT + ribbon.width - 1, bottom), (0, 0, 0))
        cv2.line(trace, (now - left, 0), (now - left, below - 1), _NOW, 1)
        level = float(result.level[row])
        if not np.isnan(level):
            centre = now - left, ribbon.level_y(level)
            colour = _ORANGE if result.spike[row] else _NOW
            cv2.circle(trace, centre, _DOT, colour, cv2.FILLED, cv2.LINE_AA)
            cv2.circle(trace, centre, _DOT, _NOW, 1, cv2.LINE_AA)

    def _static(self) -> Figure:
        """Titles, empty panels, scales and the frame of the trace."""
        facts, figure = self._facts, pixel_figure(WIDTH, HEIGHT)
        panels = (
            ("Input", Scale(0.0, 1.0, "gray"), "luminance"),
            ("S", facts.s_scale, facts.units[0]),
            ("G", facts.g_scale, facts.units[1]),
        )
        for number, (title, scale, unit) in enumerate(panels):
            middle = _panel_x(number, 0)
            _text(figure, middle, _PANELS_Y - 8, title, ha="center", va="bottom", fontsize=13)
            self._draw_empty(figure, number)
            if scale is not None:
                self._draw_bar(figure, middle - _PANEL_WIDTH // 2, scale, unit)
        right = WIDTH - _RIGHT
        _text(figure, right, _HEADER_Y + 4, drawable(facts.label), ha="right", va="top", color=GREY)
        axes = _axes(figure, _LEFT - 1, self._trace_y, _TRACE_WIDTH, self._ribbon.height - TICKS_PX)
        axes.set_xticks([])
        axes.set_yticks([0.0, 0.5, 1.0])
        axes.set_ylim(*LEVELS)
        axes.set_ylabel("Normalised MP")
        axes.spines[["top", "bottom"]].set_visible(False)
        _text(figure, _LEFT + _TRACE_WIDTH // 2, HEIGHT - 8, "Time (s)", ha="center", va="bottom")
        self._draw_legend(figure)
        return figure

    def _draw_empty(self, figure: Figure, number: int) -> None:
        """A panel before its first picture."""
        width, height = self._panel_wh
        axes = _axes(figure, _panel_x(number, width), _PANELS_Y, width, height)
        axes.set_facecolor(_UNDEFINED)
        axes.set_axis_off()
        axes.add_patch(Rectangle((0, 0), 1, 1, color=_UNDEFINED, linewidth=0))
        if number > 0:
            look: Any = {"ha": "center", "va": "center", "color": GREY, "clip_on": True}
            axes.text(0.5, 0.5, "undefined", **look)

    def _draw_bar(self, figure: Figure, x: int, scale: Scale, unit: str) -> None:
        """A colour bar below a panel; words, where all values are 0."""
        y = _PANELS_Y + self._panel_wh[1] + _BAR_GAP
        if scale.is_flat:
            text = f"0 {unit} everywhere"
            _text(figure, x + _PANEL_WIDTH / 2, y, text, ha="center", va="top", fontsize=11)
            return
        axes = _axes(figure, x, y, _PANEL_WIDTH, _BAR_HEIGHT)
        colours = ScalarMappable(Normalize(*scale.limits), scale.colours)
        ticks = MaxNLocator(5, steps=[1, 2, 5, 10])
        bar = figure.colorbar(colours, cax=axes, orientation="horizontal", ticks=ticks)
        bar.set_label(unit, labelpad=1, fontsize=11, parse_math=False)
        bar.ax.tick_params(pad=2, length=3)

    def _draw_legend(self, figure: Figure) -> None:
        """What the marks of the trace mean, above it."""
        threshold = float(self._facts.result.threshold[0])
        dot: Any = {"marker": "o", "linestyle": "", "markeredgecolor": "black"}
        figure.legend(
            handles=[
                Line2D([], [], color=BLUE, linewidth=1.6, label="MP"),
                Line2D(
                    [],
                    [],
                    color=GREY,
                    linestyle="--",
                    linewidth=1.0,
                    label=f"threshold {threshold:g}",
                ),
                Line2D([], [], color=ORANGE, markersize=6, label="spike", **dot),
                Patch(color=LIGHT_VERMILION, linewidth=0, label="collision"),
            ],
            loc="lower right",
            bbox_to_anchor=(1 - _RIGHT / WIDTH, 1 - self._trace_y / HEIGHT),
            ncols=4,
            fontsize=11,
            borderaxespad=0.1,
        )


def _alarm() -> Figure:
    """What stands in the header while there is a collision."""
    figure = pixel_figure(130, 30)
    figure.set_facecolor(VERMILION)
    figure.text(0.5, 0.5, "COLLISION", color="white", weight="bold", ha="center", va="center")
    return figure


def _panel_x(number: int, width: int) -> int:
    """The left edge of a panel of that width, in the middle of its column."""
    return _LEFT + number * (_PANEL_WIDTH + _GAP) + (_PANEL_WIDTH - width) // 2


def _axes(figure: Figure, x: float, y: float, width: float, height: float) -> Axes:
    """Axes at a place in px, counted from the upper left corner."""
    return figure.add_axes((x / WIDTH, 1 - (y + height) / HEIGHT, width / WIDTH, height / HEIGHT))


def _text(figure: Figure, x: float, y: float, text: str, **look: Any) -> None:
    """Plain text at a place in px; a $ is no mathematics."""
    figure.text(x / WIDTH, 1 - y / HEIGHT, text, parse_math=False, **look)
