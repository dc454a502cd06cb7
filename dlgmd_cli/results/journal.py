"""What a long computation has done so far, on disk as soon as it is there, so that it can go on."""

import json
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from dlgmd_cli.errors import OutputError, OutputExistsError

try:
    import fcntl
except ImportError:  # Windows has other locks
    fcntl = None  # type: ignore[assignment]

_HEADER = b'{"settings": {'
_MEND = "Choose another --out."


class Journal:
    """Context manager for a folder of results and, in it, a file with a line for every point.

    Nothing is changed before `begin`. Whatever ends the program, lines that were written stay; one
    that was cut off is dropped.

    Parameters
    ----------
    folder : Path
        Made if need be, and removed again if nothing came.
    name : str
        Name of the file.
    products : set of str
        Names of the other files that may be written there; `begin` removes earlier ones. Files
        with other names are never touched.
    settings : mapping
        All that the points depend on, as JSON can hold it.
    is_point : callable, optional
        Whether a number and values can be a point; from a line on where they cannot, the file is
        taken as damaged.
    overwrite : bool
        Start anew, whatever was computed before.

    Attributes
    ----------
    points : dict of int to list
        The points that are there.
    facts : dict
        What was noted beside them.

    Raises
    ------
    OutputExistsError
        If there is a result of other settings, or another program is writing it.
    OutputError
        If it cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        products: frozenset[str],
        settings: dict[str, Any],
        *,
        is_point: Callable[[int, Any], bool] = lambda point, values: True,
        overwrite: bool = False,
    ) -> None:
        self.folder = folder
        self._path, self._products = folder / name, products
        # As it reads back: without tuples.
        self._settings: dict[str, Any] = json.loads(json.dumps(settings))
        self._is_point, self._overwrite = is_point, overwrite
        self._made: list[Path] = []
        self.points: dict[int, Any] = {}
        self.facts: dict[str, Any] = {}

    def __enter__(self) -> "Journal":
        try:
            self._check_folder()
            self._make_folders()
            self._file = self._open()
            try:
                self._n_good = self._read()
            except BaseException:
                self._close()
                raise
        except BaseException as error:
            self._remove_made()
            if isinstance(error, OSError):
                raise self._failure(error) from None
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._close()
        self._remove_made()

    def _close(self) -> None:
        """Let go of the file, and of the lock; without a line it is removed before."""
        with suppress(OSError):
            if self._path.stat().st_size == 0:
                self._path.unlink()
        with suppress(OSError):
            self._file.close()

    def begin(self) -> None:
        """Make ready for `add`: drop what was cut off, or is to be overwritten."""
        try:
            self._file.truncate(self._n_good)
            self._file.seek(self._n_good)
            if self._n_good == 0:
                for product in self._products:
                    (self.folder / product).unlink(missing_ok=True)
                self._write({"settings": self._settings})
                self._made.clear()
        except OSError as error:
            raise self._failure(error) from None

    def add(self, point: int, values: Any) -> None:
        """Keep the values of a point."""
        self._write([point, values])
        self.points[point] = values

    def note(self, facts: dict[str, Any]) -> None:
        """Keep something beside the points."""
        self._write({"facts": facts})
        self.facts = facts

    def _write(self, entry: Any) -> None:
        """Append a line, at once."""
        try:
            self._file.write(json.dumps(entry).encode() + b"\n")
            self._file.flush()
        except OSError as error:
            raise self._failure(error) from None

    def _check_folder(self) -> None:
        """Refuse what is no folder, or holds files of these names that are not ours."""
        if self.folder.is_symlink() or (self.folder.exists() and not self.folder.is_dir()):
            raise OutputExistsError(str(self.folder), "this is no folder of results", _MEND)
        found = self._products & {path.name for path in self.folder.glob("*")}
        if found and not self._path.exists():
            raise self._foreign(min(found))

    def _make_folders(self) -> None:
        """Make the folder and those above it, remembering which were missing."""
        missing = [path for path in (self.folder, *self.folder.parents) if not path.exists()]
        for path in reversed(missing):
            path.mkdir(exist_ok=True)
            self._made.append(path)

    def _remove_made(self) -> None:
        """Remove the folders that were made for nothing."""
        for path in reversed(self._made):
            try:
                path.rmdir()
            except OSError:  # someone else uses it by now
                break

    def _open(self) -> IO[bytes]:
        """The file, locked where the system can: the lock dies with the process."""
        while True:
            file = self._path.open("ab+")
            if fcntl is None:
                return file
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                file.close()
                raise OutputExistsError(
                    str(self.folder),
                    "another 'dlgmd' is writing here",
                    "Wait for it, or choose another --out.",
                ) from None
            except OSError:  # a file system without locks
                return file
            # Between opening and locking, whoever made it may have removed it.
            if self._path.exists() and os.path.samestat(os.fstat(file.fileno()), self._path.stat()):
                return file
            file.close()

    def _read(self) -> int:
        """Take over what is there, and return how many bytes of it are good."""
        self._file.seek(0)
        start = self._file.readline()
        if not (start.startswith(_HEADER) or _HEADER.startswith(start)):
            raise self._foreign(self._path.name)
        header = _parsed(start)
        if header is None or self._overwrite:
            return 0
        self._check_settings(header["settings"])
        n_good = len(start)
        for line in self._file:
            entry = _parsed(line)
            if isinstance(entry, dict):
                self.facts = entry.get("facts", {})
            elif entry is not None and self._is_point(*entry):
                self.points[entry[0]] = entry[1]
            else:
                break
            n_good += len(line)
        return n_good

    def _check_settings(self, settings: Any) -> None:
        """Refuse to go on with what was computed otherwise."""
        differing = [
            key
            for key in {**self._settings, **settings}
            if settings.get(key) != self._settings.get(key)
        ]
        if differing:
            raise OutputExistsError(
                str(self.folder),
                f"a result of other settings stands here ({', '.join(differing)})",
                "Add --overwrite to start anew, or choose another --out.",
            )

    def _foreign(self, name: str) -> OutputExistsError:
        return OutputExistsError(
            str(self.folder), f"this folder holds other files, such as {name}", _MEND
        )

    def _failure(self, error: OSError) -> OutputError:
        return OutputError(
            str(self.folder),
            f"the result cannot be written ({error.strerror or error})",
            "Choose another --out, or make room there.",
        )


def _parsed(line: bytes) -> Any:
    """What a line holds, a mapping or a number with values; None if it was cut off."""
    try:
        entry = json.loads(line) if line.endswith(b"\n") else None
    except ValueError:
        return None
    is_point = isinstance(entry, list) and len(entry) == 2 and isinstance(entry[0], int)
    return entry if is_point or isinstance(entry, dict) else None
