"""Arrays and other iterables of images as an input, also from a .npy file."""

import itertools
from collections.abc import Iterable, Iterator, Sized
from pathlib import Path
from typing import Any

import numpy as np

from dlgmd_cli.errors import SourceError
from dlgmd_cli.frame import Image
from dlgmd_cli.video.base import StreamInfo, Unreadable

NAME, SUFFIX = "array", ".npy"
_KINDS = "uint8, uint16, or float from 0 to 1, of shape (H, W) or (H, W, 3) in BGR"


class ArrayDecoder:
    """Yields images of one size, at least one, at a given frame rate, see `open_video`.

    `name` is for error messages. Raises SourceError if there is no image, or the first one is none.
    """

    kind = NAME
    is_damaged = False
    takes_every_frame = True

    def __init__(self, images: Iterable[Any], fps: float, name: str = NAME) -> None:
        self._fps, self._name, self._index = fps, name, 0
        shape = getattr(images, "shape", None)
        if shape is not None and (len(shape) not in (3, 4) or shape[2:] == (3,)):
            why = f"its array has the shape {tuple(shape)}"  # the last one is of a single image
            raise SourceError(name, why, "Frames have the shape (n, H, W) or (n, H, W, 3).")
        iterator = iter(images)
        self._image = next(iterator, None)
        if self._image is None:
            raise SourceError(name, "holds no frames", "An iterator can be read only once.")
        self._images = itertools.chain([self._image], iterator)
        self._kind = ""
        image = self._checked()
        n_frames = len(images) if isinstance(images, Sized) else None
        height, width = image.shape[:2]
        self.stream_info: StreamInfo = StreamInfo(width, height, fps, n_frames, codec=NAME)

    def stamps(self) -> Iterator[float]:
        """The time of each image in seconds."""
        for index, image in enumerate(self._images):
            self._index, self._image = index, image
            yield index / self._fps

    def picture(self) -> tuple[Image, None]:
        """The latest image; raises Unreadable if it is not like the first one."""
        try:
            return self._checked(), None
        except SourceError as error:
            raise Unreadable(error.why) from None

    def _checked(self) -> Image:
        """The latest image as uint8, uint16 or float32; raises SourceError."""
        image = np.asarray(self._image)
        kind = f"{image.dtype} of shape {image.shape}"
        is_picture = image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)
        is_float = image.dtype.kind == "f"
        is_known = is_float or image.dtype in (np.uint8, np.uint16)
        if not (is_picture and is_known and image.size):
            raise SourceError(self._name, f"frame {self._index} is {kind}", f"Give {_KINDS}.")
        self._kind = self._kind or kind
        if kind != self._kind:
            raise SourceError(self._name, f"frame {self._index} is {kind}, not {self._kind}")
        if is_float:
            low, high = float(image.min()), float(image.max())
            if not 0.0 <= low <= high <= 1.0:
                why = f"frame {self._index} holds numbers from {low:g} to {high:g}"
                raise SourceError(self._name, why, f"Give {_KINDS}.")
            image = image.astype(np.float32, copy=False)
        return image

    def close(self) -> None:
        """Do nothing: the array is the caller's."""


def load_array(path: Path) -> Image:
    """The array in a .npy file, mapped into memory, not read; raises SourceError."""
    try:
        array: Image = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(array, np.ndarray):  # a .npz under another name
            array.close()
            raise ValueError
    except Exception as error:  # of a damaged header, also those of Python's parser
        reason = getattr(error, "strerror", None) or "not an array of numbers in NumPy's format"
        raise SourceError(str(path), f"cannot be read ({reason})") from None
    return array
