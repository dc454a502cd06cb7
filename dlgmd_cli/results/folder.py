"""A folder of results, into which what a command makes comes whole or not at all."""

import errno
import os
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from dlgmd_cli.errors import OutputError, OutputExistsError
from dlgmd_cli.results.tables import TABLES
from dlgmd_cli.results.workshop import PREFIX, Workshop

PLOT_FORMATS = ("png", "pdf", "svg")


@dataclass(frozen=True)
class Kind:
    """What one command makes of an input: its record, and all files that it may write."""

    record: str
    names: frozenset[str]

    @classmethod
    def of(cls, record: str, files: Iterable[str], plots: Iterable[str]) -> "Kind":
        """A kind with `plots` in any of the formats."""
        drawn = (f"{plot}.{suffix}" for plot in plots for suffix in PLOT_FORMATS)
        return cls(record, frozenset({record, *files, *drawn}))


RUN_PLOTS = ("mp", "attenuation", "spikes")
RUN = Kind.of("run.yaml", TABLES, RUN_PLOTS)
COMPARISON = Kind.of("compare.yaml", ("compare.csv",), ("compare-mp", "compare-attenuation"))
LAYERS = Kind.of("layers.yaml", ("layers.npz",), ("layers",))
# Results of several kinds share a folder: it is named after the input.
KINDS = (RUN, COMPARISON, LAYERS)


class ResultFolder:
    """Context manager: proves at once that it can write, and is filled by `save`.

    What other commands made of the same input stays as it is, and so do other files beside it.

    Parameters
    ----------
    out : Path
        Folder that the result goes into; made if need be, and removed again if nothing came.
    name : str
        Name of the result.
    kind : Kind
        Which files are this result's.
    overwrite : bool
        Replace an earlier result of this kind. What is no result of ours is never touched.
    scratch : Path, optional
        Where it is kept until it is whole, and what killed processes left is swept away: `out`,
        unless given, or a folder above it.

    Raises
    ------
    OutputExistsError
        If something that may not be replaced stands there.
    OutputError
        If the folder cannot be written.
    """

    def __init__(
        self,
        out: Path,
        name: str,
        kind: Kind = RUN,
        *,
        overwrite: bool = False,
        scratch: Path | None = None,
    ) -> None:
        self.target = out / (name if name.strip(".") else f"video{name}")
        self._workshop = Workshop(scratch or out, self._make_out)
        self._made: list[Path] = []
        self._kind, self._overwrite = kind, overwrite
        self._check_target()

    @property
    def partial(self) -> Path:
        """The hidden folder that the result comes from."""
        return self._workshop.path

    def _check_target(self) -> None:
        """Refuse to replace what is not ours to replace."""
        if not (self.target.exists() or self.target.is_symlink()):
            return
        if self.target.is_symlink() or not self.target.is_dir():
            raise OutputExistsError(
                str(self.target), "this is no folder of results", "Choose another --out."
            )
        found = {
            path.name: path.is_dir()
            for path in self.target.iterdir()
            if not path.name.startswith(PREFIX)  # some file that was never finished
        }
        # Beside a result, other files are kept; a folder of a user's is not taken for one. Only
        # files of these names, and no record, are a result that was cut off or not wholly removed.
        is_half = self._overwrite and found.keys() <= self._kind.names
        is_result = is_half or any(kind.record in found for kind in KINDS)
        is_known = is_half or self._kind.record in found
        strays = frozenset() if is_known else self._kind.names
        rest = [
            name
            for name, is_folder in found.items()
            if is_folder or not is_result or name in strays
        ]
        if rest:
            shown = min(rest)
            raise OutputExistsError(
                str(self.target),
                f"this folder holds other files, such as {shown}",
                "Choose another --out.",
            )
        if self._kind.record in found and not self._overwrite:
            raise OutputExistsError(
                str(self.target),
                "a result stands here already",
                "Add --overwrite to replace it, or choose another --out.",
            )
        if not os.access(self.target, os.W_OK | os.X_OK):
            raise self._failure(PermissionError(errno.EACCES, os.strerror(errno.EACCES)))

    def __enter__(self) -> "ResultFolder":
        try:
            self._workshop.__enter__()
            self._check_target()  # an earlier result may have come back
        except BaseException as error:
            self._clean()
            if isinstance(error, OSError):
                raise self._failure(error) from None
            raise
        return self

    def _make_out(self) -> None:
        """Make the folders above `target`, remembering which were missing."""
        missing = [self.target.parent, *self.target.parent.parents]
        for folder in reversed([path for path in missing if not path.exists()]):
            folder.mkdir(exist_ok=True)
            if folder not in self._made:
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
            self._workshop.renew()  # it may have been swept away
            made = self.partial / "result"
            made.mkdir()
            write(made)
            self._check_target()
            self._keep_others(made)
            self._make_out()
            self._workshop.put(made, self.target)
            self._made.clear()
        except OSError as error:
            raise self._failure(error) from None

    def _keep_others(self, made: Path) -> None:
        """Put what other commands made beside what this one did."""
        if self.target.exists():
            for path in self.target.iterdir():
                if path.name not in self._kind.names and not path.name.startswith(PREFIX):
                    copy = made / path.name
                    try:
                        os.link(path, copy, follow_symlinks=False)
                    except OSError:  # not every file system has links
                        shutil.copy2(path, copy, follow_symlinks=False)

    def _clean(self) -> None:
        """Remove what is not a result: the partial folder, and folders made for nothing."""
        self._workshop.__exit__()
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
