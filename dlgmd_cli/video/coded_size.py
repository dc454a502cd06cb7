"""What a packet of a compressed stream says about itself: picture size, and frames it shows."""

from collections.abc import Callable
from typing import NamedTuple

from dlgmd_cli.video.h26x import Bits, Size, h264_sequence, hevc_size

_MAX_SIDE_PX = 65535
_MAX_JPEG_SEGMENTS = 256
_MAX_VPX_HEADER_BYTES = 32
_MAX_MPEG4_HEADER_BYTES = 64
_MAX_MPEG4_UNITS = 64
_MAX_PLACEHOLDER_BYTES = 10
# Only their key packets announce a size, so that the others need not be copied.
KEYED = {"h264", "hevc"}


class Header(NamedTuple):
    """What is in a packet: a size, and how many frames it shows (None: that is not clear)."""

    size: Size | None = None
    n_shown: int | None = 1


def coded_size(codec: str, packet: bytes) -> Size | None:
    """The picture size that a packet of a video stream announces.

    Parameters
    ----------
    codec : str
        FourCC of the codec, in any case: MJPG, h264, hevc, VP80, VP90, FMP4, MPNG or an alias.
    packet : bytes
        One packet; in Annex B form for H.264 and HEVC.

    Returns
    -------
    (int, int) or None
        Width and height in px after cropping; None where the packet announces none, cannot be
        parsed, or the codec is not known.
    """
    return read_header(canonical(codec), packet).size


def canonical(codec: str) -> str:
    """The key of `READERS` for a codec, or the name itself."""
    lower = codec.lower().rstrip()
    return _ALIASES.get(lower, lower)


def read_header(codec: str, packet: bytes) -> Header:
    """What a packet says, which is nothing where it makes no sense."""
    read = READERS.get(codec)
    if read is None:
        return Header()
    try:
        header = read(packet)
    except (ValueError, IndexError):
        return Header()
    is_plausible = header.size is None or 0 < min(header.size) <= max(header.size) <= _MAX_SIDE_PX
    return header if is_plausible else Header(n_shown=header.n_shown)


def _h264(packet: bytes) -> Header:
    """The sequence header; where there are fields, one may be a packet of its own."""
    sequence = h264_sequence(packet)
    return Header(sequence[0], None if sequence[1] else 1) if sequence else Header()


def _hevc(packet: bytes) -> Header:
    """The sequence header."""
    return Header(hevc_size(packet))


def _jpeg(packet: bytes) -> Header:
    """The first frame header; that of a thumbnail lies inside a segment and is passed over."""
    position = packet.index(b"\xff\xd8") + 2
    for _ in range(_MAX_JPEG_SEGMENTS):
        marker = packet[position + 1]
        if packet[position] != 0xFF or marker in (0xD9, 0xDA):  # end, or the picture begins
            break
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            bits = Bits(packet[position + 5 : position + 9])
            height, width = bits.take(16), bits.take(16)
            return Header((width, height))
        is_filling = marker == 0xFF
        position += 1 if is_filling else 2 + Bits(packet[position + 2 : position + 4]).take(16)
    return Header()


def _png(packet: bytes) -> Header:
    """The header chunk, which always comes first."""
    if packet[:8] != b"\x89PNG\r\n\x1a\n" or packet[12:16] != b"IHDR":
        return Header()
    bits = Bits(packet[16:24])
    return Header((bits.take(32), bits.take(32)))


def _vp8(packet: bytes) -> Header:
    """Frame tag and the size in key frames; others may be kept for reference, never shown."""
    n_shown = packet[0] >> 4 & 1
    if packet[0] & 1 or packet[3:6] != b"\x9d\x01\x2a":
        return Header(n_shown=n_shown)
    width, height = (int.from_bytes(packet[i : i + 2], "little") & 0x3FFF for i in (6, 8))
    return Header((width, height), n_shown)


