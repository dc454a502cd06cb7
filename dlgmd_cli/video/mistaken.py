"""What a file is that is no video: a text, a pointer, sound, an archive, a part of a recording."""

import codecs
import re
from pathlib import Path

from dlgmd_cli.video.stated import stated_by

_N_BYTES = 1 << 18  # of each end of the file; MP4 may describe its streams in either
_LFS = b"version https://git-lfs.github.com/"
_SOUND = re.compile(
    rb"ID3|fLaC|RIFF....WAVE|\xff[\xf2\xf3\xfa\xfb]|OggS.{24}(\x01vorbis|OpusHead|\x7fFLAC)", re.S
)
# The kinds of streams, as MP4, AVI and Matroska describe them.
_STREAM = re.compile(rb"(?:hdlr.{8}|strh.{4}|\x86[\x83-\xa0])(vid[es]|soun|auds|V_|A_)", re.S)
RE_ENCODE = "Try re-encoding it with ffmpeg."


def mistaken(path: Path) -> tuple[str, str]:
    """Why a file without any frame cannot be read, judged by its first bytes, and what to do."""
    with path.open("rb") as file:
        head = file.read(_N_BYTES)
        file.seek(max(0, path.stat().st_size - _N_BYTES))
        streams = {stream for part in (head, file.read()) for stream in _STREAM.findall(part)}
    if head.startswith(_LFS):
        return "is a Git LFS pointer, not the video itself", "Fetch it with 'git lfs pull'."
    if re.match(rb"\s*<(!doctype )?html", head, re.I):
        return "is a web page, not a video", "Download the video itself."
    if head.startswith(b"PK\x03\x04"):
        return "is a ZIP archive, not a video", "Unpack it first."
    if _SOUND.match(head) or (streams and streams <= {b"soun", b"auds", b"A_"}):
        return "has sound, but no video", "Give the video that it belongs to."
    if _is_text(head):
        return "is a text file, not a video", "Give the video."
    if head[4:8] == b"ftyp" and not stated_by(path).kind:
        why = "was not closed: the recording or the copy was cut off before its index (moov)"
        return why, "Copy it again; some cameras complete such a file when they start."
    return "no frame could be decoded, damaged file or missing codec", RE_ENCODE


def _is_text(head: bytes) -> bool:
    """Whether all of it is text in UTF-8; the last letter may be cut."""
    try:
        text = codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return False
    return all(letter.isprintable() or letter.isspace() for letter in text)
