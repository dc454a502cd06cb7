"""The time and frame axes of a figure, and the annotations of frames."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.style import BLACK, GREY, VERMILION, Line, text_scale, write_on_white
from dlgmd_cli.results.annotations import Annotations
from dlgmd_cli.results.result import Result, Series

ROW_IN = 0.135
# Extent of lines and bands below their strip, down to the panel, in rows.
_BELOW_STRIP = 0.06 / ROW_IN
# Approximate share of the axes in the width of a figure.
_AXES_SHARE = 0.8
# Margin at either end of the time axis, as a share of the time shown: end points are not cut off.
_MARGIN = 0.015
# Greatest density of ticks of the frame axis: numbers of five digits do not touch.
_TICKS_PER_INCH = 2.3
# Relative tolerance for equal times: CSVs have nine digits.
_ROUNDING = 1e-8

# A thick line and a dotted line, which differ in grey print too.
_LINES: dict[str, Line] = {
    "mark": {"color": GREY, "linewidth": 0.6},
    "collision": {"color": BLACK, "linewidth": 1.4},
    "false positive": {"color": VERMILION, "linewidth": 1.1, "linestyle": (0, (1, 1))},
}
# The white edges keep adjacent bands apart.
_BAND: Mapping[str, Any] = {
    "facecolor": "0.93",
    "edgecolor": "white",
    "linewidth": 1.0,
    "zorder": -0.5,
}


@dataclass(frozen=True)
class Timeline:
    """The time range of several results, and the times of the frames.

    `frame` increases; `time_s` has the times of these frames. `is_shared` says whether all results
    agree on these times. `limits` of the time axis, in seconds, are given if not all is to be
    shown. `axis_name` is the axis's name.
    """

    start_s: float
    end_s: float
    frame: npt.NDArray[np.int64]
    time_s: Series
    is_shared: bool
    limits: tuple[float, float] | None = None
    axis_name: str = "Time (s)"

    @classmethod
    def of(cls, results: Iterable[Result]) -> "Timeline":
        """The timeline of at least one result, each with at least one frame.

        If the results disagree, the times of the first result are used.
        """
        results = list(results)
        longest = max(results, key=len)
        is_shared = all(_agree(longest, other) for other in results)
        source = longest if is_shared else results[0]
        start_s = min(float(result.time_s[0]) for result in results)
        end_s = max(float(result.time_s[-1]) for result in results)
        return cls(start_s, end_s, source.frame, source.time_s, is_shared)

    @property
    def view(self) -> tuple[float, float]:
        """Limits of the time axis, in seconds."""
        if self.limits:
            return self.limits
        margin = _MARGIN * (self.end_s - self.start_s) or 0.5
        if len(self.time_s) > 1:  # a frame extends halfway to the next frame
            margin = max(margin, 0.6 * float(np.median(np.diff(self.time_s))))
        return self.start_s - margin, self.end_s + margin

    @property
    def frames(self) -> tuple[int, int]:
        """The first and the last frame shown."""
        start_s, end_s = self.limits or (-np.inf, np.inf)
        ends = np.array([max(start_s, self.start_s), min(end_s, self.end_s)])
        first, last = self.frame_of(ends).round().astype(int)
        return int(first), int(last)

    def time_of(self, frame: npt.ArrayLike) -> Series:
        """Times of frames; extrapolated beyond the ends."""
        return _interpolated(frame, self.frame.astype(np.float64), self.time_s)

    def frame_of(self, time_s: npt.ArrayLike) -> Series:
        """Frames (with fractions) at given times; the inverse of `time_of`."""
        return _interpolated(time_s, self.time_s, self.frame.astype(np.float64))

    def label(self, lowest: Axes, highest: Axes) -> None:
        """Label seconds below the panels and, if all results agree on them, frames above."""
        lowest.set(xlim=self.view, xlabel=self.axis_name)
        if self.is_shared:
            first, last = self.frame_of(np.array(self.view))
            density = _TICKS_PER_INCH / text_scale() / _AXES_SHARE
            n_ticks = round(density * _axes_px(lowest) / lowest.figure.dpi)
            locator = MaxNLocator(n_ticks, integer=True, steps=[1, 2, 5, 10])
            frames = locator.tick_values(first, last)
            frames = frames[(frames >= first) & (frames <= last)]
            top = highest.secondary_xaxis("top")
            top.set_xticks(self.time_of(frames), [f"{frame:.0f}" for frame in frames])
            top.set_xlabel("Frame")


def draw_annotations(
    annotations: Annotations, timeline: Timeline, strip: Axes, panels: Iterable[Axes]
) -> int:
    """Draw lines and bands across the panels, and their texts on `strip`, the axes above them.

    A text starts at its line. Texts that would overlap another text or its line are placed in
    different rows. Returns the number of rows.
    """
    (first, last), (left, right) = timeline.frames, timeline.view
    strip.set_yticks([])
    strip.spines[["left", "bottom"]].set_visible(False)
    px_a_second = _axes_px(strip) / (right - left)
    items: list[tuple[float, float, Series, str, Text]] = []
    for start_frame, end_frame, text, kind in annotations.remarks():
        if end_frame < first or start_frame > last:
            continue
        times = timeline.time_of(np.clip([start_frame, end_frame], first, last))
        color = BLACK if kind == "span" else _LINES[kind]["color"]
        drawn = write_on_white(strip, 0.0, 0.0, text, color=color, va="center", in_layout=False)
        width = drawn.get_window_extent().width / px_a_second
        if kind == "span":
            start = max(left, min(float(times.mean()) - width / 2, right - width))
        else:
            start = float(times[0]) if times[0] + width <= right else max(left, times[0] - width)
        items.append((start, start + width, times, kind, drawn))
    placed: list[tuple[float, int]] = []
    for start, end, times, kind, drawn in sorted(items, key=lambda item: -item[0]):
        row = max((other for begin, other in placed if begin < end), default=-1) + 1
        placed.append((start, row))
        drawn.set_position((start, row + 0.5))
        for axes, top in ((strip, row + 1.0), *((axes, 1.0) for axes in panels)):
            up = axes.transData if axes is strip else axes.get_xaxis_transform()
            bottom = -_BELOW_STRIP if axes is strip else 0.0
            drawing: Artist
            if kind == "span":
                drawing = axes.fill_between(times, bottom, top, transform=up, **_BAND)
            else:
                (drawing,) = axes.plot(times, [bottom, top], transform=up, **_LINES[kind])
                drawing.set_zorder(0.9)
            drawing.set_clip_on(False)
            drawing.set_in_layout(False)
    n_rows = max((row + 1 for _, row in placed), default=0)
    strip.set_ylim(0.0, max(n_rows, 1))
    return n_rows


def _axes_px(axes: Axes) -> float:
    """Approximate width of one of the columns of axes in a figure."""
    grid = axes.get_gridspec()
    if grid is None:  # above axes of the caller
        return float(axes.get_window_extent().width)
    return float(axes.figure.bbox.width) * _AXES_SHARE / grid.ncols


def _agree(result: Result, other: Result) -> bool:
    """Whether two results have frames in common, at the same times."""
    _, here, there = np.intersect1d(result.frame, other.frame, return_indices=True)
    tolerance = _ROUNDING * max(1.0, abs(float(other.time_s[-1])))
    return bool(here.size and np.abs(result.time_s[here] - other.time_s[there]).max() <= tolerance)


def _interpolated(x: npt.ArrayLike, known: Series, values: Series) -> Series:
    """Interpolate linearly between known points, and extrapolate beyond them."""
    slope = (values[-1] - values[0]) / (known[-1] - known[0] or 1.0) if len(known) > 1 else 1.0
    x = np.asarray(x, dtype=np.float64)
    return np.asarray(np.interp(x, known, values) + slope * (x - np.clip(x, known[0], known[-1])))
