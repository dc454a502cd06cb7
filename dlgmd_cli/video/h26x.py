"""The picture size in the parameter sets of H.264 and HEVC, and the bit reader for such headers."""

from collections.abc import Iterator

Size = tuple[int, int]

# A sequence header is far shorter; damaged or hostile bytes must not make the search long.
_MAX_HEADER_BYTES = 2048
_MAX_UNITS = 64
_CHROMA_420, _CHROMA_444 = 1, 3
# (horizontal, vertical) samples of luma for one of chroma, by chroma_format_idc.
_SUBSAMPLING = {0: (1, 1), 1: (2, 2), 2: (2, 1), 3: (1, 1)}
# Profiles whose sequence header says more than "4:2:0, 8 bits".
_H264_HIGH_PROFILES = {44, 83, 86, 100, 110, 118, 122, 128, 134, 135, 138, 139, 244}


class Bits:
    """Bytes as a string of bits, read from the front.

    Parameters
    ----------
    data : bytes
        What to read; all calls raise `ValueError` past its end.
    """

    def __init__(self, data: bytes) -> None:
        self._value = int.from_bytes(data, "big")
        self._n_left = 8 * len(data)

    def take(self, n_bits: int) -> int:
        """The next `n_bits` as an unsigned number."""
        self._n_left -= n_bits
        if self._n_left < 0:
            raise ValueError("the header ends too soon")
        return self._value >> self._n_left & (1 << n_bits) - 1

    def golomb(self) -> int:
        """The next unsigned Exp-Golomb number."""
        n_zeros = 0
        while not self.take(1):
            n_zeros += 1
            if n_zeros > 32:
                raise ValueError("no such number")
        return (1 << n_zeros) - 1 + self.take(n_zeros)

    def skip_golombs(self, n_numbers: int) -> None:
        """Read past as many Exp-Golomb numbers, signed or not."""
        for _ in range(n_numbers):
            self.golomb()

    def signed_golomb(self) -> int:
        """The next signed Exp-Golomb number."""
        code = self.golomb()
        return (code + 1) // 2 if code % 2 else -(code // 2)


def h264_sequence(packet: bytes) -> tuple[Size, bool] | None:
    """What the H.264 sequence headers in a packet say.

    Parameters
    ----------
    packet : bytes
        An access unit in Annex B form.

    Returns
    -------
    tuple of (int, int) and bool, or None
        Width and height in px after cropping, and whether pictures may be coded as two fields.
        None where there is no header, or where several disagree.

    Raises
    ------
    ValueError
        If a header is cut off or makes no sense.
    """
    found = {}
    for unit in _units(packet):
        kind = unit[0] & 0x1F
        if 1 <= kind <= 5:  # the picture itself; headers come before it
            break
        if kind == 7:
            number, size, has_fields = _h264_header(Bits(_unescaped(unit[1:])))
            found[number] = size, has_fields
    return found.popitem()[1] if len(set(found.values())) == 1 else None


def hevc_size(packet: bytes) -> Size | None:
    """The picture size that the HEVC sequence headers in a packet announce.

    Parameters
    ----------
    packet : bytes
        An access unit in Annex B form.

    Returns
    -------
    (int, int) or None
        Width and height in px after cropping; None where there is no header, or where several
        disagree.

    Raises
    ------
    ValueError
        If a header is cut off or makes no sense.
    """
    found = {}
    for unit in _units(packet):
        kind, layer = unit[0] >> 1 & 0x3F, (unit[0] & 1) << 5 | unit[1] >> 3
        if kind < 32:
            break
        if kind == 33 and layer == 0:  # further layers are other views of the same scene
            number, size = _hevc_header(Bits(_unescaped(unit[2:])))
            found[number] = size
    return found.popitem()[1] if len(set(found.values())) == 1 else None


def _units(packet: bytes) -> Iterator[bytes]:
    """The beginnings of the first NAL units, each at least two bytes."""
    code = packet.find(b"\0\0\1")
    for _ in range(_MAX_UNITS):
        unit = packet[code + 3 : code + 3 + _MAX_HEADER_BYTES]
        if code < 0 or len(unit) < 2:
            return
        yield unit
        code = packet.find(b"\0\0\1", code + 3)


def _unescaped(unit: bytes) -> bytes:
    """A NAL unit without the bytes that keep start codes out of it."""
    return unit.replace(b"\0\0\3", b"\0\0")


def _h264_header(bits: Bits) -> tuple[int, Size, bool]:
    """Number, size and possible fields of an H.264 sequence parameter set."""
    profile = bits.take(8)
    bits.take(16)  # constraints, level
    number = bits.golomb()
    chroma, has_planes = _CHROMA_420, 0
    if profile in _H264_HIGH_PROFILES:
        chroma = bits.golomb()
        if chroma == _CHROMA_444:
            has_planes = bits.take(1)
        bits.skip_golombs(2)  # bit depths
        bits.take(1)
        if bits.take(1):
            for index in range(12 if chroma == _CHROMA_444 else 8):
                if bits.take(1):
                    _skip_scaling_list(bits, 16 if index < 6 else 64)
    bits.golomb()
    order_type = bits.golomb()
    if order_type == 0:
        bits.golomb()
    elif order_type == 1:
        bits.take(1)
        bits.skip_golombs(2)
        bits.skip_golombs(bits.golomb())
    bits.golomb()
    bits.take(1)
    width, map_height = 16 * (bits.golomb() + 1), 16 * (bits.golomb() + 1)
    has_fields = not bits.take(1)
    if has_fields:
        bits.take(1)
    bits.take(1)
    n_rows = 2 if has_fields else 1
    x_step, y_step = _subsampling(0 if has_planes else chroma)
    size = _cropped(bits, (width, map_height * n_rows), (x_step, y_step * n_rows))
    return number, size, has_fields


def _skip_scaling_list(bits: Bits, n_entries: int) -> None:
    """Read past a scaling list, whose length depends on what is in it."""
    last = 8
    for _ in range(n_entries):
        last = (last + bits.signed_golomb()) % 256
        if last == 0:
            return


def _hevc_header(bits: Bits) -> tuple[int, Size]:
    """Number and size of an HEVC sequence parameter set."""
    bits.take(4)
    n_sub_layers = bits.take(3)
    bits.take(1 + 96)  # profile, tier, level
    has_parts = [(bits.take(1), bits.take(1)) for _ in range(n_sub_layers)]
    if n_sub_layers:
        bits.take(2 * (8 - n_sub_layers))
    for has_profile, has_level in has_parts:
        bits.take(88 * has_profile + 8 * has_level)
    number, chroma = bits.golomb(), bits.golomb()
    has_planes = chroma == _CHROMA_444 and bits.take(1)
    width, height = bits.golomb(), bits.golomb()
    return number, _cropped(bits, (width, height), _subsampling(0 if has_planes else chroma))


def _subsampling(chroma: int) -> Size:
    """Luma samples for one of chroma, across and down."""
    if chroma not in _SUBSAMPLING:
        raise ValueError("no such chroma format")
    return _SUBSAMPLING[chroma]


def _cropped(bits: Bits, size: Size, step: Size) -> Size:
    """`size` less the margins that follow, if any, counted in `step`."""
    if not bits.take(1):
        return size
    left, right, top, bottom = (bits.golomb() for _ in range(4))
    return size[0] - step[0] * (left + right), size[1] - step[1] * (top + bottom)
