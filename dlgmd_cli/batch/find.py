"""The videos below folders, whatever else lies there."""

import os
import stat
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from dlgmd_cli.batch.names import result_names
from dlgmd_cli.batch.remote import find_remote, is_url
from dlgmd_cli.batch.task import Video
from dlgmd_cli.errors import SourceError
from dlgmd_cli.video.frames import fingerprint

_ENDINGS = """
    264 265 3g2 3gp asf avi dv f4v flv gif h264 h265 hevc ivf m2ts m2v m4v mj2 mjpeg mjpg mkv mov
    mp4 mpe mpeg mpg mts mxf nut ogg ogm ogv rm rmvb ts vob webm wmv y4m
"""
SUFFIXES = frozenset(f".{ending}" for ending in _ENDINGS.split())


@dataclass(frozen=True)
class Found:
    """What was found.

    Attributes
    ----------
    videos : list of Video
        In the order of their names.
    remarks : list of str
        What was left out on purpose, a line each.
    faults : list of str
        What could not be searched, a line each.
    """

    videos: list[Video] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)


def find_videos(roots: Sequence[tuple[str, str]], leave_out: Iterable[Path] = ()) -> Found:
    """Every video below folders, and those that are given themselves.

    Links are followed, but no folder is searched twice. Hidden files and folders are left out.

    Parameters
    ----------
    roots : sequence of (str, str)
        What the names of a root's videos begin with, and where it lies: a folder, a video, or a
        URL of either.
    leave_out : iterable of Path
        Folders that are not searched, such as that of the results, unless they are roots.

    Raises
    ------
    SourceError
        If there is nothing at a root.
    MissingExtraError
        If a root is a URL, and what reads such is not installed.
    """
    search = _Search(leave_out)
    places: dict[str, tuple[str, dict[str, Any]]] = {}
    for prefix, root in roots:
        for name, path, identity in _below(search, root):
            # What a root that is itself a video is called was told apart already.
            full = "/".join(part for part in (prefix, name) if part) or Path(root).name
            places.setdefault(full, (path, identity))
    results = result_names(places)
    videos = [
        Video(name, path, results[name], identity) for name, (path, identity) in places.items()
    ]
    videos.sort(key=lambda video: video.name)
    return Found(videos, [*search.remarks(), *_renamed(videos)], search.faults)


def is_video(name: str) -> bool:
    """Whether a file's name ends like that of a video."""
    return PurePosixPath(name).suffix.lower() in SUFFIXES


def _renamed(videos: Iterable[Video]) -> list[str]:
    """Which results are not called as one would expect."""
    return [
        f"{video.name}: its result is in {video.result}, for the shorter name is taken"
        for video in videos
        if PurePosixPath(video.result).name != PurePosixPath(video.name).stem
    ]


def _below(search: "_Search", root: str) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Name, place and identity of every video of a root."""
    if is_url(root):
        yield from find_remote(root, is_video)
        return
    for name, path in search.below(root):
        try:
            identity = fingerprint(path)
        except OSError:  # a dangling link; whoever opens it says so
            identity = {}
        yield name, path, identity


class _Search:
    """Walks through folders; remembers which, and what it met."""

    def __init__(self, leave_out: Iterable[Path]) -> None:
        self.faults: list[str] = []
        self._n_hidden = 0
        self._repeated: list[str] = []
        self._left_out = set()
        for folder in leave_out:
            try:
                self._left_out.add(_identity(folder.stat()))
            except OSError:  # it is not there yet
                continue
        self._searched: set[tuple[int, int]] = set()

    def remarks(self) -> list[str]:
        """What was left out on purpose."""
        lines = [f"{path}: left out, for it was searched already" for path in self._repeated]
        if self._n_hidden:
            kind = "file or folder" if self._n_hidden == 1 else "files and folders"
            lines.append(f"{self._n_hidden} hidden {kind} left out")
        return lines

    def below(self, root: str) -> Iterator[tuple[str, str]]:
        """Path below `root` with slashes, and absolute path, of every video; '' for `root`."""
        absolute = os.path.abspath(root)
        try:
            is_folder = stat.S_ISDIR(Path(absolute).stat().st_mode)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or str(error)
            raise SourceError(root, f"it cannot be read ({why})", "Check the path.") from None
        if not is_folder:
            yield "", absolute
            return
        waiting = [("", absolute)]
        while waiting:
            prefix, folder = waiting.pop()
            folders = []
            for entry in self._entries(folder, is_root=not prefix):
                name = f"{prefix}{entry.name}"
                if entry.name.startswith("."):
                    self._n_hidden += 1
                elif _leads_to_folder(entry):
                    folders.append((f"{name}/", entry.path))
                elif is_video(entry.name):
                    yield name, entry.path
            waiting.extend(reversed(folders))

    def _entries(self, folder: str, *, is_root: bool) -> list["os.DirEntry[str]"]:
        """What lies in a folder, by name; nothing if it was searched already."""
        try:
            identity = _identity(Path(folder).stat())
            if identity in self._left_out and not is_root:
                return []
            if identity in self._searched:
                self._repeated.append(folder)
                return []
            self._searched.add(identity)
            with os.scandir(folder) as entries:
                return sorted(entries, key=lambda entry: entry.name)
        except OSError as error:
            why = error.strerror or type(error).__name__
            self.faults.append(f"{folder}: this folder cannot be read ({why})")
            return []


def _leads_to_folder(entry: "os.DirEntry[str]") -> bool:
    try:
        return entry.is_dir()
    except OSError:  # a link to itself
        return False


def _identity(facts: os.stat_result) -> tuple[int, int]:
    return facts.st_dev, facts.st_ino
