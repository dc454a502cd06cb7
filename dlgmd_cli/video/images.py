"""Images as an input: a folder, a printf pattern, a glob, or arrays."""

import glob
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Sequence, Sized
from pathlib import Path
from statistics import mode
from typing import Any

import cv2
import numpy as np

from dlgmd_cli.errors import SourceError, counted
from dlgmd_cli.frame import Image
from dlgmd_cli.machine.files import open_regular
from dlgmd_cli.video.base import (
    MAX_SIDE,
    PRINTF,
    TOO_LARGE,
    SourceInfo,
    Unreadable,
    is_pattern,
    is_video,
    openable,
)

SUFFIXES = (
    *(".bmp", ".dib", ".jp2", ".jpe", ".jpeg", ".jpg", ".pbm"),
    *(".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff", ".webp"),
)
_AS_STORED = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR
_NO_IMAGE = "cannot be read as an image"
# Images in a folder with videos are a sequence from this number on; fewer are thumbnails.
MIN_PICTURES = 8
# File names are numbered with holes if there is at most one hole per this number of images.
_IMAGES_PER_HOLE = 5


class _Series:
    """A sequence of images at a given frame rate; `_latest` is the latest image."""

    is_damaged = False
    takes_every_frame = True
    uses: tuple[str, ...] = ()

    def __init__(self, images: Iterable[Any], fps: float) -> None:
        self._images, self._fps, self._index = images, fps, 0
        self._latest: Any = None

    def stamps(self) -> Iterator[float]:
        """The time of each image in seconds."""
        for index, image in enumerate(self._images):
            self._index, self._latest = index, image
            yield index / self._fps

    def close(self) -> None:
        """Do nothing: no file is kept open, and an array belongs to the caller."""


class ImageDecoder(_Series):
    """Decodes a sequence of image files, at least one, at a given frame rate.

    Raises SourceError if the first image cannot be read.
    """

    kind = "opencv"

    def __init__(self, paths: list[Path], fps: float) -> None:
        super().__init__(paths, fps)
        if n_pages(paths[0]) > 1:
            hint = "Give one stack, or the folder to 'dlgmd batch'."
            raise SourceError(str(paths[0]), "is a stack of images, a video of its own", hint)
        try:
            first = read_image(paths[0])
        except Unreadable as error:
            hint = "Remove it from the sequence or convert it to PNG."
            if paths[0].suffix.lower() not in SUFFIXES:
                hint = "A pattern is for images; for several videos, use 'dlgmd batch'."
            raise SourceError(str(paths[0]), str(error), hint) from None
        kind = paths[0].suffix[1:].lower()
        self._places = numbered_places(paths)
        height, width = first.shape[:2]
        self.uses = of_depth(first)
        self.info = SourceInfo(width, height, fps, len(paths), codec=kind)

    def stamps(self) -> Iterator[float]:
        """The time of each image in seconds: images missing by their names leave gaps."""
        for place, _ in zip(self._places, super().stamps(), strict=True):
            yield place / self._fps

    def picture(self) -> tuple[Image, None]:
        """The image of the latest timestamp; raises Unreadable."""
        try:
            image = read_image(self._latest)
        except Unreadable as error:
            raise Unreadable(f"{self._latest.name} {error}") from None
        height, width = image.shape[:2]
        if (width, height) != self.info.size_wh:
            expected = f"{self.info.width}x{self.info.height}"
            raise Unreadable(f"{self._latest.name} is {width}x{height}, not {expected}")
        return image, None


def of_depth(image: Image) -> tuple[str, ...]:
    """The options for samples of this type: those of 16 bits may have fewer."""
    return ("bit_depth",) if image.dtype == np.uint16 else ()


def read_image(path: Path) -> Image:
    """The image at `path`: uint8 or uint16, grey or BGR, upright; raises Unreadable."""
    try:
        # `cv2.imread` cannot open every file name.
        with open_regular(path, "rb") as file:
            return image_of(file.read())
    except OSError:
        raise Unreadable(_NO_IMAGE) from None


