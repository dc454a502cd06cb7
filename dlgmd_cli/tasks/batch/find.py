"""Finding videos and image folders below folders and URLs, and naming their result folders."""

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
from typing import TYPE_CHECKING

from dlgmd_cli.errors import ParameterError, SourceError, argument
from dlgmd_cli.machine.files import open_regular
from dlgmd_cli.parameters.checks import similar_path
from dlgmd_cli.parameters.facts import InputFacts
from dlgmd_cli.results.names import distinct_names
from dlgmd_cli.results.store import SUMMARY, failure_text, is_url, place
from dlgmd_cli.video.bags import is_bag
from dlgmd_cli.video.base import Unreadable, is_video
from dlgmd_cli.video.images import MIN_PICTURES, read_image
from dlgmd_cli.video.images import SUFFIXES as PICTURES
from dlgmd_cli.video.opening import fingerprint
from dlgmd_cli.video.tiff import n_pages

if TYPE_CHECKING:
    from upath import UPath

# Metadata keys of object stores that change with the content, the most reliable first.
_VERSIONS = ("ETag", "etag", "generation", "mtime", "LastModified", "last_modified", "updated")
# Number of images of a sequence that are checked.
_N_CHECKED = 5
# Metadata that Matplotlib writes near the beginning of a figure.
_MATPLOTLIB = b"Matplotlib"


@dataclass(frozen=True)
class VideoFile:
    """One video of a batch.

    `name` is the video's name in the summary: its path relative to the given folder, with slashes.
    `path` is absolute, or a URL. `folder` is the result folder relative to the batch's folder, with
    slashes. `identity` has values that change with the video's content; empty if unknown.
    """

    name: str
    path: str
    folder: str
    identity: InputFacts = field(default_factory=InputFacts)


@dataclass(frozen=True)
class VideoListing:
    """The videos in order of their names, remarks on files left out, and failures."""

    videos: list[VideoFile]
    remarks: list[str]
    faults: list[str]


def find_videos(
    roots: Sequence[str], leave_out: Iterable[Path] = (), exclude: Iterable[str] = ()
) -> VideoListing:
    """Find all videos below the given folders, and videos that are given themselves.

    A folder that holds only images of the same size, at least eight, counts as a video unless the
    images are figures. A folder of rosbag2 counts as a video too. Links are followed, but no folder
    is searched twice, and a real folder takes precedence over a link to it. Hidden files and
    folders are skipped.

    `roots` are folders, videos, and URLs of either. With several, names begin with the root's name.
    The folders `leave_out`, such as the output folder, are skipped unless they are roots. The
    patterns `exclude`, such as ``raw*``, are matched against names and against paths as in
    `VideoFile.name`. Raises SourceError if a root does not exist or is an empty URL, and
    MissingExtraError if the packages for a URL are not installed.
    """
    roots = list(dict.fromkeys(roots))
    if "" in roots:
        raise ParameterError("", "the name of a folder is empty")
    search = _Search(leave_out, exclude)
    prefixes = distinct_names([Path(root) for root in roots]) if len(roots) > 1 else [""]
    named = list(zip(prefixes, roots, strict=True))
    for prefix, root in sorted(named, key=lambda pair: Path(pair[1]).is_symlink()):
        base = place(root)
        if isinstance(base, Path):
            search.add(prefix, str(base))
        else:
            search.add_url(prefix, root, base)
    search.follow_links()
    folders = result_folders(search.found)
    videos = [
        VideoFile(name, path, folders[name], known) for name, (path, known) in search.found.items()
    ]
    videos.sort(key=lambda video: video.name)
    renamed = [
        f"{video.name}: the result folder is {video.folder}: another video has the same name"
        for video in videos
        if PurePosixPath(video.folder).name != PurePosixPath(video.name).stem
    ]
    return VideoListing(videos, [*search.remarks(), *renamed], search.faults)


