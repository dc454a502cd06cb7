"""Hidden folders for what is being made, which are removed even when their maker was killed."""

import hashlib
import os
import platform
import secrets
import shutil
from collections.abc import Callable
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows has other locks
    fcntl = None  # type: ignore[assignment]

PREFIX = ".dlgmd-"
# Where the earlier result waits while a new one takes its place, and what its place is.
_EARLIER, _PLACE = "earlier", "place"
# Others may remove the folder that the new one was to stand in, or take it for a dead one.
_ATTEMPTS = 8


class Workshop:
    """Context manager with a folder of its own, locked for as long as the process lives.

    Parameters
    ----------
    beside : Path
        Folder in which it is made, on the file system of what is to be made.
    prepare : callable, optional
        Makes `beside`; called again should that be removed.

    Attributes
    ----------
    path : Path
        The folder.
    """

    def __init__(self, beside: Path, prepare: Callable[[], None] = lambda: None) -> None:
        self._beside, self._prepare = beside, prepare
        self._lock: int | None = None
        self.path = self._new_path()

    def __enter__(self) -> "Workshop":
        """Sweep away what the dead left there, and make the folder; OSError passes through."""
        self._prepare()
        sweep_leftovers(self._beside)
        self._make()
        return self

    def __exit__(self, *_: object) -> None:
        _dispose(self.path)
        self._unlock()

    def renew(self) -> None:
        """Make the folder again if someone removed it."""
        if not _is_at(self._lock, self.path):
            self._unlock()
            self._make()

    def put(self, made: Path, target: Path) -> None:
        """Rename a folder made here to `target`, in place of what stands there.

        Should this be cut short, what stood there comes back: as the workshop is left, or when
        the next process sweeps. OSError passes through.
        """
        earlier = self.path / _EARLIER
        if target.exists():
            place = os.path.relpath(target, self._beside)
            (self.path / _PLACE).write_bytes(os.fsencode(place))
            target.rename(earlier)
        made.rename(target)
        shutil.rmtree(earlier, ignore_errors=True)

    def _make(self) -> None:
        """Make the folder and lock it."""
        for attempt in range(_ATTEMPTS):
            self.path = self._new_path()
            try:
                self._prepare()
                self.path.mkdir(mode=0o700)
                self._lock = _lock(self.path)
                if _is_at(self._lock, self.path):
                    return
            except (FileNotFoundError, FileExistsError, BlockingIOError):
                if attempt == _ATTEMPTS - 1:
                    raise
            self._unlock()

    def _new_path(self) -> Path:
        return self._beside / f"{PREFIX}{_host()}{secrets.token_hex(4)}"

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def sweep_leftovers(folder: Path) -> None:
    """Remove the workshops in `folder` whose makers are dead, and bring earlier results back.

    Only those of this machine: of others it is not known whether they live, since not every file
    system shares its locks. Where there are no locks, nothing is removed.
    """
    try:
        found = [path for path in folder.iterdir() if path.name.startswith(PREFIX + _host())]
    except OSError:
        return
    for path in found:
        try:
            lock = _lock(path)
        except OSError:  # its maker lives, or someone else sweeps
            continue
        if lock is not None:
            if _is_at(lock, path):
                _dispose(path)
            os.close(lock)


def _host() -> str:
    """Eight hexadecimal digits that tell this machine from others."""
    return hashlib.blake2b(platform.node().encode("utf-8", "replace"), digest_size=4).hexdigest()


def _lock(path: Path) -> int | None:
    """A descriptor that holds the lock of a folder; None if there are no locks.

    Raises BlockingIOError if another holds it, and OSError if there is no such folder.
    """
    if fcntl is None:
        return None
    lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        raise
    except OSError:  # a file system without locks
        os.close(lock)
        return None
    return lock


def _is_at(lock: int | None, path: Path) -> bool:
    """Whether the folder that a descriptor holds is still the one of this name."""
    try:
        return path.is_dir() if lock is None else os.path.samestat(os.fstat(lock), path.lstat())
    except OSError:
        return False


def _dispose(path: Path) -> None:
    """Remove a workshop, unless the only copy of an earlier result is in it."""
    if _restore(path):
        shutil.rmtree(path, ignore_errors=True)


def _restore(path: Path) -> bool:
    """Bring an earlier result back if its place is empty; False if that fails."""
    earlier = path / _EARLIER
    if not earlier.is_dir():
        return True
    try:
        place = Path(os.fsdecode((path / _PLACE).read_bytes()))
        if place.is_absolute() or ".." in place.parts:  # none of ours
            return False
        target = path.parent / place
        if not os.path.lexists(target):
            earlier.rename(target)
    except OSError:
        return False
    return True
