"""The videos below folders and URLs, pictures included, and the folders of their results."""

import os
import posixpath
import stat
import tempfile
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from dlgmd_cli.errors import SourceError
from dlgmd_cli.names import told_apart
from dlgmd_cli.results.store import failure_text, is_url, place
from dlgmd_cli.video.frames import fingerprint
from dlgmd_cli.video.images import SUFFIXES as PICTURES
from dlgmd_cli.video.images import read_image

if TYPE_CHECKING:
    from upath import UPath

_ENDINGS = """
    264 265 3g2 3gp asf avi dv f4v flv gif h264 h265 hevc ivf m2ts m2v m4v mj2 mjpeg mjpg mkv mov
    mp4 mpe mpeg mpg mts mxf nut ogg ogm ogv rm rmvb ts vob webm wmv y4m
"""
SUFFIXES = frozenset(f".{ending}" for ending in _ENDINGS.split())
# What stores call that which changes with a file's content, the surest first.
_VERSIONS = ("ETag", "etag", "generation", "mtime", "LastModified", "last_modified", "updated")
# So many pictures of one size are taken for the frames of a video; looked at are a few of them.
LEAST_PICTURES, _LOOKED_AT = 8, 5
# What Matplotlib writes near the beginning of a figure.
_OF_FIGURES = b"Matplotlib"
# Lies beside the results in the topmost folder.
SUMMARY = "summary.csv"


@dataclass(frozen=True)
class Input:
    """One video of a batch.

    Attributes
    ----------
    name : str
        What the summary calls it: its path below the folder that was given, with slashes.
    path : str
        Where it lies: an absolute path or a URL.
    folder : str
        The folder of its result below that of the batch, with slashes.
    identity : dict
        What changes with its content; empty where that cannot be told.
    """

    name: str
    path: str
    folder: str
    identity: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Found:
    """The videos in the order of their names, what was left out on purpose, and what failed."""

    videos: list[Input]
    remarks: list[str]
    faults: list[str]


def find_videos(
    roots: Sequence[str], leave_out: Iterable[Path] = (), exclude: Iterable[str] = ()
) -> Found:
    """Every video below folders, and those that are given themselves.

    A folder that holds pictures of one size only, eight or more, is a video too, unless they are
    figures. Links are followed, but no folder is searched twice, and a real folder comes before a
    link to it. Hidden files and folders are left out.

    Parameters
    ----------
    roots : sequence of str
        Folders, videos, and URLs of either. Of several, names begin with that of the root.
    leave_out : iterable of Path
        Folders that are not searched, such as that of the results, unless they are roots.
    exclude : iterable of str
        Patterns, such as ``raw*``, of files and folders to leave out: each is compared with their
        name, and with their path as `Input.name` has it.

    Raises
    ------
    SourceError
        If there is nothing at a root.
    MissingExtraError
        If a root is a URL, and what reads such is not installed.
    """
    roots = list(dict.fromkeys(roots))
    search = _Search(leave_out, exclude)
    prefixes = told_apart([Path(root) for root in roots]) if len(roots) > 1 else [""]
    named = list(zip(prefixes, roots, strict=True))
    for prefix, root in sorted(named, key=lambda one: Path(one[1]).is_symlink()):
        base = place(root)
        if isinstance(base, Path):
            search.add(prefix, str(base))
        else:
            search.add_url(prefix, root, base)
    search.follow_links()
    folders = result_folders(search.found)
    videos = [Input(name, path, folders[name], one) for name, (path, one) in search.found.items()]
    videos.sort(key=lambda video: video.name)
    renamed = [
        f"{video.name}: the result folder is {video.folder}: another video has the same name"
        for video in videos
        if PurePosixPath(video.folder).name != PurePosixPath(video.name).stem
    ]
    return Found(videos, [*search.remarks(), *renamed], search.faults)


def is_video(name: str) -> bool:
    """Whether a file's name ends like that of a video."""
    return PurePosixPath(name).suffix.lower() in SUFFIXES


