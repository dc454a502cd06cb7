"""Writing files, and result folders: a result is complete if and only if its record exists.

All files of a result are first written into a temporary folder. When they are complete, the old
record is removed, then each file is renamed, the record last. An error or a killed process before
the removal leaves the earlier result unchanged. In a bucket, files are uploaded in the same order.
"""

import errno
import logging
import os
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from dlgmd_cli.errors import (
    INSTALL_EXTRA,
    DlgmdError,
    MissingExtraError,
    OutputError,
    OutputExistsError,
    ParameterError,
    ResultError,
    argument,
    overwrite_hint,
)
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.files import LOCK, PREFIX, staging
from dlgmd_cli.parameters.checks import require_known, similar_path
from dlgmd_cli.parameters.facts import InputFacts
from dlgmd_cli.results.files import COMPARISON as COMPARISON
from dlgmd_cli.results.files import FIGURE_FORMATS, FILES, formats_of, names_of
from dlgmd_cli.results.files import LAYERS as LAYERS
from dlgmd_cli.results.files import RUN as RUN
from dlgmd_cli.results.record import differences, read_record

if TYPE_CHECKING:
    from upath import UPath

_log = logging.getLogger(__name__)

Write = Callable[[Path], object]

# The table in the top folder of a batch.
SUMMARY = "summary.csv"
_MAX_NAME_BYTES = 200
# Errors of file systems without locks.
_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP)


def known_formats(formats: Iterable[str], record: str = "") -> tuple[str, ...]:
    """One or several formats without repetition; raises ParameterError if one is unknown.

    The formats are those of figures, and those of the other files of a `record`.
    """
    known = (formats,) if isinstance(formats, str) else tuple(dict.fromkeys(formats))
    for form in known:
        require_known("format", form, formats_of(record))
    return known


def place(text: str | os.PathLike[str]) -> "Path | UPath":
    """The folder for a path or a URL such as ``s3://bucket/results``.

    Raises ParameterError if the URL is of an unknown kind, or does not name a folder, and
    MissingExtraError if the packages for such URLs are not installed.
    """
    if not is_url(text):
        return Path(text)
    url = os.fspath(text)
    if url.startswith(("file://", "local://")):
        return Path(url.partition("://")[2])
    try:
        from upath import UPath

        folder = UPath(url)
        if not folder.fs or not folder.path.strip("/"):
            raise ParameterError(url, "names no folder", "Give one, as s3://bucket/results.")
        return UPath(url.rstrip("/"))
    except ImportError as error:
        why = f"URLs of this kind cannot be used ({error})"
        hint = f"{INSTALL_EXTRA.format('cluster')}, and install the package of that kind of URL."
        raise MissingExtraError(url, why, hint) from None
    except ValueError:
        kind = url.partition("://")[0]
        raise ParameterError(url, f"there is no kind of URL called {kind}://") from None
    except (OSError, EOFError) as error:  # EOFError: the server hung up
        why = f"cannot be reached ({failure_text(error)})"
        raise OutputError(url, why, "Check the URL, and that its server is up.") from None


def is_url(text: str | os.PathLike[str]) -> bool:
    """Whether a name is a URL such as ``s3://bucket/flights``."""
    return "://" in os.fspath(text)


def require_local(folder: str | os.PathLike[str], named_by: str = "out") -> None:
    """Raise ParameterError for a URL, also for a URL as a `Path`, which has only one slash."""
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]+:/", os.fspath(folder)):
        hint = "Give a folder. Only the results of 'dlgmd batch' may go to a URL."
        raise ParameterError("", f"{argument(named_by)} {folder} is a URL", hint)


def fitting(name: str) -> str:
    """A file name, shortened if necessary so that a suffix still fits on any file system."""
    encoded = os.fsencode(name)
    if len(encoded) <= _MAX_NAME_BYTES:
        return name
    return encoded[:_MAX_NAME_BYTES].decode(errors="ignore")


def result_folder(out: Path, name: str) -> Path:
    """The result folder of the input called `name`."""
    return out / (name if name.strip(".") else f"video{name}")


