"""How the images of a video are to be turned and mirrored, as its display matrix asks."""

import struct
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import cv2

from dlgmd_cli.frame import Image

# A matrix is followed if it differs by less than 6 degrees from one that only turns by right angles
# and mirrors.
_SLANT = 0.1
# More boxes than that are in no file that is an MP4.
_MAX_BOXES = 10_000


class Orientation(NamedTuple):
    """What makes images upright: swap rows and columns first, then mirror along x or y."""

    swaps: bool = False
    flips_x: bool = False
    flips_y: bool = False

    @classmethod
    def of_matrix(cls, a: int, b: int, c: int, d: int) -> "Orientation":
        """That of a display matrix, by which (x, y) is shown at (a x + c y, b x + d y)."""
        straight, crossed = max(abs(a), abs(d)), max(abs(b), abs(c))
        if crossed <= _SLANT * straight:
            return cls(False, a < 0, d < 0)
        if straight <= _SLANT * crossed:
            return cls(True, c < 0, b < 0)
        return cls()

    @property
    def is_mirrored(self) -> bool:
        """Whether left and right are swapped after turning by `turned_deg`."""
        return (self.flips_x != self.flips_y) != self.swaps

    @property
    def turned_deg(self) -> int:
        """The angle by which images are turned clockwise: 0, 90, 180 or 270."""
        return (270 if self.flips_y else 90) if self.swaps else 180 * self.flips_y

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Width and height of an upright image."""
        return (height, width) if self.swaps else (width, height)

    def upright(self, image: Image) -> Image:
        """An image made upright; the same one if it is already."""
        if self.swaps:
            image = cv2.transpose(image)
        if self.flips_x or self.flips_y:
            both = self.flips_x and self.flips_y
            image = cv2.flip(image, -1 if both else int(self.flips_x))
        return image


UPRIGHT = Orientation()


def boxes(boxes: Iterable[memoryview], kind: bytes) -> Iterator[memoryview]:
    """The content of the boxes of one kind inside others."""
    for data in boxes:
        at = 0
        for _ in range(_MAX_BOXES):
            if at + 16 > len(data):
                break
            size, name, long_size = struct.unpack_from(">I4sQ", data, at)
            head = 16 if size == 1 else 8
            size = {0: len(data) - at, 1: long_size}.get(size, size)
            if size < head:  # damaged
                break
            if name == kind:
                yield data[at + head : at + size]
            at += size
