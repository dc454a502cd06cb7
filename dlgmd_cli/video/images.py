"""Images as an input: a folder, a printf pattern, a glob, or arrays."""

import glob
import itertools
import math
import os
import re
from collections.abc import Iterable, Iterator, Sequence, Sized
from dataclasses import replace
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
)

SUFFIXES = (
    *(".bmp", ".dib", ".jp2", ".jpe", ".jpeg", ".jpg", ".pbm"),
    *(".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff", ".webp"),
)
AS_STORED = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR
_NUMBER = re.compile(r"(\d+)")
# A number after one of these words is that of a camera, a channel or a plane, not of a frame.
_CAMERA = re.compile(r"(?i)(?<![a-z])(c|cam|camera|ch|channel|eye|lens|sensor|view|z)[ _-]?$")
_NO_IMAGE = "cannot be read as an image"
# Images in a folder with videos are a sequence from this number on; fewer are thumbnails.
MIN_PICTURES = 8
# File names are numbered with holes if there is at most one hole per this number of images.
_IMAGES_PER_HOLE = 5


class _Series:
    """A sequence of images at a given frame rate; `_latest` is the latest image."""

    is_damaged = False
    takes_every_frame = True

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
        _require_one_camera(paths)
        try:
            first = read_image(paths[0])
        except Unreadable as error:
            hint = "Remove it from the sequence or convert it to PNG."
            if paths[0].suffix.lower() not in SUFFIXES:
                hint = "A pattern is for images; for several videos, use 'dlgmd batch'."
            raise SourceError(str(paths[0]), str(error), hint) from None
        kind = paths[0].suffix[1:].lower()
        self._places = numbered_places(paths)
        self.info = info_of(first, None, len(paths), kind)

    def stamps(self) -> Iterator[float]:
        """The time of each image in seconds: images missing by their names leave gaps."""
        for place, _ in zip(self._places, super().stamps(), strict=True):
            yield place / self._fps

    def picture(self) -> Image:
        """The image of the latest timestamp; raises Unreadable."""
        try:
            image = read_image(self._latest)
        except Unreadable as error:
            raise Unreadable(f"{self._latest.name} {error}") from None
        require_like(image, self.info, self._latest.name)
        return image


def info_of(first: Image, fps: float | None, n_frames: int | None, codec: str) -> SourceInfo:
    """The description of images like the first one, whose samples use all bits of their type."""
    height, width = first.shape[:2]
    bits = 8 * first.itemsize
    levels = (0, 1) if first.dtype.kind == "f" else (0, (1 << bits) - 1)
    return SourceInfo(width, height, fps, n_frames, codec, bits=bits, levels=levels)


def require_like(image: Image, info: SourceInfo, name: str) -> None:
    """Raise Unreadable if an image has another size or other bits than the first one."""
    (height, width), bits = image.shape[:2], 8 * image.itemsize
    if (width, height) != info.size_wh:
        raise Unreadable(f"{name} is {width}x{height}, not {info.width}x{info.height}")
    if bits != info.bits:
        raise Unreadable(f"{name} has {bits} bits, not {info.bits}")


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
        image = cv2.imdecode(np.frombuffer(data, np.uint8), AS_STORED)
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
    in_order = range(len(paths))
    parts = [_NUMBER.split(str(path)) for path in paths]
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


def _require_one_camera(paths: list[Path]) -> None:
    """Raise SourceError if the names are those of several cameras, channels or the like.

    Names of two cameras differ by more than numbers, or by a number after a word such as `cam`, and
    most of their other numbers are the same. Of times such as 0.25, the seconds are compared.
    Beside numbered images, an image without a number is none of them, such as `mask.png`.
    """
    folder = Path(os.path.commonpath([path.parent for path in paths]))
    names, patterns = dict[str, list[list[str]]](), dict[str, str]()
    for path in paths:
        parts = _NUMBER.split(str(path.relative_to(folder)))
        counts = [at for at in range(1, len(parts), 2) if not _CAMERA.search(parts[at - 1])]
        numbers = [parts[at] for at in counts if parts[at - 1] != "." or at - 2 not in counts]
        name = "".join("*" if at in counts else part for at, part in enumerate(parts))
        series = name.replace("*.*", "*")
        names.setdefault(series, []).append(numbers)
        # In a pattern, %d stands for digits only.
        patterns[series] = name.replace("*", "%d") if len(counts) == 1 else name
    frames = {}
    for name, rows in names.items():
        columns = [column for column in zip(*rows, strict=True) if len(set(column)) > 1]
        frames[name] = set(zip(*columns, strict=True))
    first = max(names, key=lambda name: len(frames[name]))
    cameras = [
        name
        for name in names
        if 2 * len(frames[name] & frames[first]) > len(frames[name])
        or ("*" in first and "*" not in name)
    ]
    if len(cameras) > 1:
        each = " and ".join(f"{len(names[name])} {name}" for name in cameras)
        hint = f"Give those of one camera: '{folder / patterns[first]}'."
        raise SourceError(str(folder), f"holds several series of images: {each}", hint)


