"""Health: whether images show what a model needs, and whether the expansion can be measured."""

import math

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.base import Flags, Grey
from dlgmd_cli.models.detection import ROUNDING_S

BLACK, FLAT, NOISE, FROZEN, UNMEASURED = "black", "flat", "noise", "frozen", "unmeasured"
# Seconds of bad images before they are reported, and of sound images before they count as sound.
BLIND_S, SOUND_S = 0.7, 0.5
# Means over 4 x 4 cells are judged; single cells if a side has fewer than four blocks.
_BLOCK, _N_LEAST = 4, 4
# In grey levels: upper limit of nine tenths of the means of a black image; least contrast.
_LIGHT, _CONTRAST = 4.0, 4.0
# An image is noise if two correlations are below 0.3: with the previous image, which is low where
# the image moves fast, too, and of neighbours in the image, which is low for noise alone.
_LIKENESS = 0.3
# An image is frozen if it changes by no more than 1.5 times the usual change from frame to frame
# (noise, in a frozen image) plus 0.25 grey levels.
_SAME, _SAME_LEVELS = 1.5, 0.25
# The share of a frozen image that must be frozen: a running clock covers less than 5 %.
_MOST = 0.95
# A usual change by more than this share of the contrast is not noise. Over more than 0.1 s from
# image to image, the share is less in proportion: motion changes more in this time, noise does not.
_SLIGHT, _SLIGHT_S = 0.08, 0.1
# The weight of the newest change in the usual change.
_NEWEST = 0.3
# The frame rate (frames/s) if no times are known.
_FPS = 30.0
# The expansion cannot be measured once its quality was below this for BLIND_S.
LEAST_MEASURED = 0.25


