"""Annotations: lines and bands across the panels, and above them a strip with their texts."""

from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes

from dlgmd_cli.plots.style import BLACK, GREY, LEFT_IN, VERMILION
from dlgmd_cli.plots.text import plain, shortened, text_width_in
from dlgmd_cli.plots.timeline import Timeline
from dlgmd_cli.results.annotations import Annotations

_SIZE_PT = 7
# In inches: from one row of texts to the next, below all of them, beside a text, and how far
# texts may stick out of the axes on the left and on the right.
_ROW_IN, _FOOT_IN, _PAD_IN = 0.135, 0.03, 0.04
_OUT_LEFT_IN, _OUT_RIGHT_IN = LEFT_IN - 0.05, 0.13
# A rasteriser makes text a little wider than its font says.
_SLACK = 1.04

# A thin line, a thick one and a dotted one, so that they differ in grey too.
_MARK: dict[str, Any] = {"color": GREY, "linewidth": 0.6}
_COLLISION: dict[str, Any] = {"color": VERMILION, "linewidth": 1.2}
_FALSE_POSITIVE: dict[str, Any] = {"color": BLACK, "linewidth": 1.0, "linestyle": (0, (1, 1.5))}
_BAND: dict[str, Any] = {"color": BLACK, "alpha": 0.07, "linewidth": 0, "zorder": 0}
_EDGE: dict[str, Any] = {"color": GREY, "linewidth": 0.3, "zorder": 0.5}


@dataclass
class _Text:
    """A text on the strip, from `left` to `right` in inches; the lowest row is 0."""

    text: str
    left: float
    right: float
    color: str
    row: int = 0

    @property
    def foot_in(self) -> float:
        """Lower edge, in inches."""
        return _FOOT_IN + self.row * _ROW_IN


class Marks:
    """What annotations there are on a timeline, laid out so that no text touches another.

    Parameters
    ----------
    annotations : Annotations
        Those outside the timeline's frames are left out.
    timeline : Timeline
        Says when a frame was.
    width_in : float
        Width of the axes, in inches.

    Attributes
    ----------
    height_in : float
        Height of the strip for the texts, in inches; 0 if there are none.
    """

    def __init__(self, annotations: Annotations, timeline: Timeline, width_in: float) -> None:
        self._timeline, self._width_in = timeline, width_in
        first, last = timeline.frames
        points = [(frame, text, _MARK) for frame, text in annotations.marks]
        for named, text, look in (
            (annotations.collision_frame, "collision", _COLLISION),
            (annotations.false_positive_frame, "false positive", _FALSE_POSITIVE),
        ):
            points += [] if named is None else [(named, text, look)]
        self._points = [
            (timeline.time_of(frame), self._beside(frame, text, look["color"]), look)
            for frame, text, look in points
            if first <= frame <= last
        ]
        self._spans = [
            (timeline.time_of(start), timeline.time_of(end), self._above(start, end, text))
            for start, end, text in annotations.spans
            if end >= first and start <= last
        ]
        n_rows = self._stagger()
        self.height_in = n_rows * _ROW_IN + _FOOT_IN if n_rows else 0.0

    def draw(self, strip: Axes, panels: list[Axes]) -> None:
        """Texts on `strip`, axes of `height_in` above the panels; lines and bands on all."""
        strip.set_xlim(self._timeline.view)
        strip.set_ylim(0.0, self.height_in)
        strip.set_xticks([])
        strip.set_yticks([])
        strip.patch.set_visible(False)
        for side in ("left", "bottom"):
            strip.spines[side].set_visible(False)
        for start_s, end_s, text in self._spans:
            top = text.foot_in + _ROW_IN
            for axes, up_to in ((strip, top / self.height_in), *((axes, 1.0) for axes in panels)):
                axes.axvspan(start_s, end_s, 0.0, up_to, **_BAND)
                axes.vlines(
                    (start_s, end_s), 0.0, up_to, transform=axes.get_xaxis_transform(), **_EDGE
                )
        for time_s, text, look in self._points:
            top = text.foot_in + 0.8 * _ROW_IN
            for axes, up_to in ((strip, top / self.height_in), *((axes, 1.0) for axes in panels)):
                axes.axvline(time_s, 0.0, up_to, zorder=0.9, clip_on=False, **look)
        for _, text in self._texts():
            self._write(strip, text)

    def _texts(self) -> list[tuple[float | None, _Text]]:
        """Every text, with the place of its line in inches if it has one."""
        left, right = self._timeline.view
        scale = self._width_in / (right - left)
        lines: list[tuple[float | None, _Text]] = [
            ((time_s - left) * scale, text) for time_s, text, _ in self._points
        ]
        return lines + [(None, text) for _, _, text in self._spans]

    def _place_in(self, frame: int) -> float:
        """Where a frame stands, in inches from the left of the axes."""
        left, right = self._timeline.view
        return (self._timeline.time_of(frame) - left) / (right - left) * self._width_in

    def _beside(self, frame: int, text: str, color: str) -> _Text:
        """A text right of the line of its frame, like a flag; left of it where there is no room."""
        place = self._place_in(frame)
        right = self._fitted(text, place, color, share=0.0)
        return right if right.left >= place else self._fitted(text, place, color, share=1.0)

    def _above(self, start: int, end: int, text: str) -> _Text:
        """A text over the middle of its band."""
        middle = (self._place_in(start) + self._place_in(end)) / 2
        return self._fitted(text, middle, BLACK, share=0.5)

    def _fitted(self, text: str, place: float, color: str, *, share: float) -> _Text:
        """A text with that share of it left of `place`, moved as far as the figure asks for."""
        room = self._width_in + _OUT_LEFT_IN + _OUT_RIGHT_IN
        text = shortened(text, room / _SLACK - 2 * _PAD_IN, _SIZE_PT)
        width = text_width_in(text, _SIZE_PT) * _SLACK + 2 * _PAD_IN
        left = min(place - share * width, self._width_in + _OUT_RIGHT_IN - width)
        left = max(left, -_OUT_LEFT_IN)
        return _Text(text, left, left + width, color)

    def _stagger(self) -> int:
        """Give every text its row, and say how many rows there are.

        From right to left, so that a line, which goes up to its own text, finds the texts that
        it would cross above it.
        """
        placed: list[tuple[float | None, _Text]] = []
        for line, text in sorted(self._texts(), key=lambda item: -item[1].left):
            taken = {
                other.row
                for _, other in placed
                if text.left < other.right and other.left < text.right
            }
            crossing = [
                other.row
                for place, other in placed
                if place is not None and text.left <= place <= text.right
            ]
            text.row = max(crossing, default=-1) + 1
            while text.row in taken:
                text.row += 1
            placed.append((line, text))
        return max((text.row + 1 for _, text in placed), default=0)

    def _write(self, strip: Axes, text: _Text) -> None:
        """A text on a white ground, so that what must pass it passes behind it."""
        left, right = self._timeline.view
        strip.text(
            left + (text.left + _PAD_IN) / self._width_in * (right - left),
            text.foot_in + 0.03,
            plain(text.text),
            color=text.color,
            fontsize=_SIZE_PT,
            zorder=3,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8},
        )
