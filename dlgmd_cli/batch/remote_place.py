"""Results behind a URL, such as s3://bucket/results: see `Place`."""

import posixpath
import secrets
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dlgmd_cli.batch.places import Folder, Place, Standing
from dlgmd_cli.batch.remote import file_system, is_url, reason, scratch
from dlgmd_cli.errors import DlgmdError, OutputError, OutputExistsError, ParameterError
from dlgmd_cli.results.folder import KINDS, RUN
from dlgmd_cli.results.record import parse_record
from dlgmd_cli.runs.serve import note

# Stores without folders, where a file appears whole, and making a folder would make a bucket.
_STORES = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oss", "oci", "r2"})
# Records are read so many at a time, since each is a journey.
_READERS = 16


def place_at(text: str) -> Place:
    """The place that a user means: a folder, or a URL; raises as `file_system`."""
    if not is_url(text):
        return Folder.named(text)
    path = file_system(text)[1]
    if text.lower().startswith("file://"):
        return Folder.named(path)
    if not path:
        raise ParameterError(text, "it names no folder", "Give one, such as s3://bucket/results.")
    return Bucket(text.rstrip("/"))


@dataclass(frozen=True)
class Bucket:
    """A folder behind a URL; see `Place`.

    Nothing can be renamed there as a whole, so that run.yaml, which goes first and comes last,
    tells that a result is whole.
    """

    url: str

    def within(self, name: str) -> "Bucket":
        """A folder in it."""
        return Bucket(f"{self.url}/{name}")

    def prepare(self) -> None:
        """Write something there, and remove it."""
        try:
            system, base = self._open()
            probe = f"{base}/.dlgmd-{secrets.token_hex(8)}"
            _put(system, b"", probe)
        except Exception as error:
            raise self._failure("", error) from None
        with suppress(Exception):
            system.rm_file(probe)

    def locked(self) -> AbstractContextManager[None]:
        """There are no locks; results are whole even so."""
        return nullcontext()

    def standing(self, results: Iterable[str]) -> Iterator[tuple[str, Standing]]:
        """List all that is there, then read the records."""
        system, base = self._open()
        try:
            system.invalidate_cache()
            paths = system.find(base)
        except FileNotFoundError:
            return
        except Exception as error:
            raise OutputError(self.url, f"it cannot be read ({reason(error)})") from None
        files: dict[str, set[str]] = {}
        for path in paths:
            folder, _, name = path[len(base) + 1 :].rpartition("/")
            files.setdefault(folder, set()).add(name)

        def read(result: str) -> bytes:
            if RUN.record not in files[result]:
                return b""
            try:
                return bytes(system.cat_file(f"{base}/{result}/{RUN.record}"))
            except Exception:  # as if it were not there: it is computed again
                return b""

        there = [result for result in results if result in files]
        with ThreadPoolExecutor(_READERS) as readers:
            for result, text in zip(there, readers.map(read, there), strict=True):
                yield result, Standing(parse_record(text), frozenset(files[result]))

    def check(self, result: str) -> None:
        """Raise OutputExistsError if files of others stand there."""
        system, base = self._open()
        names = _names_in(system, f"{base}/{result}")
        strays = names.difference(*(kind.names for kind in KINDS))
        if strays and not any(kind.record in names for kind in KINDS):
            raise OutputExistsError(
                self.show(result),
                f"this folder holds other files, such as {min(strays)}",
                "Choose another --out.",
            )

    def save(self, result: str, write: Callable[[Path], None]) -> None:
        """Copy what was written there; other files beside it stay."""
        with scratch() as folder:
            try:
                write(folder)
            except OSError as error:
                raise self._failure(result, error) from None
            new = {path.name for path in folder.iterdir()}
            try:
                system, base = self._open()
                place = f"{base}/{result}"
                old = _names_in(system, place) & RUN.names
                for name in sorted(old, key=lambda name: name != RUN.record):
                    if name == RUN.record or name not in new:
                        system.rm_file(f"{place}/{name}")
                for name in sorted(new, key=lambda name: (name == RUN.record, name)):
                    note(None)
                    _put(system, (folder / name).read_bytes(), f"{place}/{name}")
            except Exception as error:
                raise self._failure(result, error) from None

    def write_text(self, name: str, text: str) -> None:
        """Write a file, whole or not at all."""
        try:
            system, base = self._open()
            _put(system, text.encode(), f"{base}/{name}")
        except Exception as error:
            raise self._failure(name, error) from None

    def tidy(self) -> None:
        """Nothing is left behind there."""

    def show(self, name: str = "") -> str:
        """Its URL."""
        return f"{self.url}/{name}" if name else self.url

    def _open(self) -> tuple[Any, str]:
        return file_system(self.url)

    def _failure(self, name: str, error: Exception) -> DlgmdError:
        if isinstance(error, DlgmdError):
            return error
        return OutputError(
            self.show(name),
            f"it cannot be written ({reason(error)})",
            "Choose another --out, or mend the access to it.",
        )


def _names_in(system: Any, path: str) -> set[str]:
    """What stands in a folder, as it is now; nothing if it cannot be told."""
    try:
        system.invalidate_cache()
        names = system.ls(path, detail=False)
    except Exception:  # nothing there; what else is wrong, writing says
        return set()
    return {posixpath.basename(str(name).rstrip("/")) for name in names} - {""}


def _put(system: Any, data: bytes, path: str) -> None:
    """Write a file that appears whole."""
    kinds = (system.protocol,) if isinstance(system.protocol, str) else system.protocol
    if not _STORES.isdisjoint(kinds):
        system.pipe_file(path, data)
        return
    folder = posixpath.dirname(path)
    system.makedirs(folder, exist_ok=True)
    stand_in = f"{folder}/.dlgmd-{secrets.token_hex(8)}"
    try:
        system.pipe_file(stand_in, data)
        with suppress(FileNotFoundError):
            system.rm_file(path)
        system.mv(stand_in, path)
    except BaseException:
        with suppress(Exception):
            system.rm_file(stand_in)
        raise
