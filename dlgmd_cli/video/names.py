"""What the name of an input says: a video or images, what to call it, what to hide of it."""

import glob
import os
import re
from pathlib import Path, PurePosixPath

_ENDINGS = """
    264 265 3g2 3gp asf avi bag db3 dv f4v flv gif h264 h265 hevc ivf m2ts m2v m4v mcap mj2 mjpeg
    mjpg mkv mov mp4 mpe mpeg mpg mts mxf nut ogg ogm ogv rm rmvb ts vob webm wmv y4m
"""
_VIDEOS = frozenset(f".{ending}" for ending in _ENDINGS.split())
# The number in a pattern of images, such as %04d.
PRINTF = re.compile(r"%(0?)(\d*)d")
# What user names and passwords look like in a URL: before the host, or as a value with such a name.
_USER = re.compile(r"(?<=://)[^/?#]*@")
_SECRET = re.compile(r"(?i)((?:pass|pwd|pw|secret|token|key|auth|sig|cred)[^=&;/?#]*=)[^&;/#]*")


def is_video(name: str) -> bool:
    """Whether a file name has the suffix of a video."""
    return PurePosixPath(name).suffix.lower() in _VIDEOS


def is_pattern(text: str) -> bool:
    """Whether a path is a glob, or a printf pattern with one %d."""
    return glob.has_magic(text) or PRINTF.search(Path(text).name) is not None


def picture_folder(path: str | os.PathLike[str]) -> Path:
    """The folder of a sequence of images, which is given as a folder or as a pattern."""
    folder = Path(path).absolute()
    while not folder.is_dir() and is_pattern(folder.name):
        folder = folder.parent
    return folder.resolve()


def input_name(path: str | os.PathLike[str], *, are_pictures: bool) -> str:
    """Name of an input for its results: the stem of a file, the folder's name of images."""
    if are_pictures:
        return picture_folder(path).name or "root"
    return Path(path).stem or Path(path).name


def without_password(source: str) -> str:
    """A URL without the user and password, and with ``***`` for other values that look secret."""
    return _SECRET.sub(r"\1***", _USER.sub("", source))