def _natural_key(path: Path) -> list[tuple[int, int, str]]:
    """Sort key that puts frame2 before frame10."""
    parts = _NUMBER.split(str(path))
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


NAME, ARRAYS = "array", (".npy", ".npz")
# If the last axis of an array is shorter than the others by this factor, it counts frames.
_FAR_SHORTER = 3
# It also does if its neighbours, an eleventh of an axis apart, differ by less than this share of
# those on each other axis. Of 231 real clips as (n, H, W), one does so; as (H, W, n), 125 of 132 of
# up to 30 frames, 45 of 66 of 60 frames, and 7 of 33 of 300.
_ALIKE, _N_COMPARED = 0.7, 12
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
        checked = self._checked()
        # All images of an integer array have one type: only lists and floats can go wrong later.
        is_whole = isinstance(images, list | tuple) or self._kind.startswith("float")
        if is_whole and isinstance(images, np.ndarray | list | tuple):
            for self._index, self._latest in enumerate(images):
                self._checked()
        n_frames = len(images) if isinstance(images, Sized) else None
        remark = "" if shape is None else _axes_remark(images)
        self.info = replace(info_of(checked, None, n_frames, codec), remark=remark)

    def picture(self) -> Image:
        """The latest image; raises SourceError if its shape, type or values are wrong."""
        return self._checked()

    def _checked(self) -> Image:
        """The latest image as uint8, uint16 or float32; raises SourceError."""
        image = np.asarray(self._latest)
        image = image.astype(image.dtype.newbyteorder("="), copy=False)
        kind = f"{image.dtype} of shape {image.shape}"
        is_picture = image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)
        is_float = image.dtype.kind == "f"
        is_known = is_float or image.dtype in (np.uint8, np.uint16)
        if not (is_picture and is_known and image.size):
            is_text = image.dtype.kind == "U"
            hint = "one path to a video; batch takes several" if is_text else _KINDS
            raise SourceError(self._name, f"frame {self._index} is {kind}", f"Give {hint}.")
        self._kind = self._kind or kind
        if kind != self._kind:
            why = f"frame {self._index} is {kind}, not {self._kind}"
            raise SourceError(self._name, why, "Give frames of one size and type.")
        if is_float:
            low, high = float(image.min()), float(image.max())
            if not 0.0 <= low <= high <= 1.0:
                why = f"frame {self._index} holds numbers from {low:g} to {high:g}"
                if not (math.isfinite(low) and math.isfinite(high)):
                    why = f"frame {self._index} holds a number that is not finite (NaN or infinity)"
                raise SourceError(self._name, why, f"Give {_KINDS}.")
            image = image.astype(np.float32, copy=False)
        return image


def _axes_remark(array: Any) -> str:
    """A line about an array, read as (n, H, W), that looks like (H, W, n); else empty."""
    shape = array.shape
    if len(shape) != 3 or min(shape) < 2:
        return ""
    some = np.asarray(array[tuple(slice(None, None, -(-n // _N_COMPARED)) for n in shape)], float)
    rows, columns, lasts = (np.abs(np.diff(some, axis=axis)).mean() for axis in range(3))
    is_short = shape[2] * _FAR_SHORTER <= min(shape[:2])
    if not (is_short or lasts < _ALIKE * min(rows, columns)):
        return ""
    n_frames, height, width = shape
    what = f"its array {tuple(shape)} is read as {n_frames} frames of {width}x{height} px"
    return f"{what}; if the last axis counts the frames, give np.moveaxis(array, -1, 0)"


def load_array(path: Path) -> Image:
    """The array in a .npy file, mapped into memory, not read, or in a .npz file of one.

    Raises SourceError.
    """
    try:
        array: Any = np.load(path, mmap_mode="r", allow_pickle=False)
        if isinstance(array, np.ndarray):
            return array
        with array as arrays:
            if len(arrays.files) == 1:
                return arrays[arrays.files[0]]
    except Exception as error:  # a damaged header may also raise errors of Python's parser
        reason = getattr(error, "strerror", None) or "not an array of numbers in NumPy's format"
        raise SourceError(str(path), f"cannot be read ({reason})") from None
    hint = f"Give one in Python: dlgmd_cli.run(np.load({str(path)!r})[NAME])."
    raise SourceError(str(path), f"holds the arrays {', '.join(arrays.files)}", hint)
