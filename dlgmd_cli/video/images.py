"""Sequences of images: a folder, a printf pattern, or a glob."""

import glob
import re
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from dlgmd_cli.errors import SourceError, counted
from dlgmd_cli.frame import Image
from dlgmd_cli.machine.files import open_regular
from dlgmd_cli.video.base import MAX_SIDE, TOO_LARGE, StreamInfo, Unreadable
from dlgmd_cli.video.names import PRINTF, is_pattern, is_video

SUFFIXES = (
    *(".bmp", ".dib", ".jp2", ".jpe", ".jpeg", ".jpg", ".pbm"),
    *(".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff", ".webp"),
)
# Least number of images that are a sequence even beside videos.
MIN_PICTURES = 8


class ImageDecoder:
    """Decodes a sequence of image files, at least one, at a given frame rate.

    Raises SourceError if the first image cannot be read.
    """

    kind = "opencv"
    is_damaged = False
    takes_every_frame = True

    def __init__(self, paths: list[Path], fps: float) -> None:
        self._paths, self._path, self._fps = paths, paths[0], fps
        try:
            first = read_image(self._path)
        except Unreadable as error:
            hint = "Remove it from the sequence or convert it to PNG."
            if self._path.suffix.lower() not in SUFFIXES:
                hint = "A pattern is for images; for several videos, use 'dlgmd batch'."
            raise SourceError(str(self._path), str(error), hint) from None
        kind = self._path.suffix[1:].lower()
        self.stream_info = StreamInfo(first.shape[1], first.shape[0], fps, len(paths), codec=kind)

    def stamps(self) -> Iterator[float]:
        """The time of each image in seconds."""
        for index, path in enumerate(self._paths):
            self._path = path
            yield index / self._fps

    def picture(self) -> tuple[Image, None]:
        """The image of the latest timestamp; raises Unreadable."""
        try:
            image = read_image(self._path)
        except Unreadable as error:
            raise Unreadable(f"{self._path.name} {error}") from None
        height, width = image.shape[:2]
        if (width, height) != self.stream_info[:2]:
            expected = f"{self.stream_info.width}x{self.stream_info.height}"
            raise Unreadable(f"{self._path.name} is {width}x{height}, not {expected}")
        return image, None

    def close(self) -> None:
        """Do nothing: no file is kept open."""


def read_image(path: Path) -> Image:
    """The image at `path`: uint8 or uint16, grey or BGR, upright; raises Unreadable."""
    try:
        # imread cannot open every file name.
        with open_regular(path, "rb") as file:
            data = np.frombuffer(file.read(), np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    except (OSError, cv2.error) as error:
        # The command has OpenCV judge the size that the file's header states.
        if "validateInputImageSize" in str(error):
            raise Unreadable(TOO_LARGE) from None
        image = None
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise Unreadable("cannot be read as an image")
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


def _natural_key(path: Path) -> list[tuple[int, int, str]]:
    """Sort key that puts frame2 before frame10."""
    parts = re.split(r"(\d+)", str(path))
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
