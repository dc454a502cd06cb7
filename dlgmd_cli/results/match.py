"""Which stored result is of which video: by its path, or by its size if it was moved or copied."""

import filecmp
import os
from pathlib import Path, PurePath
from typing import Any

from dlgmd_cli.errors import ResultError, SourceError
from dlgmd_cli.results.record import read_record
from dlgmd_cli.results.store import RUN, is_url, records_below
from dlgmd_cli.video.opening import fingerprint

_MEND = "Run 'dlgmd batch' again."


class StoredResults:
    """The results in a folder and in those below it, found by their videos.

    Parameters
    ----------
    place : Path
        The folder of a batch.
    """

    def __init__(self, place: Path) -> None:
        self._place = place
        records = records_below(place, RUN)
        inputs = {path.parent: read_record(path).get("input", {}) for path in records}
        # What the record of each result says of its input.
        self._inputs = {folder: facts for folder, facts in inputs.items() if facts.get("path")}
        self._by_path = {real_path(facts["path"]): folder for folder, facts in self._inputs.items()}

    def folder_of(self, video: str, name: str) -> Path:
        """The folder of the result of a video, which is called `name` in errors.

        That is the one whose record has its path. Else it is that of a file of the same name and
        size that is no longer where it was, or is the same: the video was moved or copied.

        Raises ResultError if there is none, if several fit, or if the video has been replaced.
        """
        own = _identity(video)
        folder = self._by_path.get(real_path(video))
        if folder is not None:
            facts = self._inputs[folder]
            if not _is_same(own, facts):
                is_as_big = "bytes" in own and facts.get("bytes") == own["bytes"]
                how = "was changed later" if is_as_big else "has another size"
                why = f"{name} is not the video of its result: it {how}"
                raise ResultError(str(folder), why, _MEND)
            return folder
        fitting = {
            folder: _n_common(facts["path"], video)
            for folder, facts in self._inputs.items()
            if own
            and PurePath(facts["path"]).name == PurePath(video).name
            and _is_same({**own, "mtime_ns": facts.get("mtime_ns")}, facts)
            and not _is_other(facts["path"], video)
        }
        best = [folder for folder, n in fitting.items() if n == max(fitting.values())]
        if not best:
            why = f"there is no result of {name}"
            if not own:
                why += " by its path, and no such file to find it by its size"
            raise ResultError(str(self._place), why, _MEND)
        if len(best) > 1:
            names = " and ".join(str(path.relative_to(self._place)) for path in best[:2])
            why = f"{name} is at no recorded path, and several results fit: {names}"
            raise ResultError(str(self._place), why, _MEND)
        return best[0]


def real_path(path: str) -> str:
    """A path without links and detours; a URL as it is."""
    try:
        return path if is_url(path) else os.path.realpath(path)
    except (OSError, ValueError):  # ValueError: a NUL in the name
        return path


def _identity(video: str) -> dict[str, Any]:
    """What `fingerprint` says of a file or of images; empty if it is gone."""
    try:
        return {} if is_url(video) else fingerprint(video)
    except (OSError, ValueError, SourceError):
        return {}


def _is_same(own: dict[str, Any], facts: dict[str, Any]) -> bool:
    """Whether the record of an input has this size and this time of its last change."""
    return all(facts.get(key) == value for key, value in own.items())


def _is_other(recorded: str, video: str) -> bool:
    """Whether a file of this size is still at the recorded path, and differs from the video."""
    try:
        if not Path(recorded).is_file():
            return is_url(recorded)
        return not filecmp.cmp(recorded, video, shallow=False)
    except OSError:
        return True


def _n_common(path: str, other: str) -> int:
    """How many parts at the end of two paths agree."""
    pairs = zip(reversed(PurePath(path).parts), reversed(PurePath(other).parts), strict=False)
    return next((n for n, (a, b) in enumerate(pairs) if a != b), len(PurePath(path).parts))
