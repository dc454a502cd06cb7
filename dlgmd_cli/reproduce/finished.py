"""The clips that an interrupted report has finished, kept until it is complete."""

import hashlib
import json
import shutil
import zipfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from dlgmd_cli.reproduce.clips import Clip, ClipResults

FOLDER = "unfinished"
_PACKAGE = Path(__file__).resolve().parents[1]


@cache
def _source() -> str:
    """A digest of the source code of this package."""
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*")):
        if path.suffix in (".py", ".yaml"):
            digest.update(path.read_bytes())
    return digest.hexdigest()


class Finished:
    """Results of clips in a folder, one file each, under a name that says what was computed.

    The name depends on the clip, the models and their parameters, and the source code: what was
    computed by another version is not found.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def read(self, task: tuple[Any, Any]) -> ClipResults | None:
        """The results of a task; None if it is not finished, or the file is damaged."""
        if not isinstance(task[0], Clip):
            return None
        try:
            with np.load(self._path(task), allow_pickle=False) as arrays:
                return ClipResults.of_arrays(task[0], task[1], dict(arrays))
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            return None

    def write(self, task: tuple[Any, Any], results: Any) -> None:
        """Keep the results of a clip; what cannot be written is computed again."""
        if not isinstance(task[0], Clip):
            return
        path = self._path(task)
        stage = path.with_suffix(".part.npz")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            np.savez(stage, **results.arrays())
            stage.replace(path)
        except OSError:
            stage.unlink(missing_ok=True)

    def remove(self) -> None:
        """Remove the folder: the report is complete."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _path(self, task: tuple[Any, Any]) -> Path:
        clip, models = task
        described = {label: repr(params) for label, params in models.items()}
        text = json.dumps([repr(clip), described, _source()], sort_keys=True)
        return self._folder / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.npz"