def image_of(data: bytes | Image) -> Image:
    """The image in the bytes of an image file, see `read_image`; raises Unreadable."""
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), _AS_STORED)
    except cv2.error as error:  # OpenCV refuses no bytes, and the size that a header states
        is_large = "validateInputImageSize" in str(error)
        raise Unreadable(TOO_LARGE if is_large else _NO_IMAGE) from None
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise Unreadable(_NO_IMAGE)
    if max(image.shape) > MAX_SIDE:
        raise Unreadable(TOO_LARGE)
    return image


def pictures_at(path: Path) -> list[Path] | None:
    """The images of a folder or a pattern in natural order, at least one; None for a file.

    Raises SourceError if there are none, or the folder cannot be read.
    """
    if path.is_dir():
        try:
            paths = list(path.iterdir())
        except OSError as error:
            raise SourceError(str(path), f"cannot be read ({error.strerror})") from None
        n_videos = sum(is_video(file.name) and file.name[0] != "." for file in paths)
        paths = [file for file in paths if file.suffix.lower() in SUFFIXES and file.name[0] != "."]
        why = "there is no image in this folder"
        if n_videos and 0 < len(paths) < MIN_PICTURES:  # thumbnails
            what = f"{counted(n_videos, 'video')} and {counted(len(paths), 'image')}"
            paths, why = [], f"this folder holds {what}, too few for a sequence"
        hint = (
            "For the videos in a folder, use 'dlgmd batch'; this command takes one, or a folder of "
            "images such as PNG or JPEG."
        )
    elif is_pattern(str(path)) and not path.exists():
        globbed = glob.iglob(str(path), recursive=True)
        paths = _printf_matches(path) or [Path(name) for name in globbed]
        why = "no file matches this pattern"
        hint = "Quote it, and check the path before it."
    else:
        return None
    paths = [file for file in paths if file.is_file()]
    if not paths:
        raise SourceError(str(path), why, hint)
    return sorted(paths, key=_natural_key)