def tree_at(path: Path) -> Path | None:
    """The tree of results that a path stands for; None if the path is a result, or is missing.

    A tree is a folder that is not itself a result, or the folder of a batch's summary.csv.
    """
    if path.name == SUMMARY and path.is_file():
        return path.parent
    is_result = any((path / record).exists() for record in (RUN, COMPARISON))
    return path if path.is_dir() and not is_result else None


def with_results(paths: Iterable[Path]) -> list[Path]:
    """The paths, with each tree replaced by its results' folders that are not yet in the list.

    Raises ResultError if a path is missing, or a tree holds no result.
    """
    folders: list[Path] = []
    for path in paths:
        if not path.exists():
            hint = similar_path(path) or "Run 'dlgmd run' first."
            raise ResultError(str(path), "there is no such folder", hint)
        tree = tree_at(path)
        if tree is None:
            folders.append(path)
            continue
        below = {path.parent for path in records_below(tree, RUN, COMPARISON)}
        if not below:
            why = f"contains no result (no {RUN} or {COMPARISON})"
            raise ResultError(str(tree), why, "Run 'dlgmd run' or 'dlgmd batch' first.")
        folders += sorted(below - set(folders))
    return folders


def records_below(tree: Path, *records: str) -> list[Path]:
    """The records below a folder, sorted, without incomplete results of killed processes."""
    paths = (path for record in records for path in tree.rglob(record) if path.is_file())
    return sorted(path for path in paths if not path.parent.name.startswith(PREFIX))


def check_place(
    folder: "Path | UPath",
    record: str,
    identity: InputFacts,
    *,
    overwrite: bool,
    named_by: str = "out",
) -> bool:
    """Check that a result may be written; returns whether results of another input are replaced.

    Raises OutputExistsError if the folder holds a result that may not be replaced, or files that
    are not a result.

    Parameters
    ----------
    folder : Path or UPath
        It need not exist.
    record : str
        `RUN`, `COMPARISON` or `LAYERS`.
    identity : InputFacts
        Identifies the input: `path`, and the items of `fingerprint`.
    overwrite : bool
        Whether existing results may be replaced.
    named_by : str
        The argument that names the folder, for messages.
    """
    with writing(folder):
        if not folder.exists():
            return False
        if not folder.is_dir():
            raise OutputExistsError(
                str(folder), "is not a folder", f"Choose another {argument(named_by)}."
            )
        names = names_in(folder)
    records = names & {RUN, COMPARISON, LAYERS}
    ours = frozenset().union(*map(names_of, FILES))
    if not records:
        refuse_strays(folder, names - ours, named_by)
    hint = overwrite_hint(named_by=named_by)
    if record in records and not overwrite:
        raise OutputExistsError(str(folder), "a result already exists here", hint)
    others = [n for n in sorted(records) if differences(read_record(folder / n), identity=identity)]
    if others and not overwrite:
        why = f"it holds the result of another input ({others[0]})"
        raise OutputExistsError(str(folder), why, hint)
    return bool(others)


def refuse_strays(folder: "Path | UPath", names: Iterable[str], named_by: str = "out") -> None:
    """Raise OutputExistsError if `names`, a folder's files, include one that is not temporary."""
    if strays := sorted(name for name in names if not name.startswith(PREFIX)):
        why = f"contains other files, such as {strays[0]}"
        raise OutputExistsError(str(folder), why, f"Choose another {argument(named_by)}.")


@contextmanager
def locked(folder: "Path | UPath") -> Iterator[None]:
    """Lock a folder against other writing processes; a missing folder is created.

    A new folder that stays empty is removed again. Buckets are not locked.

    Raises OutputExistsError if another process is writing there, and OutputError if the folder
    cannot be written.
    """
    if not isinstance(folder, Path) or is_url(str(folder)):
        yield
        return
    from filelock import FileLock, Timeout

    created = [path for path in (folder, *folder.parents) if not path.exists()]
    lock = FileLock(folder / LOCK)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / LOCK).is_symlink() or not (folder / LOCK).is_file():
            (folder / LOCK).unlink(missing_ok=True)  # locking would empty the target of a link
        lock.acquire(timeout=0)
    except Timeout:
        why = "another dlgmd command is writing here"
        hint = f"Wait for it, or choose another {argument('out')}."
        raise OutputExistsError(str(folder), why, hint) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise unwritable(folder, error) from None
    except NotImplementedError:  # the file system has no locks
        pass
    try:
        yield
    finally:
        with suppress(OSError):
            (folder / LOCK).unlink()
        lock.release()
        with suppress(OSError):
            for path in created:
                path.rmdir()


