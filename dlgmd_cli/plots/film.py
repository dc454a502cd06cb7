"""The film of a run, 1280x720 px: its layers, its MP and the signal of its rule."""

from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, FigureBase
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.frame import BgrImage, FloatImage
from dlgmd_cli.plots.curves import (
    LEVEL_LIMITS,
    LEVEL_NAMES,
    SIGNAL_NAMES,
    has_own_signal,
    signal_limits,
    stretches,
    thinned,
)
from dlgmd_cli.plots.heat import INPUT_SCALE, Scale, add_bar, mark_centroid, strongest
from dlgmd_cli.plots.style import (
    BLUE,
    GREEN,
    GREY,
    LIGHT_GREY,
    ORANGE,
    VERMILION,
    house_style,
    plain,
    write_centred,
)
from dlgmd_cli.results.names import threshold_text
from dlgmd_cli.results.result import Result, Series

WIDTH, HEIGHT = 1280, 720

_DPI, _HEADER_PX = 100, 60
# Width of a panel, height of its title and colour bar, and greatest height of all three together.
_PANEL_PX, _BARS_PX, _MAX_PANELS_PX = 390, 120, 440
_DOT_PX = 6
# Colours for OpenCV, in BGR order.
_NOW, _ORANGE, _VERMILION, _WHITE = (40,) * 3, (0, 0x9F, 0xE6), (0, 0x5E, 0xD5), (255,) * 3
# A quarter of vermilion on white.
_LIGHT_VERMILION = "#F5D6BF"

Box = tuple[slice, slice]


class _Trace(NamedTuple):
    """A series over time: its name, colour, threshold with its colour and text, and limits."""

    values: Series
    name: str
    color: str
    threshold: float
    threshold_color: str
    text: str
    limits: tuple[float, float]


