"""A folder of results that appears whole or not at all."""

import os
import secrets
import shutil
from collections.abc import Callable
from pathlib import Path

from dlgmd_cli.errors import OutputError, OutputExistsError
from dlgmd_cli.results.tables import TABLES

RECORD_NAME = "run.yaml"
PLOT_NAMES = ("mp", "attenuation", "spikes")
PLOT_FORMATS = ("png", "pdf", "svg")
_OWN_NAMES = frozenset(
    {RECORD_NAME, *TABLES, *(f"{plot}.{kind}" for plot in PLOT_NAMES for kind in PLOT_FORMATS)}
)


class ResultFolder:
    """Context manager: proves at once that it can write, and is filled by `save`.

    Parameters
    ----------
    out : Path
        Folder that the result goes into; made if need be, and removed again if nothing came.
    name : str
        Name of the result.
    overwrite : bool
        Replace an earlier result. Anything else that bears the name is never touched.

    Raises
    ------
    OutputExistsError
        If something that may not be replaced stands there.
    OutputError
        If the folder cannot be written.
    """

    def __init__(self, out: Path, name: str, *, overwrite: bool = False) -> None:
        self.target = out / (name if name.strip(".") else f"video{name}")
        self.partial = out / f".dlgmd-{secrets.token_hex(8)}"
        self._old = out / f".dlgmd-{secrets.token_hex(8)}"
        self._made: list[Path] = []
        self._overwrite = overwrite
        self._check_target()

    def _check_target(self) -> None:
        """Refuse to replace what is not ours to replace."""
        if not (self.target.exists() or self.target.is_symlink()):
            return
        if self.target.is_symlink() or not self.target.is_dir():
            raise OutputExistsError(
                str(self.target), "this is no folder of results", "Choose another --out."
            )
        found = {path.name for path in self.target.iterdir()}
        foreign = sorted(found - _OWN_NAMES)
        if foreign or (found and RECORD_NAME not in found):
            shown = (foreign or sorted(found))[0]
            raise OutputExistsError(
                str(self.target),
                f"this folder holds other files, such as {shown}",
                "Choose another --out.",
            )
        if found and not self._overwrite:
            raise OutputExistsError(
                str(self.target),
                "a result stands here already",
                "Add --overwrite to replace it, or choose another --out.",
            )

    def __enter__(self) -> "ResultFolder":
        try:
            self._make_out()
            self.partial.mkdir()
        except OSError as error:
            self._clean()
            raise self._failure(error) from None
        return self

    def _make_out(self) -> None:
        """Make the folders above `target`, remembering which were missing."""
        missing = [self.target.parent, *self.target.parent.parents]
        for folder in reversed([path for path in missing if not path.exists()]):
            folder.mkdir(exist_ok=True)
            self._made.append(folder)

    def __exit__(self, *_: object) -> None:
        self._clean()

    def save(self, write: Callable[[Path], None]) -> None:
        """Let `write` fill a folder, and make that the target, in place of an earlier result.

        Raises
        ------
        OutputExistsError
            If a result appeared there while this one was being computed.
        OutputError
            If it cannot be written; what stood there stays.
        """
        try:
            self.partial.mkdir(parents=True, exist_ok=True)  # it may have been swept away
            write(self.partial)
            self._check_target()
            self._swap()
        except OSError as error:
            raise self._failure(error) from None

    def _swap(self) -> None:
        """Rename the partial folder to the target; on failure the earlier result comes back."""
        if self.target.exists():
            self.target.rename(self._old)
        try:
            self.partial.rename(self.target)
        except BaseException:
            if self._old.exists():
                self._old.rename(self.target)
            raise
        shutil.rmtree(self._old, ignore_errors=True)
        self._made.clear()

    def _clean(self) -> None:
        """Remove what is not a result: the partial folder, and folders made for nothing."""
        shutil.rmtree(self.partial, ignore_errors=True)
        for folder in reversed(self._made):
            try:
                folder.rmdir()
            except OSError:  # someone else uses it by now
                break

    def _failure(self, error: OSError) -> OutputError:
        reason = error.strerror or str(error)
        return OutputError(
            os.fspath(self.target),
            f"the result cannot be written ({reason})",
            "Choose another --out, or make room there.",
        )