@dataclass(frozen=True)
class ClaimedFolder:
    """A folder that is checked and locked for the files of one task; see `claimed`.

    `is_new_input` is true if the files of other commands belong to another input.
    """

    folder: "Path | UPath"
    record: str = ""
    is_new_input: bool = False
    named_by: str = "out"

    @contextmanager
    def staged(
        self, *, stale: Iterable[str] = (), what: "Path | UPath | None" = None
    ) -> Iterator[Path]:
        """Yield an empty local folder, whose files are renamed into the claimed folder at the end.

        Until then, and after an exception, the claimed folder is unchanged. At the end, the earlier
        record is removed first and the new record written last; `stale` files that are not written
        again are removed. Raises OutputError, naming `what` (default: the claimed folder), if the
        files cannot be written.
        """
        folder, in_bucket = self.folder, is_url(str(self.folder))
        with writing(what or folder, self.named_by):
            if not in_bucket:
                folder.mkdir(parents=True, exist_ok=True)
            stage = tempfile.TemporaryDirectory() if in_bucket else staging(Path(folder))
            with stage as name_of_stage:
                yield Path(name_of_stage)
                present = (path.name for path in Path(name_of_stage).iterdir())
                names = sorted(present, key=lambda name: (name == self.record, name))
                replaced = [self.record, *stale]
                (_upload if in_bucket else _rename)(Path(name_of_stage), folder, names, replaced)

    def commit(self, files: Mapping[str, Write], stale: Iterable[str] = ()) -> dict[str, str]:
        """Write files together, in place of earlier ones, the record last; see `staged`.

        A name that ends in .png, .pdf or .svg is a figure. Numbers do not depend on figures: if one
        cannot be drawn, the others are written without it, unless there are only figures.

        Returns figure -> reason for the figures that could not be drawn. Raises OutputError if a
        file cannot be written; the files in the folder are then unchanged.
        """
        if self.record in FILES:
            kinds = [self.record, *(FILES if self.is_new_input else ())]
            stale = [*kinds, *(name for kind in kinds for name in names_of(kind))]
        undrawn: dict[str, str] = {}
        figures = {name for name in files if name.endswith(FIGURE_FORMATS)}
        has_tables = files.keys() - figures - {self.record}
        what = self.folder if self.record else self.folder / next(iter(files))
        with self.staged(stale=stale, what=what) as stage:
            for name in sorted(files, key=lambda name: name == self.record):
                try:
                    files[name](stage / name)
                except (OSError, DlgmdError, cancel.Interrupted):
                    raise
                except Exception as error:
                    if not (has_tables and name in figures):
                        raise
                    undrawn[name] = failure_text(error)
                    (stage / name).unlink(missing_ok=True)
        return undrawn

    def created(self, name: str) -> IO[str]:
        """A new table in the folder, open for writing rows; OSError passes through."""
        return (self.folder / name).open("w", encoding="utf-8", newline="")

    def write(self, files: Mapping[str, Write], stale: Iterable[str] = ()) -> tuple[Path, ...]:
        """Like `commit`, but logs figures that could not be drawn, and returns the other files."""
        undrawn = self.commit(files, stale)
        for name, why in undrawn.items():
            _log.error("%s: %s cannot be drawn (%s)", self.folder, name, why)
        return tuple(Path(self.folder / name) for name in files if name not in undrawn)


