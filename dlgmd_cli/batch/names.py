"""Where in the tree of results a video's result lies: named after it, and told apart."""

import posixpath
from collections import defaultdict
from collections.abc import Iterable

# What stands beside the results of the topmost folder.
RESERVED = frozenset({"summary.csv"})


def result_names(videos: Iterable[str]) -> dict[str, str]:
    """The folder of each video's result, mirroring the tree.

    It is called after the file without its ending; with it where another video, or a folder with
    videos, has the same name in the same folder, whether in capitals or not.

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
    by_folder: dict[str, list[str]] = defaultdict(list)
    folders: dict[str, set[str]] = defaultdict(set)
    for video in videos:
        folder, name = posixpath.split(video)
        by_folder[folder].append(name)
        while folder:
            folder, below = posixpath.split(folder)
            folders[folder].add(_safe(below).casefold())
    results = {}
    for folder, names in by_folder.items():
        taken = folders[folder] | (RESERVED if not folder else frozenset())
        for name, called in _called(sorted(names), taken).items():
            parts = [_safe(part) for part in folder.split("/") if part]
            results[posixpath.join(folder, name)] = "/".join([*parts, called])
    return results


def _called(names: list[str], taken: Iterable[str]) -> dict[str, str]:
    """What the results of the videos of one folder are called, apart from what is taken."""
    stems = defaultdict(list)
    for name in names:
        stems[_safe(posixpath.splitext(name)[0]).casefold()].append(name)
    used, called = set(taken), {}
    alone = {kin[0] for stem, kin in stems.items() if len(kin) == 1 and stem not in used}
    for name in sorted(names, key=lambda name: name not in alone):
        wanted = base = _safe(posixpath.splitext(name)[0] if name in alone else name)
        number = 1
        while wanted.casefold() in used:
            number += 1
            wanted = f"{base} ({number})"
        used.add(wanted.casefold())
        called[name] = wanted
    return called


def _safe(part: str) -> str:
    """A part of a path that neither leads elsewhere nor hides; what is not so stays as it is."""
    part = part.replace("\\", "_").replace("\0", "_")
    if part.startswith(".") or not part.strip(". "):
        return f"video{part}"
    return part
