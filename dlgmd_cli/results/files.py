"""Single files that appear whole or not at all."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from dlgmd_cli.errors import OutputError, OutputExistsError


def fitting(name: str, max_bytes: int = 200) -> str:
    """As much of the beginning of a file's name as file systems take, with a suffix to come."""
    while len(os.fsencode(name)) > max_bytes:
        name = name[:-1]
    return name


def refuse_existing(path: Path, *, overwrite: bool, option: str = "--out") -> None:
    """Raise OutputExistsError if `path`, which `option` asks for, may not be written over."""
    if path.is_dir() or (path.exists() and not overwrite):
        mend = f"Choose another {option}." if path.is_dir() else "Add --overwrite to replace it."
        raise OutputExistsError(str(path), "it stands here already", mend)


@contextmanager
def appearing(*paths: Path, option: str = "--out") -> Iterator[tuple[Path, ...]]:
    """Stand-ins to write instead of `paths`; renamed to them together at the end, or removed.

    Parameters
    ----------
    paths : Path
        Where the files are to stand.
    option : str
        The option that says so, for the error.

    Raises
    ------
    OutputError
        If they cannot be written.
    """
    token = secrets.token_hex(8)
    stand_ins = tuple(
        path.with_name(f".dlgmd-{token}-{i}{path.suffix}") for i, path in enumerate(paths)
    )
    try:
        for path in paths:
            path.parent.mkdir(parents=True, exist_ok=True)
        yield stand_ins
        for stand_in, path in zip(stand_ins, paths, strict=True):
            stand_in.replace(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(
            str(paths[0]),
            f"it cannot be written ({reason})",
            f"Choose another {option}, or make room there.",
        ) from None
    finally:
        for stand_in in stand_ins:
            with suppress(OSError):
                stand_in.unlink(missing_ok=True)
