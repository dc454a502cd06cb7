"""Some frames of a rendered clip as a contact sheet, with what is true of each under it."""

import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from dlgmd_cli.plots.style import (
    BLACK,
    DPI,
    GREY,
    VERMILION,
    add_axes,
    figure_width_in,
    house_style,
)
from dlgmd_cli.plots.text import shortened, text_width_in
from dlgmd_cli.results.clip_sheet import ClipSheet, Still

GreyImage = npt.NDArray[np.uint8]

_COLUMNS = 4
# In px, so that pixels of frames and of the figure meet: the outer margin, the gaps, the height of
# a tile at most, what the title takes, a line of text, and the gap above a caption.
_EDGE, _GAP, _MAX_TILE, _TITLE, _LINE, _LEAD = 10, 16, 440, 34, 25, 8
_TITLE_PT, _CAPTION_PT = 8.0, 7.0
# A rasteriser makes text a little wider than its font says.
_SLACK = 1.04


def plot_clip_sheet(sheet: ClipSheet) -> Figure:
    """Frames in grey, four in a row, each with its number, time, phase, and how near contact is.

    A frame that is larger than its tile is averaged over area; a smaller one is enlarged by a
    whole factor. The collision frame has a thick rim and says in words that it is one.

    Parameters
    ----------
    sheet : ClipSheet
        Up to 12 frames fit on a page.

    Returns
    -------
    Figure
        Two columns of a paper wide at most, at the resolution that the tiles were made for.
    """
    headings = _headings(sheet)
    captions = [_caption(still) for still in sheet.stills]
    n_columns = min(_COLUMNS, len(captions))
    room = round(figure_width_in("two") * DPI) - 2 * _EDGE
    column = (room + _GAP) // _COLUMNS - _GAP
    tiles = [_tile(still.image, column) for still in sheet.stills]
    tile_height, tile_width = tiles[0].shape
    # Narrow tiles stand closer, as far as their captions allow.
    widest = max(_width_px(line, _CAPTION_PT) for caption in captions for line in caption)
    column = min(column, max(tile_width, widest))
    row = tile_height + _LEAD + max(map(len, captions)) * _LINE + _GAP
    above = _EDGE + _TITLE + (len(headings) - 1) * _LINE
    content = max(n_columns * (column + _GAP) - _GAP, *(_width_px(*line) for line in headings))
    width, height = min(content, room) + 2 * _EDGE, above + -(-len(tiles) // n_columns) * row
    with house_style():
        # Matplotlib cuts off what inches, times the resolution, lack of a whole pixel.
        figure = Figure(figsize=((width + 0.01) / DPI, (height + 0.01) / DPI), dpi=DPI)
        page = _Page(figure, height)
        for number, ((text, points), color) in enumerate(
            zip(headings, (BLACK, GREY), strict=False)
        ):
            page.write(_EDGE, _EDGE + number * _LINE, text, points, room, color=color)
        cells = zip(sheet.stills, tiles, captions, strict=True)
        for place, (still, tile, lines) in enumerate(cells):
            down, across = divmod(place, n_columns)
            x, y = _EDGE + across * (column + _GAP), above + down * row
            page.show(x, y, tile, marked=still.is_collision)
            page.caption(x, y + tile_height + _LEAD, lines, column, marked=still.is_collision)
    return figure


class _Page:
    """A figure whose places are in px from its upper left corner."""

    def __init__(self, figure: Figure, height: int) -> None:
        self._figure, self._height = figure, height

    def write(self, x: int, y: int, text: str, points: float, width: int, **look: Any) -> None:
        """Text below and right of a place, no wider than `width`; a $ is no mathematics."""
        fitting = shortened(text, width / DPI / _SLACK, points)
        at = x / self._figure.bbox.width, (self._height - y) / self._figure.bbox.height
        self._figure.text(*at, fitting, va="top", fontsize=points, parse_math=False, **look)

    def caption(self, x: int, y: int, lines: list[str], width: int, *, marked: bool) -> None:
        """What is true of a frame; if it is `marked`, the last line stands out."""
        for number, line in enumerate(lines):
            look: dict[str, Any] = {"color": BLACK if number == 0 else GREY}
            if marked and number == len(lines) - 1:
                box = {"facecolor": VERMILION, "edgecolor": "none", "pad": 1.0}
                look = {"color": "white", "bbox": box}
            self.write(x, y + number * _LINE, line, _CAPTION_PT, width, **look)

    def show(self, x: int, y: int, tile: GreyImage, *, marked: bool) -> None:
        """A picture, pixel by pixel, with a rim."""
        height, width = tile.shape
        left, bottom = x / DPI, (self._height - y - height) / DPI
        axes = add_axes(self._figure, (left, bottom, width / DPI, height / DPI))
        # In colours, which are drawn as they are: a colour map would round grey levels.
        coloured = np.repeat(tile[:, :, None], 3, axis=2)
        axes.imshow(coloured, aspect="auto", interpolation="nearest")
        axes.set_xticks([])
        axes.set_yticks([])
        for spine in axes.spines.values():
            spine.set_visible(True)
            spine.set_linewidth(2.2 if marked else 0.3)
            spine.set_color(VERMILION if marked else GREY)


def _tile(image: GreyImage, column: int) -> GreyImage:
    """A frame in the pixels of the figure, no wider than `column` px."""
    height, width = image.shape
    scale = min(column / width, _MAX_TILE / height)
    if scale >= 1.0:
        return image.repeat(int(scale), axis=0).repeat(int(scale), axis=1)
    # A line of pixels at least, of very long frames.
    size_wh = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _headings(sheet: ClipSheet) -> list[tuple[str, float]]:
    """Lines above the tiles, with their size in points: what the clip is, and how it ends."""
    height, width = sheet.stills[0].image.shape
    frames = "1 frame" if sheet.n_frames == 1 else f"{sheet.n_frames} frames"
    facts = (
        sheet.name,
        f"{width}×{height} px",
        f"{sheet.fps:g} frames/s",
        frames,
        f"seed {sheet.seed}",
    )
    title = (" · ".join(facts), _TITLE_PT)
    if not sheet.target:
        return [title]
    if sheet.collision_time_s is None:
        outcome = "no collision"
    else:
        frame = sheet.collision_frame
        where = "after the last frame" if frame is None else f"frame {frame}"
        outcome = f"collision at {sheet.collision_time_s:.3f} s, {where}"
    return [title, (f"target: {sheet.target} · {outcome}", _CAPTION_PT)]


def _caption(still: Still) -> list[str]:
    """What is true of a frame, as far as it is defined."""
    nearness = []
    if still.is_collision:
        nearness.append("collision frame")
    elif math.isfinite(still.time_to_contact_s):
        # Times that two decimals would make 0 have three.
        decimals = 2 if still.time_to_contact_s >= 0.1 else 3
        nearness.append(f"contact in {still.time_to_contact_s:.{decimals}f} s")
    if math.isfinite(still.angular_size_deg):
        nearness.append(f"{still.angular_size_deg:.1f}° across")
    lines = (f"frame {still.frame} · {still.time_s:.3f} s", still.phase, " · ".join(nearness))
    return [line for line in lines if line]


def _width_px(text: str, points: float) -> int:
    """How wide `text` is on the figure, in px."""
    return math.ceil(text_width_in(text, points) * _SLACK * DPI)
