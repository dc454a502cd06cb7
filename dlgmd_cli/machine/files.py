"""Temporary folders for incomplete files, and opening of regular files only."""

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import IO, Any

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

# Names of temporary files and folders begin with PREFIX; nothing else is removed as left over.
PREFIX = ".dlgmd-"
LOCK = f"{PREFIX}lock"


@contextmanager
def staging(folder: Path) -> Iterator[Path]:
    """Yield a new folder inside `folder` for incomplete files; at the end, it is removed.

    Left-overs of killed processes in `folder` are removed first. Raises OSError.
    """
    is_nested = folder.name.startswith(PREFIX)  # a temporary folder that only this process uses
    with ExitStack() as holding:
        # The lock keeps other processes from removing the new folder as left over.
        with nullcontext() if is_nested else _held(folder, wait=True):
            remove_leftovers(folder)
            stage = Path(tempfile.mkdtemp(prefix=PREFIX, dir=folder))
            holding.enter_context(_held(stage, wait=False))
        try:
            yield stage
        finally:
            shutil.rmtree(stage, ignore_errors=True)


def is_locked(folder: str | os.PathLike[str]) -> bool:
    """Whether a folder is visible from this machine and locked by some process."""
    return (Path(folder) / LOCK).exists()


def remove_leftovers(folder: Path) -> None:
    """Remove temporary files and folders of killed processes, but no folder in use.

    A temporary folder is in use as long as its process holds a lock on it. On systems without
    folder locks, folders are never removed.
    """
    with suppress(OSError):
        for path in folder.iterdir():
            if not path.name.startswith(PREFIX) or path.name == LOCK:
                continue
            with suppress(OSError):
                if path.is_dir() and not path.is_symlink():
                    with _held(path, wait=False) as is_held:
                        if is_held:
                            shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink()


@contextmanager
def _held(folder: Path, *, wait: bool) -> Iterator[bool]:
    """Hold the system's lock on a folder; yields whether the lock was acquired."""
    if fcntl is None:
        yield False
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        is_held = True
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except OSError:  # another process holds the lock, or the file system has no locks
            is_held = False
        yield is_held
    finally:
        os.close(descriptor)


def open_regular(path: Path, mode: str = "r", **options: Any) -> IO[Any]:
    """Open a file for reading, as `Path.open` does.

    Opening a pipe or a device could block forever; it raises an OSError instead.
    """
    if "://" not in str(path) and path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file")
    return path.open(mode, **options)
