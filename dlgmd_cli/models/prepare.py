"""Preparation of frames for the expansion: fills hidden cells, removes flicker."""

from collections import deque

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import Image
from dlgmd_cli.models.base import Flags, Grey

# Hidden cells are filled with the mean of the visible cells within 12 cells to each side.
_NEAR, _LEAST_CELLS = 12, 0.5
# Possible periods of mains flicker, in frames: 3 frames at 30 frames/s for 50 Hz, where the light
# flickers 100 times a second.
_PERIODS = (2, 3, 4, 5)
# An image flickers if its profile changes over a period by less than _SHARE of the change from
# frame to frame, which exceeds _LEAST_LEVELS grey levels. _NEWEST: weight in both running means.
_SHARE, _LEAST_LEVELS, _NEWEST = 0.6, 0.3, 0.1
# The largest correction of flicker, as a share of the brightness.
_MOST = 0.3


class Filling:
    """Fills the hidden cells of frames, (H, W), with the mean of the visible cells around them.

    Unfilled, a static mark or a dark border would distort the measured motion of the image.
    """

    def __init__(self, hidden: Flags) -> None:
        self._hidden, self._seen = hidden, np.float32(~hidden)
        self._weight = self._around(self._seen)

    def fill(self, frame: Grey) -> None:
        """Fill a frame in place."""
        seen = np.multiply(frame, self._seen, dtype=np.float32)
        mean = seen.sum() / self._seen.sum()
        near = self._around(seen) / (self._weight + 1e-9)
        filling = np.where(self._weight > _LEAST_CELLS, near, mean)
        filling = np.rint(filling) if frame.dtype == np.uint8 else filling
        np.copyto(frame, filling.astype(frame.dtype), where=self._hidden)

    def _around(self, image: Image) -> Image:
        side = 2 * _NEAR + 1
        return cv2.boxFilter(image, -1, (side, side), borderType=cv2.BORDER_CONSTANT)


class Flicker:
    """Removes the bands that mains light leaves in the rows of a rolling shutter.

    The gain of the light in a row is the row's mean, divided by the mean of the same row over a
    period of the flicker; the frame is divided by this gain. The correction acts only if the
    profile of row means is almost the same after a period, but changes from frame to frame. Motion,
    in contrast, changes the profile more over a longer time.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all earlier frames."""
        self._profiles: deque[npt.NDArray[np.float32]] = deque(maxlen=max(_PERIODS) + 1)
        self._changes = np.zeros(max(_PERIODS) + 1)
        self._n_changes = self.period = 0

    def of(self, frame: Grey) -> Grey:
        """A frame, (H, W), without flicker; the frame itself if there is none."""
        unit = 1.0 if frame.dtype == np.uint8 else 255.0
        profile = cv2.reduce(frame, 1, cv2.REDUCE_AVG, dtype=cv2.CV_32F).ravel() * unit
        self._profiles.append(profile)
        self._watch()
        if not self.period:
            return frame
        usual = np.mean(list(self._profiles)[-self.period :], axis=0)
        gain = (usual + 1.0) / (profile + 1.0)
        gain = np.clip(gain, 1.0 - _MOST, 1.0 + _MOST).astype(np.float32)[:, None]
        if frame.dtype == np.uint8:
            return np.clip(np.rint(frame * gain), 0, 255).astype(np.uint8)
        return np.clip(frame * gain, 0.0, 1.0)

    def _watch(self) -> None:
        """Find the period of the flicker, 0 if there is none."""
        newest, known = self._profiles[-1], list(self._profiles)
        if len(known) <= max(_PERIODS):
            return
        self._n_changes += 1
        for k in (1, *_PERIODS):
            change = cv2.norm(newest, known[-1 - k], cv2.NORM_L1) / newest.size
            self._changes[k] += max(_NEWEST, 1.0 / self._n_changes) * (change - self._changes[k])
        period = min(_PERIODS, key=lambda k: self._changes[k])
        is_clear = self._changes[period] < _SHARE * self._changes[1]
        is_clear = is_clear and self._n_changes >= max(_PERIODS)
        self.period = period if is_clear and self._changes[1] > _LEAST_LEVELS else 0
