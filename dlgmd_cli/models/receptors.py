"""The photoreceptors of all models: the change from frame to frame, and its history."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import FrameError, ModelError
from dlgmd_cli.frame import Flags, FloatImage

Grey = npt.NDArray[Any]  # uint8 levels of 0..255, or float32 in 0..1

CACHE_LINE = 64
_TYPES = (np.dtype(np.float32), np.dtype(np.uint8))


def aligned(shape: tuple[int, ...], dtype: npt.DTypeLike = np.float32) -> Grey:
    """An uninitialised array that is aligned to a cache line.

    OpenCV's order of summation depends on the alignment. Without it, the last bit of a sum would
    differ from run to run.
    """
    n_bytes = math.prod(shape) * np.dtype(dtype).itemsize
    memory = np.empty(n_bytes + CACHE_LINE, np.uint8)
    # Ten times as fast as `ctypes.data`.
    start = -memory.__array_interface__["data"][0] % CACHE_LINE
    return memory[start : start + n_bytes].view(dtype).reshape(shape)


def unit_of(dtype: npt.DTypeLike) -> float:
    """Luminance of one unit of an image, by its type."""
    return 1.0 / 255.0 if dtype == np.uint8 else 1.0


def checked_layer(
    values: npt.ArrayLike, given: Iterable[Grey], method: str, out: FloatImage | None = None
) -> FloatImage:
    """A copy of the layer, (H, W), that a model's method computed from the `given` layers.

    Raises ModelError if the layer is not an array of real numbers of the given shape, or contains a
    number that is not finite although the given layers are finite.
    """
    array, given = np.asarray(values), list(given)
    shape = given[0].shape
    if array.shape != shape or not np.can_cast(array.dtype, np.float32, "same_kind"):
        why = f"it returns {array.dtype} of shape {array.shape}, not float32 of shape {shape}"
        raise ModelError(f"{method}()", why)
    layer = aligned(shape) if out is None else out
    np.copyto(layer, array, casting="same_kind")
    if not is_finite(layer) and all(map(is_finite, given)):
        why = "some of what it returns is infinite or not a number"
        raise ModelError(f"{method}()", why, "Look for a division by 0.")
    return layer


def is_finite(image: Grey) -> bool:
    """Whether an image has neither a NaN nor an infinity."""
    return math.isfinite(cv2.sumElems(image)[0])


def read_only(image: Grey) -> Grey:
    """A view of an image that a custom model cannot change."""
    view = image.view()
    view.flags.writeable = False
    return view


class Pathway:
    """The last P of one pathway: ``p(0)`` is P(t), ``p(1)`` is P(t-1), and so on.

    Parameters
    ----------
    depth : int
        Number of P to keep.
    shape : (int, int)
        H and W.
    dtype
        Type of P, uint8 or float32.

    Attributes
    ----------
    stack : ndarray, shape (depth, H, W)
        Ring buffer of P.
    """

    def __init__(self, depth: int, shape: tuple[int, ...], dtype: npt.DTypeLike) -> None:
        self.stack = aligned((depth, *shape), dtype)
        self._n_taken = 0

    def __call__(self, delay: int) -> Grey:
        """P(t - delay), shape (H, W), a read-only view: float32 luminance, or uint8 0..255.

        Raises ModelError if this P is not kept, or is before the first frame that has a P.
        """
        return read_only(self.stack[self.position(delay)])

    def position(self, delay: int) -> int:
        """Index into `stack` of P(t - delay); raises ModelError if this P is not kept."""
        depth = len(self.stack)
        if 0 <= delay < min(self._n_taken, depth):
            return (self._n_taken - 1 - delay) % depth
        if 0 <= delay < depth:
            raise ModelError(f"P(t-{delay})", f"there are only {self._n_taken} so far")
        hint = "A model keeps as many P as its connections or its first_valid_frame need."
        raise ModelError(f"P(t-{delay})", f"the last {depth} are kept, from P(t) on", hint)

    def next(self) -> Grey:
        """The image for P of the next frame, which becomes P(t) and overwrites the oldest P."""
        self._n_taken += 1
        return self.stack[self.position(0)]


# The input of a pathway: L(t) - L(t-1) of all cells, of brightening cells, or of darkening cells.
BOTH, ON, OFF = "both", "on", "off"


def rectified(change: FloatImage, polarity: str) -> FloatImage:
    """P(t) of a pathway from L(t) - L(t-1), (H, W) float32: the magnitude, or that of one sign."""
    if polarity == BOTH:
        return np.abs(change)
    return np.maximum(change if polarity == ON else -change, 0.0)


def rectify(now: Grey, before: Grey, polarity: str, out: Grey) -> None:
    """Write P(t) of a pathway to `out`, in the type of the two frames; see `rectified`."""
    if polarity == BOTH:
        cv2.absdiff(now, before, dst=out)
        return
    more, less = (now, before) if polarity == ON else (before, now)
    cv2.subtract(more, less, dst=out)  # for 8 bits, OpenCV limits negative differences to 0
    if out.dtype == np.float32:
        cv2.threshold(out, 0.0, 0.0, cv2.THRESH_TOZERO, dst=out)


class Photoreceptors:
    """``P(t) = |L(t) - L(t-1)|``, [Zhao2023] Eq. (1), of the last few frames.

    Parameters
    ----------
    depth : int
        Number of P to keep; 0 for a model that uses the frames only.
    polarities : tuple of str
        Input of each pathway: ``"both"``, ``"on"`` or ``"off"``, see `DLGMD.polarities`.

    Attributes
    ----------
    depth : int
        Number of P to keep; a new value takes effect at the next first frame.
    frame : int
        Number of the newest frame, from 0; -1 before the first frame.
    current, previous : ndarray, shape (H, W), uint8 or float32
        The newest frame and, from frame 1 on, the previous one.
    pathways : list of Pathway
        The history of P, from frame 1 on. P of the model is the sum of the pathways' P.
    hidden : ndarray, shape (H, W), bool, or None
        True for ignored cells, see `Model.ignore`.
    """

    current: Grey
    previous: Grey
    hidden: Flags | None = None
    _n_hidden = 0

    def __init__(self, depth: int, polarities: tuple[str, ...] = (BOTH,)) -> None:
        if isinstance(polarities, str) or not {*polarities} <= {BOTH, ON, OFF}:
            why = f"{polarities!r} is no tuple of {BOTH!r}, {ON!r} and {OFF!r}"
            raise ModelError("polarities", why)
        self.depth, self.polarities = depth, polarities
        self.reset()

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        self.frame = -1
        self.pathways: list[Pathway] = []
        self._p_sums: list[float] = []

    def hide(self, hidden: Flags | None) -> None:
        """Ignore the cells where `hidden` is True, see `Model.ignore`."""
        self.hidden = None if hidden is None else np.ascontiguousarray(hidden, np.bool_)
        self._n_hidden = 0 if hidden is None else int(np.count_nonzero(hidden))

    @property
    def n_cells(self) -> int:
        """Number of cells of the newest frame that are not hidden."""
        return self.current.size - self._n_hidden

    def clear(self, image: Grey) -> None:
        """Set the hidden cells of an image, (H, W), to 0."""
        if self.hidden is not None:
            image[self.hidden] = 0

    def take(self, luminance: Grey) -> None:
        """Store the next frame and compute its P; raises FrameError as `Model.step` does."""
        self.look(luminance)
        if self.frame == 0 or self.depth == 0:
            return
        self._need_pathways(len(self.polarities), luminance.dtype)
        total = 0.0
        for pathway, polarity in zip(self.pathways, self.polarities, strict=True):
            p = pathway.next()
            rectify(self.current, self.previous, polarity, out=p)
            total += cv2.sumElems(p)[0]
        self._remember(total * self.unit)

    def look(self, luminance: Grey) -> None:
        """Store the next frame without its P, which `keep` stores; raises as `take` does."""
        self.check(luminance)
        shape, dtype = luminance.shape, luminance.dtype
        if self.frame >= 0 and (shape, dtype) != (self.current.shape, self.current.dtype):
            before = f"{self.current.dtype} of shape {self.current.shape}"
            why = f"{dtype} of shape {shape}, but the frames before are {before}"
            raise FrameError("frame", why, "Call reset() between videos.")
        if self.frame < 0:
            self.current, self.previous = aligned(shape, dtype), aligned(shape, dtype)
            self._change = aligned(shape)
        self.current, self.previous = self.previous, self.current
        np.copyto(self.current, luminance)
        self.clear(self.current)
        self.frame += 1

    def luminance_of(self, frame: Grey) -> FloatImage:
        """A frame in luminance, (H, W) float32, hidden cells at 0; raises FrameError."""
        self.check(frame)
        unit = np.float32(unit_of(frame.dtype))
        luminance = np.multiply(frame, unit, out=aligned(frame.shape), dtype=np.float32)
        self.clear(luminance)
        return luminance

    def levels(self) -> FloatImage:
        """The newest frame in grey levels, 0..255, a new array of shape (H, W), float32."""
        scale = np.float32(1.0 if self.current.dtype == np.uint8 else 255.0)
        return np.multiply(self.current, scale, out=aligned(self.current.shape), dtype=np.float32)

    def level_change(self) -> FloatImage:
        """L(t) - L(t-1) in grey levels, -255..255, a new array, (H, W) float32; 0 at frame 0."""
        change = aligned(self.current.shape)
        if self.frame == 0:
            change[:] = 0.0
            return change
        cv2.subtract(self.current, self.previous, dst=change, dtype=cv2.CV_32F)
        if self.current.dtype == np.float32:
            change *= np.float32(255.0)
        return change

    def change(self) -> FloatImage:
        """L(t) - L(t-1) of the newest frame in luminance, (H, W) float32, rounded once.

        The next frame overwrites the array.
        """
        cv2.subtract(self.current, self.previous, dst=self._change, dtype=cv2.CV_32F)
        if self.current.dtype == np.uint8:
            self._change *= np.float32(unit_of(np.uint8))
        return self._change

    def keep(self, images: Sequence[npt.ArrayLike]) -> None:
        """Store P of the newest frame, one image in luminance for each pathway.

        Raises ModelError if an image has another shape than the frames, or their number changes.
        """
        self._need_pathways(len(images), np.float32)
        p_sum = 0.0
        for pathway, image in zip(self.pathways, images, strict=True):
            p = pathway.next()
            checked_layer(image, (self.current, self.previous), "perceive", out=p)
            self.clear(p)
            p_sum += cv2.norm(p, cv2.NORM_L1)
        self._remember(p_sum)

    def _need_pathways(self, number: int, dtype: npt.DTypeLike) -> None:
        """Create the pathways at the first P; raises ModelError if their number changes."""
        if number == 0:
            raise ModelError("perceive()", "it returns no P")
        if not self.pathways:
            shape = self.current.shape
            self.pathways = [Pathway(self.depth, shape, dtype) for _ in range(number)]
        if len(self.pathways) != number:
            why = f"it returns {number} P, and returned {len(self.pathways)} before"
            raise ModelError("perceive()", why)

    def _remember(self, p_sum: float) -> None:
        self._p_sums = [p_sum, *self._p_sums[: self.depth - 1]]

    @property
    def unit(self) -> float:
        """Luminance of one unit of P, or of one unit of the frames while there is no P."""
        if self.frame < 0:
            hint = "Call self.receptors.take(luminance) first."
            raise ModelError("self.receptors.unit", "no frame was taken yet", hint)
        kept = self.pathways[0].stack if self.pathways else self.current
        return unit_of(kept.dtype)

    def p(self, delay: int) -> Grey:
        """P(t - delay), (H, W), the sum of all pathways in units of `unit`; may be a view.

        Raises ModelError if this P is not kept.
        """
        if not self.pathways:
            raise ModelError(f"P(t-{delay})", "P is not defined before the second frame")
        first, *others = (pathway(delay) for pathway in self.pathways)
        for other in others:
            first = first + other
        return first

    def layer(self) -> FloatImage:
        """A copy of P(t) in luminance."""
        return self.p(0).astype(np.float32) * np.float32(self.unit)

    def p_sum(self, delay: int) -> float:
        """Σ|P(t - delay)| in luminance; NaN if not defined yet. Raises ModelError if not kept."""
        if not 0 <= delay < self.depth:
            raise ModelError(f"P(t-{delay})", f"the sums of {self.depth} P are kept")
        return self._p_sums[delay] if delay < len(self._p_sums) else math.nan

    def check(self, frame: Grey) -> None:
        """Raise FrameError if `frame` is not a valid frame, see `Model.step`."""
        shape, kind = frame.shape, frame.dtype
        if frame.ndim != 2 or kind not in _TYPES or frame.size == 0:
            why = f"{kind} of shape {shape} is not a float32 or uint8 image (H, W)"
            hint = "Give luminance in 0..1: for 12 bits, gray.astype(np.float32) / 4095."
            raise FrameError("frame", why, hint)
        if self.hidden is not None and self.hidden.shape != shape:
            why = f"the cells to ignore are {self.hidden.shape}, the frame is {shape}"
            raise FrameError("frame", why, "Give both in the same shape.")
