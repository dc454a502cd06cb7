"""Where the results of a batch go: a folder that every process writes to, or a URL."""

import errno
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from dlgmd_cli.errors import OutputError, OutputExistsError
from dlgmd_cli.results.files import appearing
from dlgmd_cli.results.folder import RUN, ResultFolder
from dlgmd_cli.results.record import parse_record
from dlgmd_cli.results.workshop import Workshop, sweep_leftovers

try:
    import fcntl
except ImportError:  # Windows has other locks
    fcntl = None  # type: ignore[assignment]


@dataclass(frozen=True)
class Standing:
    """What stands where a result is to go: its record, empty if there is none, and its files."""

    record: dict[str, Any]
    files: frozenset[str]


class Place(Protocol):
    """Where results go; can be pickled, so that every process writes there itself."""

    def within(self, name: str) -> "Place":
        """A folder in it."""
        ...

    def prepare(self) -> None:
        """Make sure that it can be written, and remove what processes that died left there.

        Raises OutputError.
        """
        ...

    def locked(self) -> AbstractContextManager[None]:
        """Keeps other batches out, where that is possible; raises OutputExistsError."""
        ...

    def standing(self, results: Iterable[str]) -> Iterator[tuple[str, Standing]]:
        """What stands there of these results, if anything does."""
        ...

    def check(self, result: str) -> None:
        """Raise OutputExistsError if what stands at `result` may not be replaced."""
        ...

    def save(self, result: str, write: Callable[[Path], None]) -> None:
        """Let `write` fill a folder, and make that the result; raises OutputError."""
        ...

    def write_text(self, name: str, text: str) -> None:
        """Write a file, whole or not at all; raises OutputError."""
        ...

    def tidy(self) -> None:
        """Remove what processes that died left there."""
        ...

    def show(self, name: str = "") -> str:
        """How a user finds it, or a file in it."""
        ...


@dataclass(frozen=True)
class Folder:
    """A folder on this machine, or one that all machines share; see `Place`.

    `path` is absolute, for workers may be in another folder; `shown` is as the user has it.
    """

    path: Path
    shown: Path

    @classmethod
    def named(cls, text: str) -> "Folder":
        """The folder that a user means."""
        return cls(Path(os.path.abspath(text)), Path(text))

    def within(self, name: str) -> "Folder":
        """A folder in it."""
        return Folder(self.path / name, self.shown / name)

    def prepare(self) -> None:
        """Make it, if need be, and write something there."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with Workshop(self.path):
                pass
        except OSError as error:
            raise OutputError(
                self.show(),
                f"it cannot be written ({error.strerror or error})",
                "Choose another --out, or make room there.",
            ) from None

    @contextmanager
    def locked(self) -> Iterator[None]:
        """A lock on the folder itself, which leaves nothing behind and dies with the process."""
        if fcntl is None:
            yield
            return
        handle = os.open(self.path, os.O_RDONLY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                os.close(handle)
                raise OutputExistsError(
                    self.show(),
                    "another 'dlgmd batch' is writing here",
                    "Wait for it, or choose another --out.",
                ) from None
            # A file system without locks: results are whole even so.
        try:
            yield
        finally:
            os.close(handle)

    def standing(self, results: Iterable[str]) -> Iterator[tuple[str, Standing]]:
        """Read the records that are there."""
        for result in results:
            folder = self.path / result
            try:
                files = frozenset(path.name for path in folder.iterdir())
                text = (folder / RUN.record).read_bytes() if RUN.record in files else b""
            except OSError:
                continue
            yield result, Standing(parse_record(text), files)

    def check(self, result: str) -> None:
        """As `ResultFolder` does."""
        self._folder(result)

    def save(self, result: str, write: Callable[[Path], None]) -> None:
        """Through a `ResultFolder`."""
        with self._folder(result) as folder:
            folder.save(write)

    def write_text(self, name: str, text: str) -> None:
        """Through a file that takes its place."""
        with appearing(self.path / name) as (stand_in,):
            stand_in.write_text(text, encoding="utf-8", newline="")

    def tidy(self) -> None:
        """Sweep the hidden folders that results come from, all of which are in this one."""
        sweep_leftovers(self.path)

    def show(self, name: str = "") -> str:
        """Its path."""
        return str(self.shown / name)

    def _folder(self, result: str) -> ResultFolder:
        target = self.path / result
        return ResultFolder(target.parent, target.name, overwrite=True, scratch=self.path)
