"""Results behind a URL, such as s3://bucket/results: see `Place`."""

import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dlgmd_cli.batch.places import Folder, Place, Standing
from dlgmd_cli.batch.remote import file_system, is_url, reason
from dlgmd_cli.errors import OutputError, OutputExistsError
from dlgmd_cli.results.folder import RUN
from dlgmd_cli.results.record import parse_record


def place_at(text: str) -> Place:
    """The place that a user means: a folder, or a URL."""
    if text.startswith("file://"):
        text = file_system(text)[1]
    return Bucket(text.rstrip("/")) if is_url(text) else Folder.named(text)


@dataclass(frozen=True)
class Bucket:
    """A folder behind a URL; see `Place`.

    Nothing can be renamed there as a whole, so that run.yaml, which comes last, tells that a
    result is whole.
    """

    url: str

    def within(self, name: str) -> "Bucket":
        """A folder in it."""
        return Bucket(f"{self.url}/{name}")

    def prepare(self) -> None:
        """Write something there, and remove it."""
        self.write_text(".dlgmd-probe", "")
        system, path = self._at(".dlgmd-probe")
        with suppress(Exception):
            system.rm_file(path)

    def locked(self) -> AbstractContextManager[None]:
        """There are no locks; results are whole even so."""
        return nullcontext()

    def standing(self, results: Iterable[str]) -> Iterator[tuple[str, Standing]]:
        """List all that is there, then read the records."""
        system, base = self._at()
        try:
            system.invalidate_cache()
            paths = system.find(base)
        except FileNotFoundError:
            return
        except Exception as error:
            raise OutputError(self.url, f"it cannot be read ({reason(error)})") from None
        files: dict[str, set[str]] = {}
        for path in paths:
            folder, _, name = path[len(base.rstrip("/")) + 1 :].rpartition("/")
            files.setdefault(folder, set()).add(name)
        for result in results:
            if result not in files:
                continue
            text = b""
            if RUN.record in files[result]:
                with suppress(Exception):
                    text = system.cat_file(self._at(f"{result}/{RUN.record}")[1])
            yield result, Standing(parse_record(text), frozenset(files[result]))

    def check(self, result: str) -> None:
        """Raise OutputExistsError if files of others stand there."""
        system, path = self._at(result)
        try:
            names = {name.rstrip("/").rpartition("/")[2] for name in system.ls(path, detail=False)}
        except Exception:  # nothing there; what else is wrong, saving says
            return
        strays = names - RUN.names
        if RUN.record not in names and strays:
            raise OutputExistsError(
                self.show(result),
                f"this folder holds other files, such as {min(strays)}",
                "Choose another --out.",
            )

    def save(self, result: str, write: Callable[[Path], None]) -> None:
        """Copy what was written there; run.yaml goes first and comes last."""
        with tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
            try:
                write(Path(folder))
            except OSError as error:
                raise self._failure(result, error) from None
            names = sorted(path.name for path in Path(folder).iterdir())
            try:
                system, record = self._at(f"{result}/{RUN.record}")
                if system.exists(record):
                    system.rm_file(record)
                system.makedirs(self._at(result)[1], exist_ok=True)
                for name in [*(name for name in names if name != RUN.record), RUN.record]:
                    system.put_file(str(Path(folder, name)), self._at(f"{result}/{name}")[1])
            except Exception as error:
                raise self._failure(result, error) from None

    def write_text(self, name: str, text: str) -> None:
        """Write a file at once; most such places show a file only once it is whole."""
        system, path = self._at(name)
        try:
            system.makedirs(system._parent(path), exist_ok=True)
            system.pipe_file(path, text.encode())
        except Exception as error:
            raise self._failure(name, error) from None

    def tidy(self) -> None:
        """Nothing is left behind there."""

    def show(self, name: str = "") -> str:
        """Its URL."""
        return f"{self.url}/{name}" if name else self.url

    def _at(self, name: str = "") -> tuple[Any, str]:
        return file_system(self.show(name))

    def _failure(self, name: str, error: BaseException) -> OutputError:
        return OutputError(
            self.show(name),
            f"it cannot be written ({reason(error)})",
            "Choose another --out, or mend the access to it.",
        )
