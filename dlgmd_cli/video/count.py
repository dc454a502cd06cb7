"""How many frames a video really holds."""

from contextlib import suppress
from pathlib import Path

from dlgmd_cli.errors import SourceError
from dlgmd_cli.video.frames import Verdict
from dlgmd_cli.video.reader import VideoReader


def count_frames(path: Path) -> int:
    """How many frames a video holds: decoded, for a full disk leaves fewer without a word."""
    with suppress(SourceError):
        reader = VideoReader(path)
        try:
            for _ in reader.pictures(lambda time_s: Verdict.SKIP):
                pass
        finally:
            reader.close()
        return reader.progress.n_decoded
    return 0