class _Search:
    """A search through folders; collects videos, remarks and failures."""

    def __init__(self, leave_out: Iterable[Path], exclude: Iterable[str]) -> None:
        self.found: dict[str, tuple[str, InputFacts]] = {}
        self.faults: list[str] = []
        self._n_excluded = {pattern.rstrip("/"): 0 for pattern in exclude}
        self._left: list[tuple[str, str]] = []
        self._links: list[tuple[str, str]] = []
        self._searched: set[tuple[int, int]] = set()
        self._left_out: set[tuple[int, int]] = set()
        for folder in leave_out:
            with suppress(OSError):  # the folder may not exist yet
                self._left_out.add(_key_of(folder))

    def remarks(self) -> list[str]:
        """Remarks on files and folders that were left out."""
        lines = [f"{path}: left out, {why}" for path, why in self._left]
        for pattern, n in self._n_excluded.items():
            what = f"{n} file{'s' * (n > 1)} or folder{'s' * (n > 1)}" if n else "nothing"
            lines.append(f"{argument('exclude')} {pattern!r} left out {what}")
        return lines

    def add(self, prefix: str, root: str) -> None:
        """Search a folder, or add a video."""
        absolute = os.path.abspath(root)
        try:
            is_folder = stat.S_ISDIR(Path(absolute).stat().st_mode)
        except (OSError, ValueError) as error:  # ValueError: a NUL in the name
            why = f"cannot be read ({failure_text(error)})"
            raise SourceError(root, why, similar_path(root) or "Check the path.") from None
        if is_folder:
            self._left_out.discard(_key_of(absolute))
            self._walk(prefix, absolute)
        else:
            self._take(prefix or Path(root).name, absolute)

    def add_url(self, prefix: str, root: str, base: "UPath") -> None:
        """Search everything below a URL, or add the video there."""
        top = base.path.rstrip("/")
        try:
            base.fs.invalidate_cache()
            listed = base.fs.find(top, detail=True)
        except Exception as error:  # every kind of URL raises its own types
            why = f"cannot be read ({failure_text(error)})"
            raise SourceError(root, why, "Check the URL.") from None
        if not listed:
            raise SourceError(root, "nothing was found there", "Check the URL.")
        for path, facts in sorted(listed.items()):
            below = str(path)[len(top) :].removeprefix("/")
            name = "/".join(filter(None, (prefix, below))) or posixpath.basename(str(path))
            is_hidden = any(part.startswith(".") for part in below.split("/"))
            if is_hidden or self._is_excluded(name):
                continue
            if not below or is_video(below):
                version = next((str(facts[key]) for key in _VERSIONS if facts.get(key)), None)
                known: InputFacts = {}
                if version:
                    known = {"bytes": facts.get("size"), "version": version}
                self.found.setdefault(name, (base.fs.unstrip_protocol(path), known))

    def follow_links(self) -> None:
        """Search the targets of links, after all real folders."""
        while self._links:
            self._links.sort()
            self._walk(*self._links.pop(0))

    def _walk(self, prefix: str, root: str) -> None:
        """Search a folder; links to folders are queued."""
        waiting = [(prefix, root)]
        while waiting:
            prefix, folder = waiting.pop()
            entries = self._entries(folder)
            if is_bag(Path(folder)) or self._is_sequence(folder, entries):
                self._take(prefix or Path(folder).name, folder)
                continue
            for entry in entries:
                name = f"{prefix}/{entry.name}" if prefix else entry.name
                if entry.name.startswith(".") or self._is_excluded(name):
                    continue
                if Path(entry.path).is_dir():  # False for a link that points to itself
                    (self._links if entry.is_symlink() else waiting).append((name, entry.path))
                elif is_video(entry.name) or n_pages(Path(entry.path)) > 1:
                    self._take(name, entry.path)

    def _is_excluded(self, name: str) -> bool:
        """Whether a pattern excludes this path or a parent folder; counts the exclusions."""
        parts = name.split("/")
        above = ["/".join(parts[:depth]) for depth in range(1, len(parts) + 1)]
        for pattern in self._n_excluded:
            if any(fnmatchcase(part, pattern) for part in (*parts, *above)):
                self._n_excluded[pattern] += 1
                return True
        return False

    def _is_sequence(self, folder: str, entries: Sequence["os.DirEntry[str]"]) -> bool:
        """Whether a folder holds the frames of a video; adds a remark if it only looks like one."""
        visible = [Path(entry.path) for entry in entries if not entry.name.startswith(".")]
        paths = [path for path in visible if path.suffix.lower() in PICTURES and not path.is_dir()]
        others = sorted({path.name for path in visible} - {path.name for path in paths})
        if len(paths) < MIN_PICTURES or any(map(is_video, others)) or n_pages(paths[0]) > 1:
            return False
        some = paths[:: max(1, len(paths) // _N_CHECKED)]
        if others:
            why = f"its images are beside other files, such as {others[0]}"
        elif any(_is_figure(path) for path in some):
            why = "its images are figures"
        else:
            sizes = set()
            try:
                for path in some:
                    sizes.add(read_image(path).shape[:2])
                why = "its images are not of one size" if len(sizes) > 1 else ""
            except Unreadable as error:
                why = f"{path.name} {error}"
        if why:
            self._left.append((folder, why))
        return not why

    def _take(self, name: str, path: str) -> None:
        identity: InputFacts = {}
        with suppress(OSError):  # a dangling link, which opening will report
            identity = fingerprint(path)
        self.found.setdefault(name, (path, identity))

    def _entries(self, folder: str) -> list["os.DirEntry[str]"]:
        """Entries of a folder by name; none if the folder was already searched or is skipped."""
        try:
            key = _key_of(folder)
            if key in self._left_out:
                return []
            if key in self._searched:
                self._left.append((folder, "already searched"))
                return []
            self._searched.add(key)
            with os.scandir(folder) as entries:
                return sorted(entries, key=lambda entry: entry.name)
        except OSError as error:
            self.faults.append(f"{folder}: this folder cannot be read ({failure_text(error)})")
            return []


def _is_figure(path: Path) -> bool:
    """Whether an image is a figure drawn by Matplotlib."""
    with suppress(OSError), open_regular(path, "rb") as file:
        return _MATPLOTLIB in file.read(1000)
    return False


def _key_of(folder: str | Path) -> tuple[int, int]:
    """Device and inode, the same for a folder and every link to it; raises OSError."""
    status = Path(folder).stat()
    return status.st_dev, status.st_ino


@contextmanager
def local_copy(path: str, scratch: str | None = None) -> Iterator[str]:
    """A local path: `path` itself, or for a URL the path of a temporary copy in `scratch`.

    Raises SourceError if the file cannot be copied.
    """
    if not is_url(path):
        yield path
        return
    remote = place(path)
    with tempfile.TemporaryDirectory(dir=scratch, prefix="dlgmd-") as folder:
        copy = Path(folder) / f"video{remote.suffix[:16]}"
        try:
            remote.fs.get_file(remote.path, str(copy))  # type: ignore[union-attr]
        except Exception as error:
            why = f"cannot be copied to this machine ({failure_text(error)})"
            raise SourceError(path, why, "Check the URL, or make room.") from None
        yield str(copy)


def result_folders(videos: Iterable[str]) -> dict[str, str]:
    """The result folder of each video by the video's path, mirroring the tree.

    A folder is named after the video without extension. The extension is kept if another video or a
    folder with videos in the same place has the same name, ignoring case. Results are not nested.
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
    """A form of a name, equal for all names that some file system treats as the same."""
    return unicodedata.normalize("NFC", part).casefold()


def _safe(part: str) -> str:
    """A part of a path, changed if it would leave the folder or be hidden."""
    part = part.replace("\\", "_").replace("\0", "_")
    if part.startswith(".") or not part.strip(". "):
        return f"video{part}"
    return part