@contextmanager
def claimed(
    folder: "Path | UPath",
    record: str = "",
    identity: InputFacts | None = None,
    *,
    names: Iterable[str] = (),
    overwrite: bool = False,
    named_by: str = "out",
    locks: bool = True,
) -> Iterator[ClaimedFolder]:
    """Check that files may be written into a folder, and lock it; for every command and function.

    Parameters
    ----------
    folder : Path or UPath
        Created if necessary.
    record : str
        The record of what is written. For `RUN`, `COMPARISON` and `LAYERS`, see `check_place`.
    identity : InputFacts, optional
        Of the input, as `check_place` takes it.
    names : iterable of str
        Files that may not exist.
    overwrite : bool
        Whether earlier results and files may be replaced.
    named_by : str
        The argument that names the folder, for errors.
    locks : bool
        Whether other processes are kept out.

    Raises
    ------
    OutputExistsError
        If the folder holds what may not be replaced, or another process is writing there.
    OutputError
        If the folder cannot be written.
    """
    is_new = False
    if not is_url(str(folder)):
        require_local(folder, named_by)
    if record in FILES:
        is_new = check_place(folder, record, identity or {}, overwrite=overwrite, named_by=named_by)
    for name in names:
        refuse_existing(Path(folder / name), overwrite=overwrite, named_by=named_by)
    with locked(folder) if locks else nullcontext():
        yield ClaimedFolder(folder, record, is_new, named_by)


def _rename(stage: Path, folder: Path, names: list[str], stale: Iterable[str]) -> None:
    """Rename complete files from `stage` into `folder`, in order."""
    for name in {*names, *stale} - {""}:
        if (folder / name).is_dir():
            raise IsADirectoryError(errno.EISDIR, f"{name} is a folder")
    remove(folder, stale)
    for name in names:
        (stage / name).replace(folder / name)


def _upload(stage: Path, folder: "UPath", names: list[str], stale: Iterable[str]) -> None:
    """Copy complete files from `stage` into a bucket, in order."""
    remove(folder, stale)
    for name in names:
        path = folder / name
        path.fs.put_file(str(stage / name), path.path)


def remove(folder: "Path | UPath", names: Iterable[str]) -> None:
    """Remove the named files that exist, in order."""
    existing = names_in(folder) if is_url(str(folder)) else None  # a request to list a bucket
    for name in dict.fromkeys(names):
        if name and (existing is None or name in existing):
            (folder / name).unlink(missing_ok=True)


def names_in(folder: "Path | UPath") -> set[str]:
    """Names of the files in a folder; empty if a bucket has no such folder."""
    if not is_url(str(folder)):
        return {path.name for path in folder.iterdir()}
    bucket: Any = folder
    bucket.fs.invalidate_cache()
    with suppress(FileNotFoundError):
        paths = bucket.fs.ls(bucket.path, detail=False)
        return {path.rstrip("/").rpartition("/")[2] for path in paths}
    return set()


def file_of(content: str | bytes) -> Write:
    """A function that writes a text, in UTF-8, or bytes into a file.

    Bytes of file names that are not characters are escaped.
    """
    data = content.encode(errors="backslashreplace") if isinstance(content, str) else content
    return lambda path: path.write_bytes(data)


def refuse_existing(path: Path, *, overwrite: bool, named_by: str = "out") -> None:
    """Raise OutputExistsError if `path`, the value of an argument, must not be overwritten."""
    if path.is_dir():
        raise OutputExistsError(str(path), "is a folder", f"Choose another {argument(named_by)}.")
    if path.exists() and not overwrite:
        hint = f"Add {argument('overwrite', True)} to replace it."
        raise OutputExistsError(str(path), "already exists", hint)


@contextmanager
def writing(path: "Path | UPath", named_by: str = "out") -> Iterator[None]:
    """Convert errors while `path`, the value of an argument, is written into OutputError."""
    try:
        yield
    except (DlgmdError, cancel.Interrupted):
        raise
    except Exception as error:
        # Every kind of URL has its own exceptions.
        if not isinstance(error, OSError) and not is_url(str(path)):
            raise
        raise unwritable(path, error, named_by) from None


def unwritable(path: "Path | UPath", error: Exception, named_by: str = "out") -> OutputError:
    """The error for a file or folder that cannot be written."""
    why = f"cannot be written ({failure_text(error)})"
    return OutputError(str(path), why, f"Choose another {argument(named_by)}, or make room.")


def failure_text(error: BaseException) -> str:
    """The reason of an error with a file or URL, on one line."""
    if isinstance(error, OSError) and error.strerror and error.errno is not None:
        return error.strerror
    text = " ".join(str(error).split()).rstrip(".")
    if isinstance(error, FileNotFoundError) and " " not in text:  # only the path
        return "no such file or folder"
    return text or type(error).__name__