def _vp9(packet: bytes) -> Header:
    """The frames of a packet together: hidden ones share it with the shown one that follows."""
    last = packet[-1]
    n_frames, n_bytes = (last & 7) + 1, (last >> 3 & 3) + 1
    index = packet[-2 - n_frames * n_bytes :]
    if last >> 5 != 6 or index[0] != last:
        return _vp9_frame(packet)
    size, n_shown, start = None, 0, 0
    for i in range(n_frames):
        frame = _vp9_frame(packet[start : start + _MAX_VPX_HEADER_BYTES])
        size, n_shown = frame.size or size, n_shown + (frame.n_shown or 0)
        start += int.from_bytes(index[1 + i * n_bytes : 1 + (i + 1) * n_bytes], "little")
    return Header(size, n_shown)


def _vp9_frame(frame: bytes) -> Header:
    """The header up to the size; besides key frames, any may announce one."""
    bits = Bits(frame[:_MAX_VPX_HEADER_BYTES])
    if bits.take(2) != 2:
        return Header()
    profile = bits.take(1) | bits.take(1) << 1
    bits.take(1 if profile == 3 else 0)
    if bits.take(1):  # it only calls for an earlier frame to be shown
        return Header()
    is_key = not bits.take(1)
    n_shown, is_resilient = bits.take(1), bits.take(1)
    is_intra = is_key or (not n_shown and bits.take(1) == 1)
    bits.take(0 if is_key or is_resilient else 2)
    if is_intra:
        if bits.take(24) != 0x498342:
            return Header()
        if is_key or profile:
            _skip_vp9_colours(bits, profile)
        bits.take(0 if is_key else 8)
    else:
        bits.take(8 + 3 * 4)
        if any(bits.take(1) for _ in range(3)):  # as large as one of its references
            return Header(n_shown=n_shown)
    return Header((bits.take(16) + 1, bits.take(16) + 1), n_shown)


def _skip_vp9_colours(bits: Bits, profile: int) -> None:
    """Read past depth, colour space and subsampling."""
    bits.take(1 if profile >= 2 else 0)
    is_rgb = bits.take(3) == 7
    n_bits = 0 if is_rgb else 1
    if profile in (1, 3):
        n_bits += 1 if is_rgb else 3
    bits.take(n_bits)


def _mpeg4(packet: bytes) -> Header:
    """The layer header, if one comes before the picture."""
    # One this short mostly stands in for a frame in the packet before, or for none at all.
    n_shown = None if len(packet) <= _MAX_PLACEHOLDER_BYTES else 1
    before, _, _ = packet.partition(b"\0\0\1\xb6")
    for unit in before.split(b"\0\0\1", _MAX_MPEG4_UNITS)[1:]:
        if unit and unit[0] >> 4 == 2:
            return Header(_mpeg4_size(Bits(unit[1:_MAX_MPEG4_HEADER_BYTES])), n_shown)
    return Header(n_shown=n_shown)


def _mpeg4_size(bits: Bits) -> Size | None:
    """The size in a video object layer header, None for shapes other than a rectangle."""
    bits.take(1 + 8)
    if bits.take(1):  # version and priority
        bits.take(4 + 3)
    if bits.take(4) == 15:  # pixel aspect in full
        bits.take(8 + 8)
    if bits.take(1):
        bits.take(2 + 1)
        bits.take(79 if bits.take(1) else 0)
    if bits.take(2):
        return None
    bits.take(1)
    resolution = bits.take(16)
    bits.take(1)
    if bits.take(1):  # a fixed frame rate, in as many bits as the clock's rate needs
        bits.take(max(1, (resolution - 1).bit_length()))
    bits.take(1)
    width = bits.take(13)
    bits.take(1)
    return width, bits.take(13)


READERS: dict[str, Callable[[bytes], Header]] = {
    "h264": _h264,
    "hevc": _hevc,
    "mjpg": _jpeg,
    "mp4v": _mpeg4,
    "mpng": _png,
    "vp80": _vp8,
    "vp90": _vp9,
}
_ALIASES = {
    "avc1": "h264",
    "x264": "h264",
    "hev1": "hevc",
    "hvc1": "hevc",
    "h265": "hevc",
    "jpeg": "mjpg",
    "divx": "mp4v",
    "dx50": "mp4v",
    "fmp4": "mp4v",
    "xvid": "mp4v",
    "png": "mpng",
    "vp08": "vp80",
    "vp09": "vp90",
}
