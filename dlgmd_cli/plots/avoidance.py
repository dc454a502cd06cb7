"""A film of one flight twice: as it is flown, and with the alarm in the loop."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from dlgmd_cli.parameters.keys import SPIKES, Parameters
from dlgmd_cli.plots.curves import LEVELS, stretches
from dlgmd_cli.plots.film import HEIGHT, LIGHT_VERMILION, WIDTH, box_of, pixels
from dlgmd_cli.plots.heat import BgrImage
from dlgmd_cli.plots.style import BLACK, BLUE, GREY, ORANGE, house_style, plain
from dlgmd_cli.results.names import threshold_text
from dlgmd_cli.results.result import Series

# Size of the image of a flight.
PANEL_WH = 616, 346
_DPI, _MARGIN_PX, _TOP_PX = 100, 16, 44
# Colours for OpenCV, in BGR order.
_NOW, _VERMILION, _WHITE = (40, 40, 40), (0, 0x5E, 0xD5), (255, 255, 255)
# Longest time to contact that is shown.
_LONGEST_S = 3.0
_THRESHOLD: Any = {"color": GREY, "linestyle": "--", "linewidth": 1.0}


@dataclass(frozen=True)
class FlightTrace:
    """One of the two flights, with a row for each of its n frames.

    Attributes
    ----------
    title : str
        What it is, and how it ends.
    time_s, mp_abs, expansion, contact_s, ttc_s : ndarray, shape (n,)
        Times, normalised potential, expansion rate in 1/s, and the time to contact: the true one if
        the drone flew on as it does, and the estimate. NaN where undefined.
    alarm : ndarray, shape (n,), bool
    pictures : sequence of ndarray, (346, 616), uint8
    """

    title: str
    time_s: Series
    mp_abs: Series
    expansion: Series
    contact_s: Series
    ttc_s: Series
    alarm: npt.NDArray[np.bool_]
    pictures: Sequence[npt.NDArray[np.uint8]]


class AvoidanceFilm:
    """Draws the images of the film; both flights have their traces below.

    Where the alarm of `params` follows spikes, these are the potential with its threshold, and the
    time to contact; else, the expansion, and the time to contact with the threshold.
    """

    shape = HEIGHT, WIDTH

    def __init__(
        self, flights: tuple[FlightTrace, FlightTrace], params: Parameters, label: str
    ) -> None:
        self._flights = flights
        self._time_s = max((flight.time_s for flight in flights), key=len)
        self._last_s = max(float(flight.time_s[-1]) for flight in flights)
        self.n_frames = len(self._time_s)
        with house_style():
            figure = Figure(figsize=(WIDTH / _DPI, HEIGHT / _DPI), dpi=_DPI, layout="constrained")
            room = (_TOP_PX + PANEL_WH[1]) / HEIGHT
            layout: Any = figure.get_layout_engine()
            layout.set(rect=(0, 0, 1, 1 - room), w_pad=0.12, h_pad=0.06)
            grid: Any = figure.subplots(1, 2)

            by_spikes = params.alarm == SPIKES
            _draw_beside(grid[0], flights, by_spikes=by_spikes)
            _draw_contact(grid[1], flights)
            threshold = params.t_mp if by_spikes else params.ttc_alarm
            _draw_alarm(grid[0 if by_spikes else 1], flights[1], threshold)
            for axes in grid:
                axes.set_xlim(0.0, self._last_s)
                axes.set_xlabel("Time (s)", fontsize=12)
                axes.tick_params(labelsize=11)
                axes.spines[["top", "right"]].set_visible(False)
            text = f"threshold {threshold_text(threshold)}{'' if by_spikes else ' s'}"
            handles = [
                Line2D([], [], color=ORANGE, linewidth=1.6, label="without"),
                Line2D([], [], color=BLUE, linewidth=1.6, label=f"with {plain(label, 30)}"),
                Patch(color=LIGHT_VERMILION, linewidth=0, label=f"alarm ({params.alarm})"),
                Line2D([], [], color=BLACK, linewidth=1.2, label="true time to contact"),
                Line2D([], [], **_THRESHOLD, label=text),
            ]
            if any(not np.isnan(flight.ttc_s).all() for flight in flights):
                handles.append(Line2D([], [], color=GREY, marker=".", ls="", label="estimated"))
            figure.legend(handles=handles, loc="outside lower center", ncols=6, fontsize=11)
            self._ground = pixels(figure)
            self._boxes = [box_of(axes) for axes in grid]

    def picture(self, index: int) -> BgrImage:
        """The image of frame `index`, (720, 1280, 3) BGR; a flight that ended stands still."""
        picture = self._ground.copy()
        for place, flight in enumerate(self._flights):
            row = min(index, len(flight.time_s) - 1)
            left = _MARGIN_PX if place == 0 else WIDTH - _MARGIN_PX - PANEL_WH[0]
            below = np.s_[_TOP_PX : _TOP_PX + PANEL_WH[1], left : left + PANEL_WH[0]]
            picture[below] = cv2.cvtColor(flight.pictures[row], cv2.COLOR_GRAY2BGR)
            look: Any = {"fontFace": cv2.FONT_HERSHEY_SIMPLEX, "lineType": cv2.LINE_AA}
            size: Any = {"fontScale": 0.7, "color": _NOW, "thickness": 1}
            cv2.putText(picture, flight.title, (left, 30), **look, **size)
            if flight.alarm[: row + 1].any():
                text = "ALARM" if flight.alarm[row] else "after the alarm"
                width = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.7, 2)[0][0]
                corner = left + PANEL_WH[0] - width - 20, _TOP_PX
                ends = (left + PANEL_WH[0], _TOP_PX + 34)
                colour = _VERMILION if flight.alarm[row] else _NOW
                cv2.rectangle(picture, corner, ends, colour, cv2.FILLED)
                size = {"fontScale": 0.7, "color": _WHITE, "thickness": 2}
                cv2.putText(picture, text, (corner[0] + 10, _TOP_PX + 25), **look, **size)
        share = self._time_s[index] / self._last_s
        rows = self._boxes[0][0]
        for _, columns in self._boxes:
            x = round(columns.start + share * (columns.stop - columns.start))
            cv2.line(picture, (x, rows.start), (x, rows.stop), _NOW, 1)
        return picture


def _draw_beside(axes: Axes, flights: tuple[FlightTrace, FlightTrace], *, by_spikes: bool) -> None:
    """Both potentials, or both expansions."""
    for flight, colour in zip(flights, (ORANGE, BLUE), strict=True):
        shown = flight.mp_abs if by_spikes else flight.expansion
        axes.plot(flight.time_s, shown, color=colour, linewidth=1.6)
    if by_spikes:
        axes.set_ylim(*LEVELS)
    axes.set_ylabel("MP" if by_spikes else "Expansion (1/s)", fontsize=12)


def _draw_alarm(axes: Axes, looped: FlightTrace, threshold: float) -> None:
    """The alarm of the flight with the loop, and the threshold of what its rule compares."""
    low, high = axes.get_ylim()
    spans: Any = stretches(looped.time_s, looped.alarm)
    axes.broken_barh(spans, (low, high - low), color=LIGHT_VERMILION, zorder=0)
    axes.axhline(threshold, **_THRESHOLD)


def _draw_contact(axes: Axes, flights: tuple[FlightTrace, FlightTrace]) -> None:
    """The true time to contact, and the estimates."""
    for flight, colour in zip(flights, (ORANGE, BLUE), strict=True):
        known = np.where(flight.ttc_s <= _LONGEST_S, flight.ttc_s, np.nan)
        axes.plot(flight.time_s, known, ".", color=colour, markersize=4)
    axes.plot(flights[0].time_s, flights[0].contact_s, color=BLACK, linewidth=1.2)
    axes.set_ylim(0.0, _LONGEST_S)
    axes.set_ylabel("Time to contact (s)", fontsize=12)