class Health:
    """Says whether the images of a camera show what a model needs, in constant memory.

    Means over 4 x 4 cells are judged, since noise hardly affects means, and by quantiles, so that
    a clock or a few lamps do not count. An image is

    - `black` if nine tenths of the means are below 4 grey levels of 255,
    - `flat` if the tenth and the ninetieth percentile differ by less than 4 levels,
    - `noise` if the correlation of the means with the means of the previous image, and of the means
      with their neighbours, is below 0.3,
    - `frozen` if 95 % of the means have changed since an earlier image by no more than 1.5 times
      the usual change from frame to frame plus 0.25 levels, and the usual change is below 0.08 of
      the range between the two percentiles, or below 0.008 / s of it for images s > 0.1 s apart.

    An image must be one of these for 0.7 s to be reported, and none for 0.5 s to be sound again. A
    camera at rest in front of a still scene counts as frozen.
    """

    def __init__(self) -> None:
        self._hidden: Flags | None = None
        self.reset()

    def reset(self) -> None:
        """Forget all earlier images."""
        self._before: npt.NDArray[np.float32] | None = None
        self._first: npt.NDArray[np.float32] | None = None
        self._first_s = self._bad_s = self._good_s = self._now_s = self._change = math.nan
        self._kind: str | None = None
        self._kind_s = math.nan
        self.reason: str | None = None

    def ignore(self, hidden: Flags | None) -> None:
        """Judge only blocks without a cell where `hidden`, (H, W), is True, from now on."""
        self._hidden = hidden
        self.reset()

    def step(self, grey: Grey, time_s: float | None = None) -> str | None:
        """Judge the next image, (H, W), float32 in 0..1 or uint8: the reason, None if sound.

        `time_s` is the image's time in seconds; without times, 30 images per second are assumed.
        """
        if time_s is None:
            time_s = 0.0 if math.isnan(self._now_s) else self._now_s + 1.0 / _FPS
        is_other = self._before is not None and self._shape != grey.shape
        if is_other or not time_s >= self._now_s:  # for example, the clock was set back
            self.reset()
        step_s, self._now_s = time_s - self._now_s, time_s
        suspected, since_s = self._suspected(self._means(grey), time_s, step_s)
        if suspected != self._kind:
            self._kind, self._kind_s = suspected, since_s
        if suspected is None:
            self._bad_s = math.nan
            self._good_s = time_s if math.isnan(self._good_s) else self._good_s
            if time_s - self._good_s >= SOUND_S:
                self.reason = None
        else:
            self._good_s = math.nan
            self._bad_s = since_s if math.isnan(self._bad_s) else self._bad_s
            # During a change from one reason to another, an image may look like a third reason.
            if time_s - (self._kind_s if self.reason else self._bad_s) >= BLIND_S:
                self.reason = suspected
        return self.reason

    def _means(self, grey: Grey) -> npt.NDArray[np.float32]:
        """Means over the visible blocks, in grey levels, (n,)."""
        self._shape = grey.shape
        height, width = grey.shape
        block = _BLOCK if min(height, width) >= _N_LEAST * _BLOCK else 1
        size_wh = width // block, height // block
        whole = grey[: size_wh[1] * block, : size_wh[0] * block]
        unit = 1.0 if grey.dtype == np.uint8 else 255.0
        means = cv2.resize(np.float32(whole), size_wh, interpolation=cv2.INTER_AREA) * unit
        if self._hidden is not None:
            hidden = self._hidden[: whole.shape[0], : whole.shape[1]].astype(np.float32)
            seen = cv2.resize(hidden, size_wh, interpolation=cv2.INTER_AREA) == 0.0
            means = means[seen] if seen.any() else means
        return means.ravel()

    def _suspected(
        self, now: npt.NDArray[np.float32], time_s: float, step_s: float
    ) -> tuple[str | None, float]:
        """The fault of an image, `step_s` after the previous one, and since when (s)."""
        before, self._before = self._before, now
        low, high = _quantile(now, 0.1), _quantile(now, 0.9)
        is_frozen, likeness = False, 1.0
        if before is not None and self._first is not None:
            change = _quantile(np.abs(now - before), _MOST)
            usual = change if math.isnan(self._change) else self._change
            self._change = usual + _NEWEST * (change - usual)
            since = _quantile(np.abs(now - self._first), _MOST)
            most = _SLIGHT * (high - low) * _SLIGHT_S / max(step_s, _SLIGHT_S)
            is_frozen = self._change < most and since <= _SAME * self._change + _SAME_LEVELS
            likeness = max(_correlation(now, before), _correlation(now[1:], now[:-1]))
        if not is_frozen:
            self._first, self._first_s = now, time_s
        if high < _LIGHT:
            return BLACK, time_s
        if high - low < _CONTRAST:
            return FLAT, time_s
        if likeness < _LIKENESS:
            return NOISE, time_s
        # Consecutive images are always alike; only a long run of like images is frozen.
        is_frozen = is_frozen and time_s - self._first_s >= BLIND_S
        return (FROZEN, self._first_s) if is_frozen else (None, time_s)


class Measuring:
    """Says whether the expansion cannot be measured, in constant memory.

    That is so once its quality has been below `least` for `lasts_s` (s), and until it is not. Gaps
    do not end this time, and a frame without a quality continues it: the first frames after a gap
    are too few to measure, and too short a time to be reported.
    """

    def __init__(self, least: float = LEAST_MEASURED, lasts_s: float = BLIND_S) -> None:
        self._least, self._lasts_s = least, lasts_s
        self.reset()

    def reset(self) -> None:
        """Forget all earlier frames."""
        self._low_s = self._now_s = math.nan

    def step(self, quality: float, time_s: float) -> bool:
        """Whether it cannot be measured at the next frame; without times, as `Health.step`."""
        if math.isnan(time_s):
            time_s = 0.0 if math.isnan(self._now_s) else self._now_s + 1.0 / _FPS
        self._now_s = time_s
        if quality >= self._least:
            self._low_s = math.nan
        elif not self._low_s <= time_s:  # also if the clock was set back
            self._low_s = time_s
        return time_s - self._low_s >= self._lasts_s - ROUNDING_S


def _quantile(values: npt.NDArray[np.float32], share: float) -> float:
    rank = min(int(share * values.size), values.size - 1)
    return float(np.partition(values, rank)[rank])


def _correlation(a: npt.NDArray[np.float32], b: npt.NDArray[np.float32]) -> float:
    a, b = a - a.mean(), b - b.mean()
    norm = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / norm if norm > 0.0 else 1.0
