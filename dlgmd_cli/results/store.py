"""Result folders and the commit rule: a result is complete if and only if its record exists.

Writing a result removes the old record first, then writes each file under a temporary name and
renames it, the record last. A killed process leaves no record, and the next run replaces its files.
In a bucket, the same files are uploaded in the same order.
"""

import errno
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dlgmd_cli.errors import (
    DlgmdError,
    MissingExtraError,
    OutputError,
    OutputExistsError,
    ParameterError,
)
from dlgmd_cli.results.record import read_record

if TYPE_CHECKING:
    from upath import UPath

Write = Callable[[Path], object]

PLOT_FORMATS = ("png", "pdf", "svg")
RUN, COMPARISON, LAYERS = "run.yaml", "compare.yaml", "layers.yaml"
# The files that belong to each record: tables, and figures without their suffixes.
_TABLES = {
    RUN: ("mp.csv", "attenuation.csv", "spikes.csv"),
    COMPARISON: ("compare.csv",),
    LAYERS: ("layers.npz",),
}
FIGURES = {
    RUN: ("mp", "attenuation", "spikes"),
    COMPARISON: ("compare-mp", "compare-attenuation"),
    LAYERS: ("layers",),
}
PREFIX = ".dlgmd-"
_LOCK = f"{PREFIX}lock"
_MAX_NAME_BYTES = 200
# Errors of file systems without locks.
_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP)


def files_of(record: str) -> frozenset[str]:
    """Names of all files that may belong to a record, itself included."""
    figures = (f"{name}.{suffix}" for name in FIGURES[record] for suffix in PLOT_FORMATS)
    return frozenset({record, *_TABLES[record], *figures})


def place(text: str | os.PathLike[str]) -> "Path | UPath":
    """The folder for a path or a URL such as ``s3://bucket/results``.

    Raises
    ------
    ParameterError
        If the URL is of an unknown kind, or does not name a folder.
    MissingExtraError
        If the packages for such URLs are not installed.
    """
    if not is_url(text):
        return Path(text)
    url = os.fspath(text)
    if url.startswith(("file://", "local://")):
        return Path(url.partition("://")[2])
    try:
        from upath import UPath

        found = UPath(url)
        if not found.fs or not found.path.strip("/"):
            raise ParameterError(url, "names no folder", "Give one, as s3://bucket/results.")
        return UPath(url.rstrip("/"))
    except ImportError as error:
        raise MissingExtraError(
            url,
            f"URLs of this kind cannot be used ({error})",
            "Run: pip install 'dlgmd[cluster]', and install the package of that kind of URL.",
        ) from None
    except ValueError:
        kind = url.partition("://")[0]
        raise ParameterError(url, f"there is no kind of URL called {kind}://") from None


def is_url(text: str | os.PathLike[str]) -> bool:
    """Whether a name is a URL such as ``s3://bucket/flights``."""
    return "://" in os.fspath(text)


def fitting(name: str) -> str:
    """A file name, shortened if necessary so that a suffix still fits on any file system."""
    encoded = os.fsencode(name)
    if len(encoded) <= _MAX_NAME_BYTES:
        return name
    return encoded[:_MAX_NAME_BYTES].decode(errors="ignore")


def result_folder(out: Path, name: str) -> Path:
    """The result folder of the input called `name`."""
    return out / (name if name.strip(".") else f"video{name}")


def check(
    folder: "Path | UPath", record: str, identity: Mapping[str, Any], *, overwrite: bool
) -> bool:
    """Check that a result may be written; returns whether results of another input are replaced.

    Parameters
    ----------
    folder : Path or UPath
        It need not exist.
    record : str
        `RUN`, `COMPARISON` or `LAYERS`.
    identity : mapping
        Identifies the input: `path`, and the items of `fingerprint`.
    overwrite : bool
        Whether existing results may be replaced.

    Raises
    ------
    OutputExistsError
        If the folder holds a result that may not be replaced, or files that are not a result.
    """
    with writing(folder):
        if not folder.exists():
            return False
        if not folder.is_dir():
            raise OutputExistsError(str(folder), "is not a folder", "Choose another --out.")
        names = names_in(folder)
    records = names & {RUN, COMPARISON, LAYERS}
    ours = frozenset().union(*map(files_of, _TABLES))
    strays = sorted(n for n in names - ours if not n.startswith(PREFIX))
    if strays and not records:
        raise OutputExistsError(
            str(folder), f"contains other files, such as {strays[0]}", "Choose another --out."
        )
    mend = "Add --overwrite to replace it, or choose another --out."
    if record in records and not overwrite:
        raise OutputExistsError(str(folder), "a result already exists here", mend)
    others = [
        name for name in sorted(records) if not is_same_input(read_record(folder / name), identity)
    ]
    if others and not overwrite:
        why = f"it holds the result of another input ({others[0]})"
        raise OutputExistsError(str(folder), why, mend)
    return bool(others)


def is_same_input(record: Mapping[str, Any], identity: Mapping[str, Any]) -> bool:
    """Whether a record is of the input that `identity` describes."""
    known = record.get("input")
    return isinstance(known, dict) and all(known.get(k) == v for k, v in identity.items())


