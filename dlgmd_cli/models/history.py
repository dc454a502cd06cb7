"""The last outputs of the photoreceptors, in memory of their own."""

import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.base import Grey

CACHE_LINE = 64


def aligned(shape: tuple[int, ...], dtype: npt.DTypeLike = np.float32) -> Grey:
    """An uninitialised array whose memory starts at a cache line.

    OpenCV adds up in an order that depends on alignment: without it the last bit of a sum would
    change from run to run.
    """
    n_bytes = int(np.prod(shape)) * np.dtype(dtype).itemsize
    memory = np.empty(n_bytes + CACHE_LINE, np.uint8)
    start = -memory.ctypes.data % CACHE_LINE
    return memory[start : start + n_bytes].view(dtype).reshape(shape)


class History:
    """P(t), P(t - 1), … of as many frames as a model looks back.

    Attributes
    ----------
    stack : ndarray, shape (depth, H, W), uint8 or float32
        The images, in levels of 0..255 or of 0..1; the newest goes in place of the oldest.

    Parameters
    ----------
    depth : int
        Frames to keep.
    frame : ndarray, shape (H, W)
        One of the size and type of those that will come.
    """

    def __init__(self, depth: int, frame: Grey) -> None:
        self.stack = aligned((depth, *frame.shape), frame.dtype)
        self._newest = 0

    @classmethod
    def of(cls, stack: Grey) -> "History":
        """A history on images that are there already, (n, H, W), in the order of time."""
        history = cls.__new__(cls)
        history.stack, history._newest = stack, 0
        return history

    def go_to(self, position: int) -> None:
        """Let the image at `position` of the stack be the newest."""
        self._newest = position

    @property
    def unit(self) -> float:
        """What one level counts in luminance."""
        return 1.0 / 255.0 if self.stack.dtype == np.uint8 else 1.0

    def advance(self) -> Grey:
        """The oldest image, to be written over: P(t) of the next frame."""
        self._newest = (self._newest + 1) % len(self.stack)
        return self[0]

    def position(self, delay: int) -> int:
        """Index into `stack` of P(t - delay)."""
        return (self._newest - delay) % len(self.stack)

    def __getitem__(self, delay: int) -> Grey:
        return self.stack[self.position(delay)]
