"""TIFF files of one or more images, and what they state of axes and times."""

import html
import math
import mmap
import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from dlgmd_cli.errors import SourceError
from dlgmd_cli.frame import Image
from dlgmd_cli.machine.files import open_regular
from dlgmd_cli.video.base import MAX_FPS, openable
from dlgmd_cli.video.images import AS_STORED, ArrayDecoder

TIFF = (".tif", ".tiff")
# Bytes that are read at a time: each reading goes through all pages before, for 0.2 ms each.
_BYTES_AT_ONCE = 1 << 27
# The descriptions by OME, ImageJ and tifffile; each search in so many bytes takes 40 ms.
_DESCRIPTIONS = (rb"(?s)<OME\b.+?OME>", rb"ImageJ=[^\0]+", rb'{"shape": [^\0]+')
_N_SEARCHED = 1 << 23
# What ImageJ and OME call the number of images on each axis, the fastest of ImageJ first.
_AXES = {"C": "channels", "Z": "slices", "T": "frames"}
_SECONDS = {"h": 3600.0, "min": 60.0, "": 1.0, "s": 1.0, "sec": 1.0, "ms": 1e-3, "ns": 1e-9}
_SECONDS |= dict.fromkeys(("us", "µs", "μs", r"\u00B5s"), 1e-6)

_ONE_SERIES = "Save one series of frames as a file of its own (in ImageJ, by Image > Duplicate)."
_AS_IMAGES = "Save them as a folder of images (in ImageJ, by File > Save As > Image Sequence)."


def n_pages(path: Path) -> int:
    """The number of images in a file, above 1 for a TIFF stack; 0 if it cannot be read."""
    if path.suffix.lower() not in TIFF:
        return 1
    with suppress(OSError, ValueError):
        return _chain(_mapped(path))[0]
    return 0