@contextmanager
def locked(folder: "Path | UPath") -> Iterator[None]:
    """Lock a folder against other writing processes; it is created if necessary.

    A new folder that stays empty is removed again. Buckets are not locked.

    Raises
    ------
    OutputExistsError
        If another process is writing there.
    OutputError
        If the folder cannot be written.
    """
    if not isinstance(folder, Path) or is_url(str(folder)):
        yield
        return
    from filelock import FileLock, Timeout

    made = [path for path in (folder, *folder.parents) if not path.exists()]
    lock = FileLock(folder / _LOCK)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout:
        why = "another dlgmd command is writing here"
        raise OutputExistsError(str(folder), why, "Wait for it, or choose another --out.") from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise unwritable(folder, error) from None
    except NotImplementedError:  # the file system has no locks
        pass
    try:
        yield
    finally:
        with suppress(OSError):
            (folder / _LOCK).unlink()
        lock.release()
        with suppress(OSError):
            for path in made:
                path.rmdir()


def is_locked(folder: str | os.PathLike[str]) -> bool:
    """Whether a folder is visible from this machine and locked by some process."""
    return (Path(folder) / _LOCK).exists()


def commit(
    folder: "Path | UPath", record: str, files: Mapping[str, Write], *, is_new_input: bool = False
) -> None:
    """Write a result by the commit rule, in place of an earlier one.

    Parameters
    ----------
    folder : Path or UPath
        Created if necessary.
    record : str
        `RUN`, `COMPARISON` or `LAYERS`; one of `files`, written last.
    files : mapping of str to callable
        File name -> function that writes the file at a given local path.
    is_new_input : bool
        Also remove the files of other commands, which belong to another input.

    Raises
    ------
    OutputError
        If a file cannot be written. The folder then holds no record.
    """
    with writing(folder):
        if not is_url(str(folder)):  # a bucket has no folders
            folder.mkdir(parents=True, exist_ok=True)
        kinds = _TABLES if is_new_input else (record,)
        remove(folder, [*kinds, *(name for kind in kinds for name in files_of(kind))])
        for name in sorted(files, key=lambda name: name == record):
            write_file(folder / name, files[name])


def remove(folder: "Path | UPath", names: Iterable[str]) -> None:
    """Remove the named files that exist, and temporary files of killed processes."""
    existing = names_in(folder)
    for name in dict.fromkeys(names):
        if name in existing:
            (folder / name).unlink()
    for name in existing:
        if name.startswith(PREFIX) and name != _LOCK:
            (folder / name).unlink()


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


def write_file(path: "Path | UPath", write: Write) -> None:
    """Write a file atomically: `write` gets a temporary name, which is then renamed.

    Raises OSError if that fails; an earlier file is then unchanged.
    """
    if not is_url(str(path)):
        temporary = Path(path).with_name(f"{PREFIX}{path.name}")
        temporary.parent.mkdir(parents=True, exist_ok=True)
        try:
            write(temporary)
            temporary.replace(path)
        finally:
            with suppress(OSError):
                temporary.unlink()
        return
    with tempfile.TemporaryDirectory() as folder:
        local = Path(folder) / path.name
        write(local)
        path.fs.put_file(str(local), path.path)  # type: ignore[union-attr]


def write_text(path: "Path | UPath", text: str) -> None:
    """Write a text file atomically; raises OutputError."""
    with writing(path):
        write_file(path, lambda file: file.write_text(text, encoding="utf-8", newline=""))


@contextmanager
def appearing(*paths: Path, option: str = "--out") -> Iterator[tuple[Path, ...]]:
    """Yield temporary names for `paths`; the files are renamed at the end, or removed on failure.

    Raises
    ------
    OutputError
        If the files cannot be written; `option` is the option to change.
    """
    temporary = tuple(path.with_name(f"{PREFIX}{path.name}") for path in paths)
    try:
        for path in paths:
            path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        for file, path in zip(temporary, paths, strict=True):
            file.replace(path)
    except OSError as error:
        raise unwritable(paths[0], error, option) from None
    finally:
        for file in temporary:
            with suppress(OSError):
                file.unlink()


def refuse_existing(path: Path, *, overwrite: bool, option: str = "--out") -> None:
    """Raise OutputExistsError if `path`, the value of `option`, may not be overwritten."""
    if path.is_dir():
        raise OutputExistsError(str(path), "is a folder", f"Choose another {option}.")
    if path.exists() and not overwrite:
        raise OutputExistsError(str(path), "already exists", "Add --overwrite to replace it.")


@contextmanager
def writing(path: "Path | UPath") -> Iterator[None]:
    """Convert errors while `path` is written into OutputError."""
    try:
        yield
    except DlgmdError:
        raise
    except OSError as error:
        raise unwritable(path, error) from None
    except Exception as error:
        if not is_url(str(path)):  # every kind of URL has its own exceptions
            raise
        raise unwritable(path, error) from None


def unwritable(path: "Path | UPath", error: Exception, option: str = "--out") -> OutputError:
    """The error for a file or folder that cannot be written."""
    return OutputError(
        str(path),
        f"cannot be written ({failure_text(error)})",
        f"Choose another {option}, or make room.",
    )


def failure_text(error: BaseException) -> str:
    """The reason of an error with a file or URL, on one line."""
    if isinstance(error, OSError) and error.strerror and error.errno is not None:
        return error.strerror
    text = " ".join(str(error).split()).rstrip(".")
    if isinstance(error, FileNotFoundError) and " " not in text:  # only the path
        return "no such file or folder"
    return text or type(error).__name__
