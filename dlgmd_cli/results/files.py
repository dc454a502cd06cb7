"""Files, and folders of pictures, that appear whole or not at all."""

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from dlgmd_cli.errors import OutputError, OutputExistsError
from dlgmd_cli.results.workshop import Workshop


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


def refuse_foreign(
    path: Path, is_ours: Callable[[str], bool], *, overwrite: bool, option: str = "--out"
) -> None:
    """Raise OutputExistsError if a folder that `option` asks for may not take the place of `path`.

    Parameters
    ----------
    path : Path
        Where the folder is to stand.
    is_ours : callable
        Whether a file in it, by its name, is one that may be replaced.
    overwrite : bool
        Whether a folder with nothing but such files may be.
    """
    if not os.path.lexists(path):
        return
    mend = f"Choose another {option}."
    if path.is_symlink() or not path.is_dir():
        raise OutputExistsError(str(path), "this is no folder of pictures", mend)
    strays = [
        entry.name for entry in path.iterdir() if not is_ours(entry.name) or not entry.is_file()
    ]
    if strays:
        why = f"this folder holds other files, such as {min(strays)}"
        raise OutputExistsError(str(path), why, mend)
    if not overwrite:
        raise OutputExistsError(
            str(path), "it stands here already", "Add --overwrite to replace it."
        )


def prove_writable(folder: Path, *, option: str = "--out") -> None:
    """Make a folder if need be, and raise OutputError if nothing can be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with Workshop(folder):
            pass
    except OSError as error:
        raise _unwritable(folder, error, option) from None


@contextmanager
def appearing(*paths: Path, option: str = "--out") -> Iterator[tuple[Path, ...]]:
    """Stand-ins to write instead of `paths`; renamed to them together at the end, or removed.

    Parameters
    ----------
    paths : Path
        Where the files are to stand. A stand-in may also be made a folder, which takes the place
        of what stands there.
    option : str
        The option that says so, for the error.

    Raises
    ------
    OutputError
        If they cannot be written.
    """
    try:
        with ExitStack() as stack:
            shops: dict[Path, Workshop] = {}
            for folder in dict.fromkeys(path.parent for path in paths):
                folder.mkdir(parents=True, exist_ok=True)
                shops[folder] = stack.enter_context(Workshop(folder))
            stand_ins = tuple(
                shops[path.parent].path / f"{i}{path.suffix}" for i, path in enumerate(paths)
            )
            yield stand_ins
            for stand_in, path in zip(stand_ins, paths, strict=True):
                if stand_in.is_dir():
                    shops[path.parent].put(stand_in, path)
                else:
                    stand_in.replace(path)
    except OSError as error:
        raise _unwritable(paths[0], error, option) from None


def _unwritable(path: Path, error: OSError, option: str) -> OutputError:
    reason = error.strerror or str(error)
    return OutputError(
        str(path),
        f"it cannot be written ({reason})",
        f"Choose another {option}, or make room there.",
    )
