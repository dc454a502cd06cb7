"""What every model looks at: the last frames, and how they change. Models may share it."""

import math
from collections import deque
from typing import Protocol

import cv2
import numpy as np

from dlgmd_cli.errors import FrameError
from dlgmd_cli.models.base import Grey
from dlgmd_cli.models.history import History, aligned

_TYPES = (np.dtype(np.float32), np.dtype(np.uint8))


class View(Protocol):
    """What a model sees of the input at one frame.

    Attributes
    ----------
    frame : int
        Number of the newest frame, counting from 0 at the beginning; -1 before it.
    current, previous : ndarray, shape (H, W), uint8 or float32
        The newest frame and the one before it; `previous` from frame 1 on.
    history : History
        P(t), P(t - 1), …, from frame 1 on.
    """

    @property
    def frame(self) -> int: ...

    @property
    def current(self) -> Grey: ...

    @property
    def previous(self) -> Grey: ...

    @property
    def history(self) -> History: ...

    def p_sum(self, delay: int) -> float:
        """ΣP(t - delay) in units of luminance, NaN where it is not defined."""
        ...


class Photoreceptors:
    """P(t) = |L(t) - L(t-1)|, [Zhao2023] Eq. (1), of as many frames as is asked for; a `View`.

    Parameters
    ----------
    depth : int
        How many P to keep, at least one.
    """

    current: Grey
    previous: Grey
    history: History

    def __init__(self, depth: int) -> None:
        self._depth = depth
        self.reset()

    def reset(self) -> None:
        """Forget every frame seen so far; the next one may have another size."""
        self.frame = -1
        self._p_sums: deque[float] = deque(maxlen=self._depth)

    def take(self, luminance: Grey) -> None:
        """Look at the next frame.

        Parameters
        ----------
        luminance : ndarray, shape (H, W), float32 or uint8
            Luminance in 0..1, or grey levels in 0..255 that stand for it. The array may be reused
            by the caller afterwards.

        Raises
        ------
        FrameError
            If the frame is neither a float32 nor a uint8 image, or not of the same size and type
            as the one before.
        """
        self._check(luminance)
        if self.frame < 0:
            self.current, self.previous = (
                aligned(luminance.shape, luminance.dtype) for _ in range(2)
            )
            self.history = History(self._depth, self.current)
        self.current, self.previous = self.previous, self.current
        np.copyto(self.current, luminance)
        self.frame += 1
        if self.frame > 0:
            p = self.history.advance()
            cv2.absdiff(self.current, self.previous, dst=p)
            self._p_sums.appendleft(cv2.sumElems(p)[0] * self.history.unit)

    def p_sum(self, delay: int) -> float:
        """ΣP(t - delay) in units of luminance, NaN where it is not defined."""
        return self._p_sums[delay] if delay < len(self._p_sums) else math.nan

    def _check(self, luminance: Grey) -> None:
        """Raise FrameError unless this can be the next frame."""
        if luminance.ndim != 2 or luminance.dtype not in _TYPES or luminance.size == 0:
            raise FrameError(
                "frame",
                f"{luminance.dtype} of shape {luminance.shape} is not a float32 or uint8 image "
                "(H, W)",
                "Give luminance in 0..1, for example gray.astype(np.float32) / 255.",
            )
        if self.frame < 0:
            return
        for name, given, before in (
            ("shape", luminance.shape, self.current.shape),
            ("type", luminance.dtype, self.current.dtype),
        ):
            if given != before:
                raise FrameError(
                    "frame",
                    f"its {name} {given} is not that of the frames before, {before}",
                    "Call reset() between videos.",
                )
