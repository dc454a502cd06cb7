"""Files behind URLs, such as s3://bucket/flights, through fsspec."""

import os
import posixpath
import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import (
    DlgmdError,
    MissingExtraError,
    OutputError,
    ParameterError,
    SourceError,
)
from dlgmd_cli.results.workshop import Workshop, sweep_leftovers
from dlgmd_cli.runs.serve import note

_CHUNK_BYTES = 1 << 20
# What is there for one process, or not even for that.
_OF_ONE_PROCESS = frozenset({"memory", "data"})
# What file systems call that which changes with a file's content, the surest first.
_VERSIONS = ("ETag", "etag", "generation", "mtime", "LastModified", "last_modified", "updated")


def is_url(text: str) -> bool:
    """Whether `text` is a URL, and not a file or folder of such a name."""
    is_one = re.match(r"[A-Za-z][A-Za-z0-9+.-]+://", text) is not None
    return is_one and not os.path.lexists(text)


def file_system(url: str) -> tuple[Any, str]:
    """What reads and writes a URL, and the path that it has there.

    Raises
    ------
    ParameterError
        If there is no such kind of URL, or none that several processes share.
    MissingExtraError
        If what it needs is not installed.
    DlgmdError
        If it cannot be used.
    """
    try:
        import fsspec
    except ImportError:
        raise MissingExtraError(
            url, "URLs need the package 'fsspec'", "Install it with: pip install 'dlgmd[cluster]'."
        ) from None
    kind = url.partition("://")[0].lower()
    if kind in _OF_ONE_PROCESS:
        raise ParameterError(url, f"{kind}:// is of one process alone", "Choose another place.")
    if kind not in fsspec.available_protocols():
        raise ParameterError(url, f"there is no kind of URL called {kind}://", "Check the URL.")
    try:
        found, path = fsspec.core.url_to_fs(url)
    except ImportError as error:  # it says what to install
        why = reason(error).rstrip(".")
        raise MissingExtraError(url, why, "pip can install it.") from None
    except Exception as error:
        raise DlgmdError(url, reason(error).rstrip("."), "Check the URL.") from None
    return found, str(path).rstrip("/")


def reason(error: BaseException) -> str:
    """Why something behind a URL failed; every kind of it has exceptions of its own."""
    if isinstance(error, OSError) and error.strerror and error.errno is not None:
        return error.strerror
    text = " ".join(str(error).split()).rstrip(".")
    if isinstance(error, FileNotFoundError) and " " not in text:  # only the path
        return "there is no such file"
    return text or type(error).__name__


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
    for path, facts in sorted(found.items()):
        name = str(path)[len(base) :].removeprefix("/")
        is_hidden = any(part.startswith(".") for part in name.split("/"))
        is_root = path == base and len(found) == 1
        if is_root or (name and is_wanted(name) and not is_hidden):
            yield name, system.unstrip_protocol(path), _identity(system, path, facts)


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
    with scratch() as folder:
        copy = folder / f"video{posixpath.splitext(path)[1][:16]}"
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


@contextmanager
def scratch() -> Iterator[Path]:
    """A folder on this machine for a while; raises OutputError."""
    with ExitStack() as stack:
        try:
            workshop = stack.enter_context(Workshop(Path(tempfile.gettempdir())))
        except OSError as error:
            raise OutputError(
                tempfile.gettempdir(),
                f"it cannot be written ({reason(error)})",
                "Make room there, or set TMPDIR to another folder.",
            ) from None
        yield workshop.path


def tidy_scratch() -> None:
    """Remove the scratch folders of processes that died."""
    sweep_leftovers(Path(tempfile.gettempdir()))


def _identity(system: Any, path: str, facts: dict[str, Any]) -> dict[str, Any]:
    """Size, and what tells of a change; nothing where only the size is known."""
    if _version(facts) is None:  # a list does not hold all that is known
        try:
            facts = system.info(path)
        except Exception:  # whoever opens it says what is wrong
            return {}
    version = _version(facts)
    return {} if version is None else {"bytes": facts.get("size"), "version": version}


def _version(facts: dict[str, Any]) -> str | None:
    return next((str(facts[key]) for key in _VERSIONS if facts.get(key) is not None), None)