class Film:
    """Draws the images of a film, 1280x720 px.

    Matplotlib draws the unchanging parts once; changing parts are copied into each image. If a
    layer has more cells than its panel has pixels, a pixel shows the strongest of its cells.

    `result` has a row for every frame of the film, at least one; frames have the `shape` (H, W).
    `scales` and `units` belong to S and G; `label` names input and model. The rows and columns of
    pixels are `panels` for the input, S and G, and `traces` for the membrane potential and, if the
    rule compares something else, for its signal.
    """

    shape = HEIGHT, WIDTH

    def __init__(
        self,
        result: Result,
        shape: tuple[int, int],
        scales: tuple[Scale, Scale],
        units: tuple[str, str],
        label: str,
    ) -> None:
        self._result, self._scales, self._alarmed = result, scales, result.alarmed
        with house_style():
            below_header = (0, 0, 1, 1 - _HEADER_PX / HEIGHT)
            layout = ConstrainedLayoutEngine(rect=below_header, w_pad=0.2, h_pad=0.08)
            size_in = WIDTH / _DPI, HEIGHT / _DPI
            figure = Figure(figsize=size_in, dpi=_DPI, layout=layout)
            shown = _traces_of(result)
            panels, traces = _static(figure, shape, scales, units, result, shown)
            right, top = 1 - 30 / WIDTH, 1 - 16 / HEIGHT
            figure.text(right, top, plain(label, 60), ha="right", va="top", color=GREY, fontsize=12)
            self._ground = _pixels(figure)
            for axes, trace in zip(traces, shown, strict=True):
                _draw_trace(axes, trace, result)
            self._draw_spikes(traces[0])
            self._traced = _pixels(figure)
        self.panels = [_box_of(axes) for axes in panels]
        self.traces = [_box_of(axes) for axes in traces]
        self._places = [
            _places(axes, result.time_s, np.clip(trace.values, *trace.limits))
            for axes, trace in zip(traces, shown, strict=True)
        ]
        self._known = [~np.isnan(trace.values) for trace in shown]

    def picture(
        self, row: int, luminance: FloatImage, s: FloatImage | None, g: FloatImage | None
    ) -> BgrImage:
        """The image of one row of the result, (720, 1280, 3) BGR.

        `luminance` is the frame, 0 to 1, and `s` and `g` its layers, None where undefined.
        """
        picture = self._ground.copy()
        grey = cv2.cvtColor(cv2.convertScaleAbs(luminance, alpha=255.0), cv2.COLOR_GRAY2BGR)
        images: list[BgrImage | None] = [np.asarray(grey, np.uint8)]
        for box, layer, scale in zip(self.panels[1:], (s, g), self._scales, strict=True):
            images.append(None if layer is None else scale.painted(strongest(layer, *_size(box))))
        for box, image in zip(self.panels, images, strict=True):
            if image is not None:
                height, width = _size(box)
                way = cv2.INTER_AREA if image.shape[1] > width else cv2.INTER_NEAREST
                picture[box] = cv2.resize(image, (width, height), interpolation=way)
        if g is not None:
            mark_centroid(picture[self.panels[2]], self._result.g_x[row], self._result.g_y[row])
        self._show_present(picture, row)
        self._write_header(picture, row)
        return picture

    def _draw_spikes(self, axes: Axes) -> None:
        result = self._result
        times, levels = thinned(result.time_s, np.where(result.new_spikes, result.level, np.nan))
        look: Any = {"color": ORANGE, "markeredgecolor": "black", "markeredgewidth": 0.5}
        axes.plot(times, levels, "o", clip_on=False, markersize=6, **look)

    def _show_present(self, picture: BgrImage, row: int) -> None:
        drawn = zip(self.traces, self._places, self._known, strict=True)
        for number, ((rows, columns), places, known) in enumerate(drawn):
            x, y = (int(place) for place in places[row])
            # The strip is wider than the axes by a margin for the dots at the ends.
            margin = _DOT_PX + 2
            left = columns.start - margin
            past = np.s_[rows.start - margin : rows.stop + margin, left : max(x + 1, columns.start)]
            picture[past] = self._traced[past]
            cv2.line(picture, (x, rows.start), (x, rows.stop - 1), _NOW, 1)
            if known[row]:
                is_spike = number == 0 and self._result.new_spikes[row]
                cv2.circle(
                    picture, (x, y), _DOT_PX, _ORANGE if is_spike else _NOW, cv2.FILLED, cv2.LINE_AA
                )
                cv2.circle(picture, (x, y), _DOT_PX, _NOW, 1, cv2.LINE_AA)

    def _write_header(self, picture: BgrImage, row: int) -> None:
        result, middle = self._result, WIDTH // 2
        text = f"frame {result.frame[row]}   {result.time_s[row]:.3f} s"
        _write(picture, text, (30, 36), 0.75, _NOW, 1)
        if self._alarmed[row]:
            text = f"ALARM ({result.rule.name})"
            (width, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.85, 2)
            left, right = middle - width // 2 - 12, middle + width // 2 + 12
            cv2.rectangle(picture, (left, 10), (right, 44), _VERMILION, cv2.FILLED)
            _write(picture, text, (middle - width // 2, 37), 0.85, _WHITE, 2)


def _static(
    figure: Figure,
    shape: tuple[int, int],
    scales: tuple[Scale, Scale],
    units: tuple[str, str],
    result: Result,
    curves: list[_Trace],
) -> tuple[list[Axes], list[Axes]]:
    """Draw panels without images, and empty traces; returns their axes."""
    above_px = min(_PANEL_PX * shape[0] / shape[1] + _BARS_PX, _MAX_PANELS_PX)
    ratios = above_px, HEIGHT - _HEADER_PX - above_px
    ((above,), (below,)) = figure.subfigures(2, 1, squeeze=False, height_ratios=ratios)
    panels: list[Axes] = list(above.subplots(1, 3))
    titles = "Input", "S", "G, with the centroid of its active cells (○)"
    shown = zip(panels, titles, (INPUT_SCALE, *scales), ("luminance", *units), strict=True)
    for axes, title, scale, unit in shown:
        axes.set_title(title, fontsize=13)
        axes.imshow(np.zeros(shape), cmap="gray", vmin=-1.0, vmax=0.0, alpha=0.0, aspect="equal")
        axes.set(facecolor=LIGHT_GREY, xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        if title != "Input":
            write_centred(axes, 0.5, 0.5, "undefined", fontsize=12, transform=axes.transAxes)
        _add_bar(above, axes, scale, unit)
    traces: list[Axes] = [*below.subplots(len(curves), sharex=True, squeeze=False).flat]
    # A single frame also needs a time axis of some length.
    first_s, last_s = float(result.time_s[0]), float(result.time_s[-1])
    traces[-1].set_xlim(first_s, last_s if last_s > first_s else first_s + 1.0)
    traces[-1].set_xlabel("Time (s)", fontsize=12)
    handles: list[Any] = []
    for axes, one in zip(traces, curves, strict=True):
        axes.set_ylim(*one.limits)
        axes.tick_params(labelsize=11)
        axes.set_ylabel(one.name, fontsize=12 if len(curves) == 1 else 9)
        line = axes.axhline(one.threshold, color=one.threshold_color, linestyle="--", linewidth=1.0)
        line.set_label(one.text)
        handles.append(line)
    spike: Any = {"color": ORANGE, "linestyle": "", "marker": "o", "markeredgecolor": "black"}
    handles.append(Line2D([], [], markersize=6, label="spike", **spike))
    handles.append(Patch(color=_LIGHT_VERMILION, linewidth=0, label=f"alarm ({result.rule.name})"))
    below.legend(handles=handles, loc="outside upper right", ncols=4, fontsize=11)
    return panels, traces


def _traces_of(result: Result) -> list[_Trace]:
    """The membrane potential, and the rule's signal if that is something else."""
    level, rule = LEVEL_NAMES[result.by_sequence], result.rule
    text = f"threshold {threshold_text(result.threshold)}"
    shown = [_Trace(result.level, level, BLUE, result.threshold, GREY, text, LEVEL_LIMITS)]
    if rule.column != "level" or has_own_signal(result):
        name, limits = SIGNAL_NAMES.get(rule.column, "Signal"), signal_limits(result)
        own = rule.threshold, VERMILION, rule.line_text, limits
        shown.append(_Trace(result.signal, name, GREEN, *own))
    return shown


def _add_bar(figure: FigureBase, axes: Axes, scale: Scale, unit: str) -> None:
    """Add a colour bar below a panel; if all values are 0, a text says so."""
    ticks = MaxNLocator(5, steps=[1, 2, 5, 10])
    bar = add_bar(
        figure, axes, scale, unit, ticks=ticks, orientation="horizontal", aspect=35, pad=0.02
    )
    bar.ax.xaxis.label.set_fontsize(11)
    bar.ax.tick_params(labelsize=11)
    if scale.is_flat:
        axes.set_xlabel(f"0 {unit} everywhere", fontsize=11, parse_math=False)


def _draw_trace(axes: Axes, trace: _Trace, result: Result) -> None:
    """Draw a series, and a band at every alarm."""
    low, high = trace.limits
    bands = stretches(result.time_s, result.alarmed)
    axes.broken_barh(bands, (low, high - low), color=_LIGHT_VERMILION, linewidth=0.8, zorder=0)
    axes.plot(*thinned(result.time_s, trace.values), color=trace.color, linewidth=1.6)


def _places(axes: Axes, time_s: Series, values: Series) -> npt.NDArray[np.int64]:
    """The pixels of points in the film, x and y, shape (n, 2); of NaN, those of 0."""
    places = axes.transData.transform(np.column_stack((time_s, np.nan_to_num(values))))
    places[:, 1] = HEIGHT - places[:, 1]
    return np.asarray(places.round().astype(np.int64))


def _write(
    picture: BgrImage,
    text: str,
    place: tuple[int, int],
    scale: float,
    colour: tuple[int, ...],
    thickness: int,
) -> None:
    """Write a text into an image, with the text's lower left corner at a place."""
    font = cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(picture, text, place, font, scale, colour, thickness, cv2.LINE_AA)


def _pixels(figure: Figure) -> BgrImage:
    """Render `figure` off-screen; returns its pixels, (H, W, 3) BGR."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    figure.set_layout_engine("none")  # keep the computed positions
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[:, :, 2::-1])


def _box_of(axes: Axes) -> Box:
    """Rows and columns of the pixels of some axes, at least one of each."""
    box = axes.get_window_extent()
    top, left = round(HEIGHT - box.y1), round(box.x0)
    bottom, right = max(round(HEIGHT - box.y0), top + 1), max(round(box.x1), left + 1)
    return slice(top, bottom), slice(left, right)


def _size(box: Box) -> tuple[int, int]:
    """Height and width of a box, in px."""
    return tuple(side.stop - side.start for side in box)  # type: ignore[return-value]
