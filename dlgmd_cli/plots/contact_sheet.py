"""A contact sheet: frames of a rendered clip, each with its ground truth below."""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import counted
from dlgmd_cli.plots import style
from dlgmd_cli.scenes.stimuli.clip import ContactSheet

_N_COLUMNS = 4
# Width of two columns of a paper; greatest height of a frame, so that 12 fit on a page; and
# approximate heights of the texts, which Matplotlib's layout corrects.
_WIDTH_IN, _MAX_TILE_IN, _CAPTION_IN, _TITLE_IN = style.width_in("two"), 2.2, 0.42, 0.36
_LONGEST_NAME, _LONGEST_PHASE = 48, 28


def plot_contact_sheet(sheet: ContactSheet, dpi: int = style.DPI) -> style.Figure:
    """Draw frames, four in a row, each with its number, time, phase and time to contact.

    The collision frame has a thick black rim and a bold caption. The figure is as wide as two
    columns of a paper; up to 12 frames fit on a page.
    """
    height, width = sheet.images[0].shape
    n_columns = min(_N_COLUMNS, len(sheet.images))
    n_rows = -(-len(sheet.images) // n_columns)
    tile_in = min(_WIDTH_IN / n_columns * height / width, _MAX_TILE_IN)
    with style.house_style():
        size_in = _WIDTH_IN, _TITLE_IN + n_rows * (tile_in + _CAPTION_IN)
        figure = style.Figure(figsize=size_in, dpi=style.DPI, layout="compressed")
        figure.suptitle(_title(sheet), x=0.01, ha="left", fontsize=8, parse_math=False)
        grid = figure.subplots(n_rows, n_columns, squeeze=False).flat
        for image, row, axes in zip(sheet.images, sheet.rows, grid, strict=False):
            is_collision = row.frame == sheet.record.get("collision_frame")
            rim = style.BLACK if is_collision else style.GREY
            axes.imshow(_thumbnail(image, dpi), cmap="gray", vmin=0, vmax=255)
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set(visible=True, color=rim, linewidth=2.5 if is_collision else 0.3)
            text = _caption(row, is_collision)
            label = axes.set_xlabel(text, loc="left", fontsize=6.5, color=rim, labelpad=2)
            label.set(parse_math=False, weight="bold" if is_collision else "normal")
        for axes in grid:
            axes.set_axis_off()
    return figure


def save_contact_sheet(sheet: ContactSheet, path: Path, dpi: int = style.DPI) -> None:
    """Draw a sheet as PNG; OSError passes through."""
    style.save_figure(plot_contact_sheet(sheet, dpi), path, dpi)


def _thumbnail(image: npt.NDArray[np.uint8], dpi: int) -> npt.NDArray[np.uint8]:
    """A frame, reduced by averaging if it has more pixels than its tile."""
    height, width = image.shape
    scale = max(width / (_WIDTH_IN / _N_COLUMNS), height / _MAX_TILE_IN) / dpi
    if scale <= 1.0:
        return image
    size_wh = max(1, round(width / scale)), max(1, round(height / scale))
    return np.asarray(cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA), np.uint8)


def _title(sheet: ContactSheet) -> str:
    """The facts about the clip, and for a flight its outcome."""
    height, width = sheet.images[0].shape
    title = (
        f"{style.shortened(sheet.name, _LONGEST_NAME)} · {width}×{height} px · "
        f"{sheet.options.fps:g} frames/s · {counted(sheet.n_frames, 'frame')} · "
        f"seed {sheet.options.seed}"
    )
    target, time_s = sheet.record.get("target"), sheet.record.get("collision_time_s")
    if target is None:
        return title
    outcome = "no collision"
    if time_s is not None:
        frame = sheet.record.get("collision_frame")
        where = "after the last frame" if frame is None else f"frame {frame}"
        outcome = f"collision at {time_s:.3f} s, {where}"
    return f"{title}\ntarget: {target} · {outcome}"


def _caption(row: Any, is_collision: bool) -> str:
    """The ground truth of a frame, as far as its scene defines it."""
    left_s = getattr(row, "time_to_contact_s", math.nan)
    angle_deg = getattr(row, "angular_size_deg", math.nan)
    nearness = []
    if is_collision:
        nearness.append("collision frame")
    elif math.isfinite(left_s):
        # Three decimals where two might round to 0.
        nearness.append(f"contact in {left_s:.{2 if left_s >= 0.1 else 3}f} s")
    if math.isfinite(angle_deg):
        nearness.append(f"{angle_deg:.1f}° across")
    phase = style.shortened(getattr(row, "phase", ""), _LONGEST_PHASE)
    lines = (f"frame {row.frame} · {row.time_s:.3f} s", phase, " · ".join(nearness))
    return "\n".join(line for line in lines if line)
