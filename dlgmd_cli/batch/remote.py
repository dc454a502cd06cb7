"""Files behind URLs, such as s3://bucket/flights, through fsspec."""

import os
import posixpath
import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import DlgmdError, MissingExtraError, SourceError
from dlgmd_cli.runs.serve import note

_CHUNK_BYTES = 1 << 20
# What file systems call that which changes with a file's content, the surest first.
_VERSIONS = ("ETag", "etag", "generation", "mtime", "LastModified", "last_modified", "updated")


def is_url(text: str) -> bool:
    """Whether `text` is a URL, and not a file or folder of such a name."""
    is_one = re.match(r"[A-Za-z][A-Za-z0-9+.-]*://", text) is not None
    return is_one and not os.path.lexists(text)


def file_system(url: str) -> tuple[Any, str]:
    """What reads and writes a URL, and the path that it has there.

    Raises
    ------
    MissingExtraError
        If that is not installed.
    DlgmdError
        If there is no such kind of URL, or it cannot be reached.
    """
    try:
        import fsspec
    except ImportError:
        raise MissingExtraError(
            url, "URLs need the package 'fsspec'", "Install it with: pip install 'dlgmd[cluster]'."
        ) from None
    try:
        found, path = fsspec.core.url_to_fs(url)
    except ImportError as error:  # it says what to install
        raise MissingExtraError(url, str(error).rstrip(".")) from None
    except Exception as error:
        raise DlgmdError(url, reason(error).rstrip("."), "Check the URL.") from None
    return found, str(path)


def reason(error: BaseException) -> str:
    """Why something behind a URL failed; every kind of it has exceptions of its own."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def find_remote(
    root: str, is_wanted: Callable[[str], bool]
) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Path below `root`, URL and identity of every file that is wanted by its name.

    Hidden ones are left out; '' is the path of a root that is a file itself.

    Raises
    ------
    SourceError
        If it cannot be read, or nothing is there.
    """
    system, base = file_system(root)
    try:
        found = system.find(base, detail=True)
    except Exception as error:
        raise SourceError(root, f"it cannot be read ({reason(error)})", "Check the URL.") from None
    if not found:
        raise SourceError(root, "there is nothing", "Check the URL.")
    base = base.rstrip("/")
    for path, facts in sorted(found.items()):
        name = str(path)[len(base) :].strip("/")
        is_hidden = any(part.startswith(".") for part in name.split("/"))
        if not name or (is_wanted(name) and not is_hidden):
            yield name, system.unstrip_protocol(path), _identity(facts)


@contextmanager
def at_hand(path: str) -> Iterator[str]:
    """A path under which a file can be opened: its own, or of a copy of what a URL leads to.

    Raises
    ------
    SourceError
        If it cannot be copied.
    """
    if not is_url(path):
        yield path
        return
    system, place = file_system(path)
    with tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
        copy = Path(folder) / f"video{posixpath.splitext(path)[1]}"
        try:
            with system.open(place, "rb") as there, copy.open("wb") as here:
                while chunk := there.read(_CHUNK_BYTES):
                    here.write(chunk)
                    note(None)
        except Exception as error:
            raise SourceError(
                path, f"it cannot be copied here ({reason(error)})", "Check the URL, or make room."
            ) from None
        yield os.fspath(copy)


def _identity(facts: dict[str, Any]) -> dict[str, Any]:
    """Size, and whatever tells of a change."""
    version = next((facts[key] for key in _VERSIONS if facts.get(key) is not None), None)
    return {"bytes": facts.get("size"), "version": None if version is None else str(version)}
