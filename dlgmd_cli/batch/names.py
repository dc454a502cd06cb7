"""Where in the tree of results a video's result lies: named after it, and told apart."""

import posixpath
import unicodedata
from collections import defaultdict
from collections.abc import Iterable

# What stands beside the results of the topmost folder.
RESERVED = frozenset({"summary.csv"})


def result_names(videos: Iterable[str]) -> dict[str, str]:
    """The folder of each video's result, mirroring the tree.

    It is called after the file without its ending; with it where another video, or a folder with
    videos, has the same name in the same folder, whether in capitals or not, and however
    its accents are written.

    Parameters
    ----------
    videos : iterable of str
        Paths with slashes, each once.

    Returns
    -------
    dict of str to str
        For every path that of its result, with slashes; none is within another, or leads out of
        the tree.
    """
    above = {video: tuple(_safe(part) for part in video.split("/")[:-1]) for video in videos}
    by_folder: dict[tuple[str, ...], list[str]] = defaultdict(list)
    folders: dict[tuple[str, ...], set[str]] = defaultdict(set)
    for video, parts in above.items():
        # Folders whose names differ in capitals only may be one where the results go.
        keys = tuple(map(_key, parts))
        by_folder[keys].append(video)
        for depth, below in enumerate(keys):
            folders[keys[:depth]].add(below)
    results = {}
    for keys, kin in by_folder.items():
        taken = folders[keys] | (frozenset() if keys else RESERVED)
        for video, called in _called(sorted(kin), taken).items():
            results[video] = "/".join([*above[video], called])
    return results


def _called(videos: list[str], taken: Iterable[str]) -> dict[str, str]:
    """What the results of the videos of one folder are called, apart from what is taken."""
    names = {video: video.rpartition("/")[2] for video in videos}
    stems = defaultdict(list)
    for video, name in names.items():
        stems[_key(_safe(posixpath.splitext(name)[0]))].append(video)
    used, called = set(taken), {}
    alone = {kin[0] for stem, kin in stems.items() if len(kin) == 1 and stem not in used}
    for video in sorted(videos, key=lambda video: video not in alone):
        name = names[video]
        wanted = base = _safe(posixpath.splitext(name)[0] if video in alone else name)
        number = 1
        while _key(wanted) in used:
            number += 1
            wanted = f"{base} ({number})"
        used.add(_key(wanted))
        called[video] = wanted
    return called


def _key(part: str) -> str:
    """What names have in common that are one name on some file system."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", part).casefold())


def _safe(part: str) -> str:
    """A part of a path that neither leads elsewhere nor hides; what is not so stays as it is."""
    part = part.replace("\\", "_").replace("\0", "_")
    if part.startswith(".") or not part.strip(". "):
        return f"video{part}"
    return part
