"""Names of inputs, and short, distinct names of results."""

import glob
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

_ENDINGS = """
    264 265 3g2 3gp asf avi dv f4v flv gif h264 h265 hevc ivf m2ts m2v m4v mj2 mjpeg mjpg mkv mov
    mp4 mpe mpeg mpg mts mxf nut ogg ogm ogv rm rmvb ts vob webm wmv y4m
"""
_VIDEOS = frozenset(f".{ending}" for ending in _ENDINGS.split())
# The number in a pattern of pictures, such as %04d.
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
    """The folder of a sequence of pictures, which is given as a folder or as a pattern."""
    folder = Path(path).absolute()
    while not folder.is_dir() and is_pattern(folder.name):
        folder = folder.parent
    return folder.resolve()


def input_name(path: str | os.PathLike[str], *, are_pictures: bool) -> str:
    """Name of an input for its results: the stem of a file, the folder's name of pictures."""
    if are_pictures:
        return picture_folder(path).name or "root"
    return Path(path).stem or Path(path).name


def recorded_name(known: Mapping[str, Any]) -> str:
    """Name of the input that the item `input` of a record describes; it need not exist any more."""
    path = str(known.get("path", ""))
    return str(known.get("name") or input_name(path, are_pictures="pictures" in known))


def without_password(source: str) -> str:
    """A URL without the user and password, and with ``***`` for other values that look secret."""
    return _SECRET.sub(r"\1***", _USER.sub("", source))


def numbered(names: Sequence[str]) -> list[str]:
    """The names in their order; repeated ones get (2), (3) … appended."""
    distinct: list[str] = []
    for name in names:
        candidate, number = name, 1
        while candidate in distinct:
            number += 1
            candidate = f"{name} ({number})"
        distinct.append(candidate)
    return distinct


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """The last part of each path, or as many parts as it takes to make the names distinct."""
    all_parts = [Path(os.path.abspath(path)).parts for path in paths]
    names = []
    for parts in all_parts:
        others = [other for other in all_parts if other != parts]
        n = 1
        while n < len(parts) and any(other[-n:] == parts[-n:] for other in others):
            n += 1
        names.append("/".join(parts[-n:]))
    return numbered(names)
