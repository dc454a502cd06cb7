"""Files: temporary folders for what is not complete yet, and opening nothing but regular files."""

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

# Temporary files and folders begin with it. Other files in a result folder are never removed.
PREFIX = ".dlgmd-"
LOCK = f"{PREFIX}lock"


@contextmanager
def staging(folder: Path) -> Iterator[Path]:
    """Yield a new folder inside `folder` for files that are not complete yet; removed at the end.

    What killed processes have left in `folder` is removed first. Raises OSError.
    """
    is_nested = folder.name.startswith(PREFIX)  # and in use by this process alone
    with ExitStack() as holding:
        # Nobody else may take the new folder for a left-over one.
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
    """Remove temporary files and folders of killed processes; those in use stay.

    A temporary folder is in use as long as its process holds a lock on it. Where the system has no
    such locks, folders are never removed.
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
    """Hold the system's lock on a folder; yields whether that succeeded."""
    if fcntl is None:
        yield False
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        is_held = True
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except OSError:  # another process holds it, or the file system has no locks
            is_held = False
        yield is_held
    finally:
        os.close(descriptor)


def open_regular(path: Path, mode: str = "r", **options: Any) -> IO[Any]:
    """Open a file for reading, as `Path.open` does.

    Opening a pipe or a device could wait for ever: an OSError says that it is no regular file.
    """
    if "://" not in str(path) and path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file")
    return path.open(mode, **options)