class _Search:
    """Walks through folders and remembers what it met."""

    def __init__(self, leave_out: Iterable[Path], exclude: Iterable[str]) -> None:
        self.found: dict[str, tuple[str, dict[str, Any]]] = {}
        self.faults: list[str] = []
        self._n_excluded = {pattern.rstrip("/"): 0 for pattern in exclude}
        self._n_hidden = 0
        self._no_sequences: list[str] = []
        self._repeated: list[str] = []
        self._links: list[tuple[str, str]] = []
        self._searched: set[tuple[int, int]] = set()
        self._left_out: set[tuple[int, int]] = set()
        for folder in leave_out:
            with suppress(OSError):  # it may not be there yet
                self._left_out.add(_key_of(folder))

    def remarks(self) -> list[str]:
        """What was left out on purpose."""
        lines = [f"{path}: left out, already searched" for path in self._repeated]
        lines += self._no_sequences
        for pattern, n in self._n_excluded.items():
            what = f"{n} file{'s' * (n > 1)} or folder{'s' * (n > 1)}" if n else "nothing"
            lines.append(f"--exclude {pattern!r} left out {what}")
        if self._n_hidden:
            kind = "file or folder" if self._n_hidden == 1 else "files and folders"
            lines.append(f"{self._n_hidden} hidden {kind} left out")
        return lines

    def add(self, prefix: str, root: str) -> None:
        """Search a folder, or take a video."""
        absolute = os.path.abspath(root)
        try:
            is_folder = stat.S_ISDIR(Path(absolute).stat().st_mode)
        except (OSError, ValueError) as error:  # ValueError: a NUL in the name
            why = f"cannot be read ({failure_text(error)})"
            raise SourceError(root, why, "Check the path.") from None
        if is_folder:
            self._left_out.discard(_key_of(absolute))
            self._walk(prefix, absolute)
        else:
            self._take(prefix or Path(root).name, absolute)

    def add_url(self, prefix: str, root: str, base: "UPath") -> None:
        """Search all that lies behind a URL, or take the video there."""
        top = base.path.rstrip("/")
        try:
            base.fs.invalidate_cache()
            listed = base.fs.find(top, detail=True)
        except Exception as error:  # every kind of URL has its own
            why = f"cannot be read ({failure_text(error)})"
            raise SourceError(root, why, "Check the URL.") from None
        if not listed:
            raise SourceError(root, "nothing was found there", "Check the URL.")
        for path, facts in sorted(listed.items()):
            below = str(path)[len(top) :].removeprefix("/")
            name = "/".join(filter(None, (prefix, below))) or posixpath.basename(str(path))
            if any(part.startswith(".") for part in below.split("/")):
                self._n_hidden += 1
            elif self._is_excluded(name):
                continue
            elif not below or is_video(below):
                version = next((str(facts[key]) for key in _VERSIONS if facts.get(key)), None)
                known = {"bytes": facts.get("size"), "version": version} if version else {}
                self.found.setdefault(name, (base.fs.unstrip_protocol(path), known))

    def follow_links(self) -> None:
        """Search what links lead to, after all that is real."""
        while self._links:
            self._links.sort()
            self._walk(*self._links.pop(0))

    def _walk(self, prefix: str, root: str) -> None:
        """Search a folder; links to folders are kept for later."""
        waiting = [(prefix, root)]
        while waiting:
            prefix, folder = waiting.pop()
            entries = self._entries(folder)
            if self._is_sequence(folder, entries):
                self._take(prefix or Path(folder).name, folder)
                continue
            for entry in entries:
                name = f"{prefix}/{entry.name}" if prefix else entry.name
                if entry.name.startswith("."):
                    self._n_hidden += 1
                elif self._is_excluded(name):
                    continue
                elif _leads_to_folder(entry):
                    (self._links if entry.is_symlink() else waiting).append((name, entry.path))
                elif is_video(entry.name):
                    self._take(name, entry.path)

    def _is_excluded(self, name: str) -> bool:
        """Whether a pattern leaves out this path or a folder above it; counts those it does."""
        parts = name.split("/")
        for pattern in self._n_excluded:
            for depth, part in enumerate(parts, start=1):
                if fnmatchcase(part, pattern) or fnmatchcase("/".join(parts[:depth]), pattern):
                    self._n_excluded[pattern] += 1
                    return True
        return False

    def _is_sequence(self, folder: str, entries: Sequence["os.DirEntry[str]"]) -> bool:
        """Whether a folder holds the frames of a video; a remark if it only looks like it."""
        seen = [entry for entry in entries if not entry.name.startswith(".")]
        names = [entry.name for entry in seen]
        if len(seen) < LEAST_PICTURES or not all(map(_is_picture, names)):
            return False
        if any(map(_leads_to_folder, seen)):
            return False
        paths = [Path(entry.path) for entry in seen]
        some = paths[:: max(1, len(paths) // _LOOKED_AT)]
        why = ""
        if any(_is_figure(path) for path in some):
            why = "its pictures are figures"
        else:
            images = [read_image(path) for path in some]
            sizes = {None if image is None else image.shape[:2] for image in images}
            if None in sizes:
                why = "some of its pictures cannot be read"
            elif len(sizes) > 1:
                why = "its pictures are not of one size"
        if why:
            self._no_sequences.append(f"{folder}: left out, {why}")
        return not why

    def _take(self, name: str, path: str) -> None:
        """Take a video down."""
        identity: dict[str, Any] = {}
        with suppress(OSError):  # a dangling link; opening it says so
            identity = fingerprint(path)
        self.found.setdefault(name, (path, identity))

    def _entries(self, folder: str) -> list["os.DirEntry[str]"]:
        """What lies in a folder; nothing if it was searched already or is left out."""
        try:
            key = _key_of(folder)
            if key in self._left_out:
                return []
            if key in self._searched:
                self._repeated.append(folder)
                return []
            self._searched.add(key)
            with os.scandir(folder) as entries:
                return sorted(entries, key=lambda entry: entry.name)
        except OSError as error:
            self.faults.append(f"{folder}: this folder cannot be read ({failure_text(error)})")
            return []


def _is_picture(name: str) -> bool:
    """Whether a file's name ends like that of a picture."""
    return PurePosixPath(name).suffix.lower() in PICTURES


def _is_figure(path: Path) -> bool:
    """Whether a picture was drawn by Matplotlib; one that cannot be read was not."""
    with suppress(OSError), path.open("rb") as file:
        return _OF_FIGURES in file.read(1000)
    return False


def _leads_to_folder(entry: "os.DirEntry[str]") -> bool:
    try:
        return entry.is_dir()
    except OSError:  # a link to itself
        return False


def _key_of(folder: str | Path) -> tuple[int, int]:
    """What a folder has in common with every link to it; raises OSError."""
    facts = Path(folder).stat()
    return facts.st_dev, facts.st_ino


@contextmanager
def local_copy(path: str, scratch: str | None = None) -> Iterator[str]:
    """A path on this machine: `path` itself, or of a copy in `scratch` of what a URL leads to.

    Raises
    ------
    SourceError
        If it cannot be copied.
    """
    if not is_url(path):
        yield path
        return
    there = place(path)
    with tempfile.TemporaryDirectory(dir=scratch, prefix="dlgmd-") as folder:
        copy = Path(folder) / f"video{there.suffix[:16]}"
        try:
            there.fs.get_file(there.path, str(copy))  # type: ignore[union-attr]
        except Exception as error:
            why = f"cannot be copied to this machine ({failure_text(error)})"
            raise SourceError(path, why, "Check the URL, or make room.") from None
        yield str(copy)


def result_folders(videos: Iterable[str]) -> dict[str, str]:
    """The folder of each video's result by the video's path, mirroring the tree.

    It is called after the file without its extension; with it where another video, or a folder with
    videos, has the same name there, whether in capitals or not. None is within another.
    """
    parts = {video: [_safe(part) for part in video.split("/")] for video in sorted(videos)}
    stems = {
        video: "/".join([*above, _safe(posixpath.splitext(video.rpartition("/")[2])[0])])
        for video, (*above, _) in parts.items()
    }
    n_alike = Counter(map(_folded, stems.values()))
    used = {_folded("/".join(p[:depth])) for p in parts.values() for depth in range(1, len(p))}
    used.add(SUMMARY)
    alone = {
        video
        for video, stem in stems.items()
        if n_alike[_folded(stem)] == 1 and _folded(stem) not in used
    }
    folders = {}
    for video in sorted(parts, key=lambda video: video not in alone):
        wanted = base = stems[video] if video in alone else "/".join(parts[video])
        number = 1
        while _folded(wanted) in used:
            number += 1
            wanted = f"{base} ({number})"
        used.add(_folded(wanted))
        folders[video] = wanted
    return folders


def _folded(part: str) -> str:
    """What names have in common that are one name on some file system."""
    return unicodedata.normalize("NFC", part).casefold()


def _safe(part: str) -> str:
    """A part of a path that neither leads elsewhere nor hides; what is not so stays as it is."""
    part = part.replace("\\", "_").replace("\0", "_")
    if part.startswith(".") or not part.strip(". "):
        return f"video{part}"
    return part
