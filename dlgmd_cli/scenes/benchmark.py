"""The sixteen basic videos of the LGMD benchmark (MingshuoXu/BiSTS), by its geometry.

They are 432x240, 30 frames/s, 50 frames, black on white (dark) or white on black (light). The
squares approach or recede at a constant speed. The speed of the other objects is such that twice as
many pixels change from frame to frame as do on average in the approach.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import Series
from dlgmd_cli.results.benchmark import REST

FPS, N_FRAMES = 30.0, 50
HEIGHT, WIDTH = 240, 432
# The depths of the square, in focal lengths, at the first frame and in the last ones, without
# motion; at depth 1, its side is the mean of the image's sides.
_FIRST_DEPTH, _LAST_DEPTH, _N_STILL = (WIDTH + HEIGHT) / 20, 1.5, 5
# Width of a bar over its step per frame; margin of a growing rectangle on either side.
_BAR_STEPS, _MARGIN = 1.2, 0.05

# Which pixels an object covers, shape (50, 240, 432); the same of one line, shape (50, length).
Masks = npt.NDArray[np.bool_]
Lines = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class BasicVideo:
    """A basic video: its class (a folder), its name, and its frames, (50, 240, 432) uint8.

    `truth` is 1 in each frame in which something approaches, else 0.5.
    """

    group: str
    name: str
    frames: npt.NDArray[np.uint8]
    truth: Series


def basic_videos() -> Iterator[BasicVideo]:
    """The basic videos, class by class."""
    looming = _looming()
    changing = 2.0 * _changing(looming)
    still, approach = np.full(N_FRAMES, REST), np.full(N_FRAMES, REST)
    approach[1 : N_FRAMES - _N_STILL + 1] = 1.0
    yield from _both("looming square", "looming", looming, approach)
    yield from _both("receding square", "receding", looming[::-1], still)
    ways = {"vertical": HEIGHT, "horizontal": WIDTH}
    for way, length in ways.items():
        bar = _masks(_bar(length, changing * HEIGHT), way, 0.0)
        yield from _both("translating bar", f"translating_{way}", bar, still)
    for way, length in ways.items():
        grown = _masks(_growing(length, 2.0 * changing * length / (1.0 - 2.0 * _MARGIN)), way)
        yield from _both("linear deformation", f"elongating_{way}", grown, still)
        yield from _both("linear deformation", f"shortening_{way}", grown[::-1], still)


def _both(group: str, name: str, masks: Masks, truth: Series) -> Iterator[BasicVideo]:
    """The dark and the light video of an object."""
    levels = np.where(masks, 255, 0).astype(np.uint8)
    yield BasicVideo(f"basic test/{group}", f"dark_{name}", 255 - levels, truth)
    yield BasicVideo(f"basic test/{group}", f"light_{name}", levels, truth)


def _looming() -> Masks:
    """A square in the middle that approaches, and is still in the last frames."""
    step = (_FIRST_DEPTH - _LAST_DEPTH) / (N_FRAMES - 1 - _N_STILL)
    masks = np.zeros((N_FRAMES, HEIGHT, WIDTH), np.bool_)
    y, x = HEIGHT // 2, WIDTH // 2
    for frame, mask in enumerate(masks):
        depth = _LAST_DEPTH if frame >= N_FRAMES - _N_STILL else _FIRST_DEPTH - step * frame
        half = round((WIDTH + HEIGHT) / 2 / depth) // 2
        mask[max(0, y - half) : y + half, max(0, x - half) : x + half] = True
    return masks


def _changing(masks: Masks) -> float:
    """The mean share of the pixels that change from frame to frame, where any do."""
    shares = np.mean(masks[1:] != masks[:-1], axis=(1, 2))
    return float(shares[shares > 0.0].mean())


def _bar(length: int, step: float) -> Lines:
    """A bar that crosses a line, with empty frames before and after."""
    lines = np.zeros((N_FRAMES, length), np.bool_)
    n_moving = min(N_FRAMES, int(length / step + 1))
    for k, line in enumerate(lines[(N_FRAMES - n_moving) // 2 :][:n_moving]):
        first = int(step * k)
        line[first : int(first + _BAR_STEPS * step)] = True
    return lines


def _growing(length: int, step: float) -> Lines:
    """A rectangle that grows from the first pixel of a line to the last, still before and after."""
    n_moving = min(N_FRAMES, len(np.arange(0.0, length + step, step)))
    before = (N_FRAMES - n_moving) // 2
    reached = step * np.clip(np.arange(N_FRAMES) - before, 0, n_moving - 1)
    until = np.clip(np.rint(reached), 1, length)
    until[before + n_moving :] = length
    return np.arange(length) < until[:, None]


def _masks(lines: Lines, way: str, margin: float = _MARGIN) -> Masks:
    """The pixels of an object that is as long as in its lines, with a margin on either side."""
    n_across = WIDTH if way == "vertical" else HEIGHT
    across = np.zeros(n_across, np.bool_)
    across[int(margin * n_across) : int((1.0 - margin) * n_across)] = True
    if way == "vertical":
        return lines[:, :, None] & across
    return lines[:, None, :] & across[:, None]
