"""A film of the input at full size, with active cells tinted and alarms as a banner."""

import math
from typing import Any

import cv2
import numpy as np

from dlgmd_cli.plots.heat import BgrImage, FloatImage, strongest
from dlgmd_cli.results.result import Result

# Orange as for spikes, vermilion as for alarms; BGR.
_TINT, _ALARM, _WHITE, _BLACK = (0, 0x9F, 0xE6), (0, 0x5E, 0xD5), (255, 255, 255), (0, 0, 0)
# Opacity of the weakest active cell, and what the strongest cell has in addition.
_LEAST, _MORE = 0.45, 0.4
# Heights of banner and letters as shares of the picture's; letters of OpenCV's font at scale 1.
_BANNER, _LETTER, _LETTER_PX = 0.09, 0.05, 22
# Radius of the ring around the centroid, as a share of the picture's height.
_RING = 0.035


def tinted(image: BgrImage, g: FloatImage | None, greatest: float) -> BgrImage:
    """Tint the active cells of G orange in a picture, (H, W, 3) BGR.

    `g` may have any size; it is None where undefined. `greatest` is the greatest magnitude of G
    over all frames.
    """
    if g is None or not g.any():
        return image
    height, width = image.shape[:2]
    g = strongest(g, height, width)
    strength = np.abs(g) / np.float32(greatest)
    opacity = np.where(g != 0.0, _LEAST + _MORE * np.minimum(strength, 1.0), 0.0)
    cells = cv2.resize(opacity, (width, height), interpolation=cv2.INTER_NEAREST)[:, :, None]
    return np.rint(image * (1.0 - cells) + np.array(_TINT, np.float32) * cells).astype(np.uint8)


def mark_centroid(picture: BgrImage, g_x: float, g_y: float) -> None:
    """Draw a ring around the centroid of G, -1 to 1, into a picture, (H, W, 3) BGR.

    The centroid is NaN if no cell is active; then nothing is drawn.
    """
    if math.isnan(g_x) or math.isnan(g_y):
        return
    height, width = picture.shape[:2]
    at = round((g_x + 1.0) / 2.0 * width - 0.5), round((g_y + 1.0) / 2.0 * height - 0.5)
    radius = max(3, round(_RING * height))
    thick = max(1, radius // 6)
    for colour, extra in ((_BLACK, 2), (_WHITE, 0)):
        cv2.circle(picture, at, radius, colour, thick + extra, cv2.LINE_AA)


class Overlay:
    """Draws the pictures of the film.

    `shape` is (H, W) of the input in px; the film's is rounded up to even numbers. `greatest` is
    the greatest magnitude of G over all frames.
    """

    def __init__(self, result: Result, shape: tuple[int, int], greatest: float) -> None:
        self._result, self._greatest, self._alarmed = result, greatest or 1.0, result.alarmed
        height, width = shape
        self.shape = height + height % 2, width + width % 2

    def picture(self, row: int, image: BgrImage, g: FloatImage | None) -> BgrImage:
        """The picture of one row of the result, (H, W, 3) BGR.

        `image` is the input, (H, W, 3) BGR, and `g` the layer, of any size, None where undefined.
        """
        height, width = self.shape
        down, right = height - image.shape[0], width - image.shape[1]
        picture: Any = cv2.copyMakeBorder(image, 0, down, 0, right, cv2.BORDER_REPLICATE)
        picture[: image.shape[0], : image.shape[1]] = tinted(image, g, self._greatest)
        result, margin = self._result, round(0.02 * height)
        mark_centroid(picture[: image.shape[0], : image.shape[1]], result.g_x[row], result.g_y[row])
        if self._alarmed[row]:
            band = round(_BANNER * height)
            cv2.rectangle(picture, (0, 0), (width, band), _ALARM, cv2.FILLED)
            self._write(picture, "ALARM", (None, (band + self._letter_px) // 2), _ALARM)
        text = f"frame {result.frame[row]}  {result.time_s[row]:.3f} s"
        self._write(picture, text, (margin, height - margin), _BLACK)
        return np.asarray(picture, np.uint8)

    @property
    def _letter_px(self) -> int:
        return max(1, round(_LETTER * self.shape[0]))

    def _write(
        self, picture: BgrImage, text: str, place: tuple[int | None, int], rim: tuple[int, int, int]
    ) -> None:
        """Write white letters with a rim, starting at `place`, or centred if it has no x."""
        scale = self._letter_px / _LETTER_PX
        thick = max(1, round(1.5 * scale))
        look: Any = {"fontFace": cv2.FONT_HERSHEY_SIMPLEX, "fontScale": scale}
        x, y = place
        if x is None:
            (width, _), _ = cv2.getTextSize(text, **look, thickness=thick)
            x = (picture.shape[1] - width) // 2
        for color, extra in ((rim, 2), (_WHITE, 0)):
            at: Any = {"org": (x, y), "color": color, "thickness": thick + extra * thick}
            cv2.putText(picture, text, lineType=cv2.LINE_AA, **at, **look)
