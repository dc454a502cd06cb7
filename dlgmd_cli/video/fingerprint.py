"""What tells an input from another of the same name, without decoding it."""

import hashlib
import os
from pathlib import Path
from typing import Any

from dlgmd_cli.video.images import in_folder, is_pattern, matching


def fingerprint(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Size and time of change of a file, or a digest of those of every picture.

    Parameters
    ----------
    path : str or path
        What `open_source` could open.

    Raises
    ------
    SourceError
        If there are no pictures.
    OSError
        If the files cannot be looked at.
    """
    file = Path(path)
    if file.is_dir():
        return _of_pictures(in_folder(file))
    if not file.exists() and is_pattern(os.fspath(path)):
        return _of_pictures(matching(os.fspath(path)))
    facts = file.stat()
    return {"bytes": facts.st_size, "mtime_ns": facts.st_mtime_ns}


def _of_pictures(paths: list[Path]) -> dict[str, Any]:
    digest = hashlib.sha256()
    for path in paths:
        facts = path.stat()
        digest.update(
            f"{path.name}\0{facts.st_size}\0{facts.st_mtime_ns}\n".encode(errors="replace")
        )
    return {"pictures": len(paths), "sha256": digest.hexdigest()}
