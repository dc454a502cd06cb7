"""Where a decoded frame holds its grey levels, and which of them are black and white."""

import re
import sys
from functools import lru_cache
from typing import NamedTuple

# Formats whose first plane is the luma, one sample after the other. All others, packed, RGB,
# floating point or of the other byte order among them, have to be converted.
_ENDIAN = "le" if sys.byteorder == "little" else "be"
_PLANAR = re.compile(rf"(?:yuva?4\d\dp|yuvj4\d\dp|gray)(?:(9|1[0246]){_ENDIAN})?")
_SEMIPLANAR = re.compile(rf"nv(?:12|21|16|24|42)|p[024](1[026]){_ENDIAN}")
_UNSPECIFIED, _LIMITED = 0, 1


class Luma(NamedTuple):
    """The luma plane of a pixel format: bits of a sample, and how far they are shifted up."""

    n_bits: int
    shift: int

    @property
    def n_bytes(self) -> int:
        """Bytes of a sample."""
        return 1 if self.n_bits == 8 else 2


@lru_cache(maxsize=64)
def luma_of(pixel_format: str) -> Luma | None:
    """The luma plane of a format by FFmpeg's name; None where it has none of its own.

    Parameters
    ----------
    pixel_format : str
        Such as yuv420p or p010le.
    """
    planar = _PLANAR.fullmatch(pixel_format)
    if planar:
        return Luma(int(planar[1] or 8), 0)
    semiplanar = _SEMIPLANAR.fullmatch(pixel_format)
    if semiplanar and semiplanar[1]:
        return Luma(int(semiplanar[1]), 16 - int(semiplanar[1]))
    return Luma(8, 0) if semiplanar else None


@lru_cache(maxsize=64)
def levels_of(pixel_format: str, luma: Luma, colour_range: int) -> tuple[int, int] | None:
    """The levels of black and white in a luma plane; None for the least and greatest of its type.

    Parameters
    ----------
    pixel_format : str
        FFmpeg's name for it.
    luma : Luma
        As `luma_of` has it.
    colour_range : int
        As FFmpeg has it: 0 for unspecified, 1 for limited, 2 for full.
    """
    is_full_by_name = pixel_format.startswith(("yuvj", "gray"))
    is_limited = colour_range == _LIMITED and not pixel_format.startswith("yuvj")
    if is_limited or (colour_range == _UNSPECIFIED and not is_full_by_name):
        scale = 1 << (luma.n_bits - 8 + luma.shift)
        return 16 * scale, 235 * scale
    if luma.n_bits in (8, 16):
        return None
    return 0, ((1 << luma.n_bits) - 1) << luma.shift