def numbered_places(paths: list[Path]) -> Sequence[int]:
    """The place of each image in a sequence that may lack images.

    The names have one number that grows by the same step, and by a multiple of the step after a
    hole. Images with other names, such as times or a selection, have the places 0, 1, 2 …
    """
    in_order, is_number = range(len(paths)), re.compile(r"(\d+)")
    parts = [is_number.split(str(path)) for path in paths]
    if len(set(map(len, parts))) > 1:
        return in_order
    columns = [column for column in zip(*parts, strict=True) if len(set(column)) > 1]
    if len(columns) != 1 or not columns[0][0].isdecimal():
        return in_order
    numbers = [int(text) for text in columns[0]]
    steps = [after - before for before, after in itertools.pairwise(numbers)]
    step = mode(steps)
    n_holes = sum(size != step for size in steps)
    if n_holes * _IMAGES_PER_HOLE > len(paths):
        return in_order
    if step < 1 or any(size % step or size < step for size in steps):
        return in_order
    return [(number - numbers[0]) // step for number in numbers]


def _natural_key(path: Path) -> list[tuple[int, int, str]]:
    """Sort key that puts frame2 before frame10."""
    parts = re.split(r"(\d+)", str(path))
    return [(1, int(part), part) if part.isdecimal() else (0, 0, part) for part in parts]


def _printf_matches(pattern: Path) -> list[Path]:
    """Files in the pattern's folder whose names match its one %d (or %04d)."""
    match = PRINTF.search(pattern.name)
    if match is None or not pattern.parent.is_dir():
        return []
    before, after = pattern.name[: match.start()], pattern.name[match.end() :]
    width = int(match[2] or 1) if match[1] else 1
    number = rf"\d{{{min(width, 99)},}}"
    name = re.escape(before.replace("%%", "%")) + number + re.escape(after.replace("%%", "%"))
    return [path for path in pattern.parent.iterdir() if re.fullmatch(name, path.name)]


NAME, SUFFIX = "array", ".npy"
# If the last axis of an array is shorter than the others by this factor, it counts frames.
_FAR_SHORTER = 3
_KINDS = "uint8, uint16, or float from 0 to 1, of shape (H, W) or (H, W, 3) in BGR"


class ArrayDecoder(_Series):
    """Yields images of one size, at least one, at a given frame rate, see `open_video`.

    `name` is for error messages, `codec` for `SourceInfo`. Raises SourceError if there is no image,
    or if an image has a wrong shape, type or value: at once for an array or list, else when the
    image is reached.
    """

    kind = NAME

    def __init__(
        self, images: Iterable[Any], fps: float, name: str = NAME, codec: str = NAME
    ) -> None:
        self._name, self._kind = name, ""
        shape = getattr(images, "shape", None)
        if shape is not None and (len(shape) not in (3, 4) or shape[2:] == (3,)):
            why = f"its array has the shape {tuple(shape)}"  # (H, W) would be a single image
            raise SourceError(name, why, "Frames have the shape (n, H, W) or (n, H, W, 3).")
        iterator = iter(images)
        first = next(iterator, None)
        if first is None:
            raise SourceError(name, "holds no frames", "An iterator can be read only once.")
        super().__init__(itertools.chain([first], iterator), fps)
        self._latest = first
        first = self._checked()
        (height, width), self.uses = first.shape[:2], of_depth(first)
        # All images of an integer array have one type: only lists and floats can go wrong later.
        is_whole = isinstance(images, list | tuple) or self._kind.startswith("float")
        if is_whole and isinstance(images, np.ndarray | list | tuple):
            for self._index, self._latest in enumerate(images):
                self._checked()
        n_frames = len(images) if isinstance(images, Sized) else None
        remark = _axes_remark(shape) if shape is not None else ""
        self.info: SourceInfo = SourceInfo(width, height, fps, n_frames, codec=codec, remark=remark)

    def picture(self) -> tuple[Image, None]:
        """The latest image; raises SourceError if its shape, type or values are wrong."""
        return self._checked(), None

    def _checked(self) -> Image:
        """The latest image as uint8, uint16 or float32; raises SourceError."""
        image = np.asarray(self._latest)
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
                if not (math.isfinite(low) and math.isfinite(high)):
                    why = f"frame {self._index} holds a number that is not finite (NaN or infinity)"
                raise SourceError(self._name, why, f"Give {_KINDS}.")
            image = image.astype(np.float32, copy=False)
        return image


def _axes_remark(shape: tuple[int, ...]) -> str:
    """A line about an array, read as (n, H, W), that looks like (H, W, n); else empty."""
    if len(shape) != 3 or shape[2] * _FAR_SHORTER > min(shape[:2]):
        return ""
    n_frames, height, width = shape
    what = f"its array {tuple(shape)} is read as {n_frames} frames of {width}x{height} px"
    return f"{what}; if the last axis counts the frames, give np.moveaxis(array, -1, 0)"


TIFF = (".tif", ".tiff")
# Bytes that are read at a time: each reading goes through all pages before, for 0.2 ms each.
_BYTES_AT_ONCE = 1 << 27


def n_pages(path: Path) -> int:
    """The number of images in a file, above 1 for a TIFF stack; 0 if it cannot be read."""
    if path.suffix.lower() not in TIFF:
        return 1
    with openable(path.absolute()) as name:
        return cv2.imcount(name, cv2.IMREAD_UNCHANGED)


class TiffPages:
    """The images of a TIFF file of one or more pages; raises SourceError if it cannot be read.

    Floating-point pages have levels from 0 to 1.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._n_pages = path, n_pages(path)
        if not self._n_pages:
            raise SourceError(str(path), "cannot be read as a TIFF file")

    def __len__(self) -> int:
        return self._n_pages

    def __iter__(self) -> Iterator[Image]:
        first, n_pages = 0, 1
        while first < self._n_pages:
            with openable(self._path.absolute()) as name:
                _, pages = cv2.imreadmulti(name, first, n_pages, flags=_AS_STORED)
            yield from pages
            if len(pages) < n_pages:
                raise SourceError(str(self._path), f"page {first + len(pages)} cannot be read")
            first += n_pages
            n_pages = min(max(1, _BYTES_AT_ONCE // pages[0].nbytes), self._n_pages - first)


def load_array(path: Path) -> Image:
    """The array in a .npy file, mapped into memory, not read; raises SourceError."""
    try:
        array: Image = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(array, np.ndarray):  # a .npz file with the suffix .npy
            array.close()
            raise ValueError
    except Exception as error:  # a damaged header may also raise errors of Python's parser
        reason = getattr(error, "strerror", None) or "not an array of numbers in NumPy's format"
        raise SourceError(str(path), f"cannot be read ({reason})") from None
    return array
