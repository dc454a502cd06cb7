"""Sequences of pictures: a folder, a printf pattern, or a glob."""

import glob
import re
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from dlgmd_cli.errors import SourceError
from dlgmd_cli.video.base import FALLBACK_FPS, Picture, Progress, Select, Verdict, VideoInfo
from dlgmd_cli.video.luma import Image

SUFFIXES = (
    *(".bmp", ".dib", ".jp2", ".jpe", ".jpeg", ".jpg", ".pbm"),
    *(".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff", ".webp"),
)
_PRINTF = re.compile(r"%(0?)(\d*)d")


class ImageReader:
    """Pictures from files, in the order given.

    Parameters
    ----------
    paths : list of Path
        At least one file.
    origin : Path
        The folder or pattern they were found by.
    name : str
        What the results are called.
    fps : float, optional
        Frames per second of the sequence; 30 with a warning unless given.

    Raises
    ------
    SourceError
        If the first picture cannot be read.
    """

    def __init__(self, paths: list[Path], origin: Path, name: str, fps: float | None) -> None:
        self._paths = paths
        rate = fps or FALLBACK_FPS
        first = read_image(paths[0])
        if first is None:
            raise SourceError(
                str(paths[0]),
                "it cannot be read as a picture",
                "Remove it from the sequence or convert it to PNG.",
            )
        height, width = first.shape[:2]
        self.info = VideoInfo(str(origin), name, width, height, rate, len(paths))
        self.progress = Progress()
        if fps is None:
            self.progress.warnings.append(
                f"pictures have no times; taken as {rate:g} fps (set it with --input-fps)"
            )

    def pictures(self, select: Select) -> Iterator[Picture]:
        """Every picture that `select` takes, until one is damaged or of another size."""
        self.progress.n_decoded = 0
        for index, path in enumerate(self._paths):
            time_s = index / self.info.fps
            verdict = select(time_s)
            if verdict is Verdict.STOP:
                return
            image = read_image(path) if verdict is Verdict.TAKE else None
            if verdict is Verdict.TAKE and (fault := self._fault(image)):
                self.progress.warnings.append(
                    f"{path.name} {fault}; "
                    f"used the {index} of {len(self._paths)} pictures before it"
                )
                return
            self.progress.n_decoded, self.progress.last_time_s = index + 1, time_s
            if image is not None:
                yield Picture(index, time_s, image)

    def _fault(self, image: Image | None) -> str | None:
        """Why `image` cannot continue the sequence, if it cannot."""
        if image is None:
            return "cannot be read as a picture"
        height, width = image.shape[:2]
        if (width, height) != (self.info.width, self.info.height):
            return f"is {width}x{height}, not {self.info.width}x{self.info.height}"
        return None

    def close(self) -> None:
        """Do nothing: no file stays open between pictures."""


def read_image(path: Path) -> Image | None:
    """The picture at `path`: uint8 or uint16, grey or BGR, upright; None if it cannot be read."""
    try:
        # Not imread: it cannot open every file name.
        data = np.frombuffer(path.read_bytes(), np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    except (OSError, cv2.error):
        return None
    return image if image is not None and image.dtype in (np.uint8, np.uint16) else None


def natural_key(path: Path) -> list[tuple[int, int, str]]:
    """Sorts frame2 before frame10."""
    parts = re.split(r"(\d+)", str(path))
    return [(1, int(part), part) if part.isdecimal() else (0, 0, part) for part in parts]


def in_folder(folder: Path) -> list[Path]:
    """The pictures in `folder` in natural order, without hidden files.

    Raises
    ------
    SourceError
        If the folder cannot be read or holds no picture.
    """
    try:
        entries = list(folder.iterdir())
    except OSError as error:
        raise SourceError(str(folder), f"it cannot be read ({error.strerror})") from None
    found = [
        path
        for path in entries
        if path.suffix.lower() in SUFFIXES and not path.name.startswith(".") and path.is_file()
    ]
    if not found:
        raise SourceError(
            str(folder),
            "there is no picture in this folder",
            "'dlgmd run' takes a video, or a folder of pictures such as PNG or JPEG.",
        )
    return sorted(found, key=natural_key)


def is_pattern(text: str) -> bool:
    """Whether `text` names several files: a glob, or a printf pattern with one %d."""
    return glob.has_magic(text) or _PRINTF.search(Path(text).name) is not None


def matching(pattern: str) -> list[Path]:
    """The files that a pattern names, in natural order.

    Raises
    ------
    SourceError
        If there is none.
    """
    found = _printf_matches(Path(pattern))
    if not found and glob.has_magic(pattern):
        paths = [Path(match) for match in glob.glob(pattern, recursive=True)]
        found = sorted((path for path in paths if path.is_file()), key=natural_key)
    if not found:
        raise SourceError(
            pattern, "no file matches this pattern", "Quote it, and check the path before it."
        )
    return found


def _printf_matches(pattern: Path) -> list[Path]:
    """Files in the pattern's folder whose names its one %d (or %04d) could have printed."""
    match = _PRINTF.search(pattern.name)
    if match is None or not pattern.parent.is_dir():
        return []
    before, after = pattern.name[: match.start()], pattern.name[match.end() :]
    width = int(match[2] or 1) if match[1] else 1
    number = rf"(\d{{{min(width, 99)},}})"
    name = re.compile(
        re.escape(before.replace("%%", "%")) + number + re.escape(after.replace("%%", "%"))
    )
    numbered = [
        (int(found[1]), path)
        for path in pattern.parent.iterdir()
        if (found := name.fullmatch(path.name)) and path.is_file()
    ]
    return [path for _, path in sorted(numbered)]
