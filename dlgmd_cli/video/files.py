"""Video files: checked, opened safely, and read so that a damaged one still gives what it holds."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from dlgmd_cli.errors import SourceError
from dlgmd_cli.video.base import (
    DEFAULT_DECODER,
    FALLBACK_FPS,
    Picture,
    Progress,
    Select,
    Verdict,
    VideoFacts,
    VideoInfo,
)
from dlgmd_cli.video.timestamps import FrameClock, HoleWatch

if TYPE_CHECKING:
    from dlgmd_cli.video.opencv import OpenCVDecoder
    from dlgmd_cli.video.pyav import PyAVDecoder

_DAMAGED = "the file is damaged"
# FFmpeg is kept from reading them anyway; this gives a better reason than "damaged".
_LISTS = (b"#EXTM3U", b"ffconcat")


class FileReader:
    """Pictures of a video file.

    Parameters
    ----------
    path : Path
        A file. Its name may hold anything: FFmpeg never takes it for a pattern or a URL.
    fps : float, optional
        Frames per second if the file does not state it; 30 unless given.
    decoder : {"opencv", "pyav"}
        What decodes it.

    Raises
    ------
    SourceError
        If no picture can be decoded.
    MissingExtraError
        If the decoder's package is not installed.
    """

    def __init__(
        self, path: Path, fps: float | None = None, decoder: str = DEFAULT_DECODER
    ) -> None:
        self._is_at_start = True
        self._fault: str | None = None
        self.progress = Progress()
        self._links = ExitStack()
        _check_readable(path)
        self._path = path
        name = self._links.enter_context(openable(path.absolute()))
        self._decoder = _create_decoder(decoder, name)
        try:
            facts = self._open()
        except BaseException:
            self.close()
            raise
        self._shown_s = facts.shown_s
        self.info = VideoInfo(
            os.path.abspath(path),
            path.stem or path.name,
            facts.width,
            facts.height,
            facts.fps or fps or FALLBACK_FPS,
            facts.n_frames,
            decoder,
        )

    def _open(self) -> VideoFacts:
        """Open the file and decode its first picture."""
        facts = self._decoder.open()
        if facts is None:
            raise SourceError(
                str(self._path),
                "no frame could be decoded, damaged file or missing codec",
                "Try re-encoding it with ffmpeg.",
            )
        return facts

    def pictures(self, select: Select) -> Iterator[Picture]:
        """Every picture that `select` takes, valid until the next one, to the end or a fault.

        Reading ends with a warning if damage leaves a gap, or if PyAV finds that the picture size
        changes (OpenCV scales such pictures to the first one's size and does not say so).
        """
        clock, holes = FrameClock(self.info.fps), HoleWatch(self.info.fps)
        progress = self.progress
        progress.n_decoded = 0
        self._fault = None
        for stamp_s in self._stamps():
            index = progress.n_decoded
            time_s = clock.time(index, stamp_s)
            holes.add(index, time_s)
            verdict = select(time_s)
            if verdict is Verdict.STOP:
                break
            decoded = self._decoder.picture() if verdict is Verdict.TAKE else None
            if verdict is Verdict.TAKE and decoded is None:
                self._fault = _DAMAGED
                break
            progress.n_decoded, progress.last_time_s = index + 1, time_s
            if decoded is not None:
                yield Picture(index, time_s, decoded.image, decoded.levels)
        else:
            self._fault = self._fault or self._shortfall()
        reports = (clock.report(), holes.report(), self._fault_line())
        progress.warnings += [line for line in reports if line]
        self._decoder.close()

    def _stamps(self) -> Iterator[float]:
        """The timestamp of each frame in seconds, NaN for none, up to a fault."""
        if not self._is_at_start:
            self._decoder.close()
            self._open()
        self._is_at_start = False
        for stamp_s, new_size in self._decoder.grabs():
            if self._decoder.is_damaged:
                self._fault = _DAMAGED
                if stamp_s > self.progress.last_time_s + 1.5 / self.info.fps:
                    return
            if new_size is not None:
                self._fault = f"the picture size changes to {new_size[0]}x{new_size[1]}"
                return
            yield stamp_s

    def _shortfall(self) -> str | None:
        """What is missing at the end of the stream, if anything."""
        n_frames, stated, fps = self.progress.n_decoded, self.info.n_frames, self.info.fps
        if stated is not None and n_frames < stated:  # the count alone is often wrong
            end_s = min(stated / fps, self._shown_s)
            if self.progress.last_time_s + 1.5 / fps < end_s:
                return "frames are missing, the file is cut off or damaged"
        return _DAMAGED if self._decoder.is_damaged else None

    def _fault_line(self) -> str | None:
        """The warning for a reading that ended early."""
        if self._fault is None:
            return None
        n_frames, stated = self.progress.n_decoded, self.info.n_frames
        of_stated = f" of about {stated}" if stated and stated > n_frames else ""
        until = f"{self.progress.last_time_s:.3f} s"
        return f"{self._fault}; decoded and used {n_frames}{of_stated} frames, up to {until}"

    def close(self) -> None:
        """Free the file; may be called twice."""
        self._decoder.close()
        self._links.close()


def count_frames(path: Path) -> int:
    """The number of frames that can be decoded from a video file; 0 if there is none."""
    with suppress(SourceError):
        reader = FileReader(path)
        try:
            for _ in reader.pictures(lambda time_s: Verdict.SKIP):
                pass
        finally:
            reader.close()
        return reader.progress.n_decoded
    return 0


@contextmanager
def openable(path: Path) -> Iterator[str]:
    """A name for an absolute path that FFmpeg opens as it is: no pattern, and valid UTF-8."""
    name = str(path)
    try:
        name.encode("utf-8")
        needs_link = "%" in name
    except UnicodeEncodeError:  # OpenCV would crash
        needs_link = True
    if not needs_link:
        yield name
        return
    with tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
        # The suffix helps FFmpeg to recognise raw streams; an odd one may be part of the trouble.
        suffix = path.suffix if path.suffix[1:].isalnum() and path.suffix.isascii() else ""
        link = Path(folder) / f"video{suffix}"
        try:
            link.symlink_to(path)
            name = str(link)
        except OSError:  # not every system lets its users make links
            pass
        yield name


def _create_decoder(decoder: str, name: str) -> "OpenCVDecoder | PyAVDecoder":
    """The decoder of that name, for a file that FFmpeg finds under `name`."""
    # Imported late: only the requested decoder has to be installed.
    if decoder == "pyav":
        from dlgmd_cli.video.pyav import PyAVDecoder

        return PyAVDecoder(name)
    from dlgmd_cli.video.opencv import OpenCVDecoder

    return OpenCVDecoder(name)


def _check_readable(path: Path) -> None:
    """Raise SourceError with the reason why a file cannot be opened, which FFmpeg does not give."""
    name = str(path)
    if not path.exists():
        raise SourceError(name, "there is no such file or folder", "Check the path.")
    if not path.is_file():
        raise SourceError(name, "it is neither a file nor a folder", "Give a video file.")
    try:
        with path.open("rb") as file:
            start = file.read(8)
    except OSError as error:
        raise SourceError(name, f"it cannot be read ({error.strerror})") from None
    if not start:
        raise SourceError(name, "the file is empty", "Copy or record it again.")
    if start.startswith(_LISTS):
        raise SourceError(
            name, "it is a list of other files, not a video", "Give one of the videos it names."
        )