class TiffDecoder(ArrayDecoder):
    """Yields the images of a TIFF file at the times that it states, or at a given frame rate.

    Floating-point images have levels from 0 to 1. Raises SourceError if the file cannot be read, or
    if its images are not frames only, but also channels or slices.
    """

    def __init__(self, path: Path, fps: float) -> None:
        data = _mapped(path)
        self._path, (self._n_pages, self._is_cut) = path, _chain(data)
        axes, step_s, self._times = _stated(_description(data), self._n_pages)
        sizes = " x ".join(f"{n} {name}" for name, n in axes.items())
        n_frames, remark = math.prod(axes.values()), ""
        if n_frames == self._n_pages or (self._is_cut and n_frames > self._n_pages):
            if len(axes) > 1:
                raise SourceError(str(path), f"holds {sizes}", _ONE_SERIES)
        elif self._n_pages == 1 and axes:
            raise SourceError(str(path), f"has a single page for {sizes}", _AS_IMAGES)
        else:
            remark = "" if not axes else f"it has {self._n_pages} images, but states {sizes}"
            n_frames, self._times = self._n_pages, []
        stated_fps = 1.0 / step_s if 1.0 / MAX_FPS <= step_s < math.inf else None
        super().__init__(self._pages(), stated_fps or fps, str(path), "tiff")
        self.info = replace(self.info, fps_stated=stated_fps, n_frames=n_frames, remark=remark)

    def stamps(self) -> Iterator[float]:
        """The time of each image in seconds."""
        for index, stamp_s in enumerate(super().stamps()):
            yield self._times[index] if self._times else stamp_s
        self.is_damaged = self._is_cut

    def _pages(self) -> Iterator[Image]:
        """The images, as far as they can be read, at least one; raises SourceError."""
        first, n_pages = 0, 1
        while first < self._n_pages:
            with openable(self._path.absolute()) as name:
                _, pages = cv2.imreadmulti(name, first, n_pages, flags=AS_STORED)
            yield from pages
            first += len(pages)
            if len(pages) < n_pages:
                self._is_cut = True
                break
            n_pages = min(max(1, _BYTES_AT_ONCE // pages[0].nbytes), self._n_pages - first)
        if first == 0:
            raise SourceError(str(self._path), "cannot be read as a TIFF file")


def _mapped(path: Path) -> mmap.mmap:
    """The bytes of a file; raises OSError, or ValueError for an empty file."""
    with open_regular(path, "rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def _chain(data: mmap.mmap) -> tuple[int, bool]:
    """The number of pages, and whether their chain is broken, as in a file that was cut off."""
    order = "<" if data[:2] == b"II" else ">"
    # BigTIFF, of the number 43, has wider fields.
    count, offset, n_bytes = ("Q", "Q", 20) if 43 in data[2:4] else ("H", "I", 12)
    pages: set[int] = set()
    with suppress(struct.error, OverflowError):
        (page,) = struct.unpack_from(order + offset, data, struct.calcsize(f"={offset}"))
        while page and page not in pages:
            (n_tags,) = struct.unpack_from(order + count, data, page)
            end = page + struct.calcsize(f"={count}") + n_tags * n_bytes
            (following,) = struct.unpack_from(order + offset, data, end)
            pages.add(page)
            page = following
        return len(pages), page != 0
    return len(pages), True


def _description(data: mmap.mmap) -> str:
    """The description by OME, ImageJ or tifffile near the beginning or end of a file, or empty."""
    for part in (data[:_N_SEARCHED], data[-_N_SEARCHED:]):
        for description in _DESCRIPTIONS:
            if found := re.search(description, part):
                return html.unescape(found[0].decode("utf-8", "replace"))
    return ""


def _fact(text: str, words: str) -> str:
    """What a description states after one of these words; empty if nothing."""
    found = re.search(rf'\b(?:{words})="?([^"\s]+)', text)
    return found[1] if found else ""


def _stated(text: str, n_pages: int) -> tuple[dict[str, int], float, list[float]]:
    """What a description states, see `_axes` and `_times`; nothing if it is in other words."""
    with suppress(ValueError, KeyError):
        axes = _axes(text, n_pages)
        return axes, *_times(text, math.prod(axes.values()))
    return {}, math.nan, []


def _axes(text: str, n_pages: int) -> dict[str, int]:
    """The axes of more than one image that a description states, the slowest first."""
    if text.startswith("{"):
        shape = [int(n) for n in re.findall(r"\d+", text.partition("]")[0])]
        n_axes = [math.prod(shape[:k]) for k in range(len(shape))].index(n_pages)
        return {f"on axis {k}": n for k, n in enumerate(shape[:n_axes]) if n > 1}
    axes = {"series": len(re.findall(r"<(?:\w+:)?Pixels\b", text)) or 1}
    for letter in reversed(_fact(text, "DimensionOrder")[2:] or "CZT"):
        axes[_AXES[letter]] = int(_fact(text, f"{_AXES[letter]}|Size{letter}") or 1)
    if n_channels := len(re.findall(r"<(?:\w+:)?Channel\b", text)):  # with colour, of 3 samples
        axes["channels"] = n_channels // axes["series"]
    return {name: n for name, n in axes.items() if n > 1}


def _times(text: str, n_images: int) -> tuple[float, list[float]]:
    """The time between images in s, and the time of each if a description states them all."""
    unit_s = _SECONDS.get(_fact(text, "DeltaTUnit"), math.nan)
    times = unit_s * np.array(re.findall(r'\bDeltaT="([^"]*)"', text), float)
    if len(times) == n_images > 1 and np.diff(times).min() > 0.0:
        return float(np.diff(times).mean()), (times - times[0]).tolist()
    unit_s = _SECONDS.get(_fact(text, "tunit|TimeIncrementUnit"), math.nan)
    step_s = unit_s * float(_fact(text, "finterval|TimeIncrement") or "nan")
    return step_s if step_s > 0.0 else 1.0 / float(_fact(text, "fps") or "nan"), []
