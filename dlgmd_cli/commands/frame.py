"""What commands share: open the input, check and lock the folder, run, warn, write, end."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dlgmd_cli.commands.console import end_if_interrupted, note, warn
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.errors import SourceError

if TYPE_CHECKING:
    from dlgmd_cli.commands.options import Output
    from dlgmd_cli.results.store import Write
    from dlgmd_cli.runs.setup import Setup
    from dlgmd_cli.video.options import InputOptions
    from dlgmd_cli.video.source import Video


@dataclass(frozen=True)
class Job:
    """An open input, and the folder of its result, which is locked if there is a `record`.

    `is_new_input` says whether `commit` replaces results of another input.
    """

    input_path: str
    video: "Video"
    options: "InputOptions"
    folder: Path
    record: str | None
    is_new_input: bool

    def progress(self) -> AbstractContextManager[Any]:
        """A progress bar over the frames of the input."""
        return progress(self.video.info.name, self.options.n_expected(self.video.info))

    def warn(self, warnings: Sequence[str]) -> None:
        """Print warnings about the input, and note which of its frames were processed."""
        for warning in warnings:
            warn(f"{self.input_path}: {warning}")
        if self.options.fps in (None, "all") and (sampling := self.video.sampling()):
            note(f"{self.input_path}: {sampling}")

    def commit(self, files: "Mapping[str, Write]") -> None:
        """Write the result; `files` has the function that writes each file, by name."""
        from dlgmd_cli.results import store

        assert self.record is not None
        undrawn = store.commit(self.folder, self.record, files, is_new_input=self.is_new_input)
        store.log_undrawn(self.folder, undrawn)

    def end(self, n_frames: int, *, complete: bool) -> None:
        """End with code 130 if the user asked to stop; raise SourceError if nothing was seen."""
        end_if_interrupted(self.folder, n_frames, complete=complete)
        if self.video.progress.blind:
            raise SourceError(self.input_path, self.video.progress.blind)


@contextmanager
def job(
    input_path: str,
    setups: "Sequence[Setup]",
    options: "InputOptions",
    output: "Output",
    record: str | None,
) -> Iterator[Job]:
    """Open an input, and check and lock the folder of its result, if it has a `record`.

    Raises
    ------
    SourceError, ParameterError, MissingExtraError
        If the input cannot be opened.
    OutputExistsError
        If the folder holds a result that may not be replaced, or another process writes there.
    """
    from dlgmd_cli.results import store
    from dlgmd_cli.runs.run import open_input

    with open_input(input_path, setups, options) as video:
        folder = store.result_folder(output.out, video.info.name)
        is_new = False
        if record is not None:
            is_new = store.check(folder, record, video.info.identity, overwrite=output.overwrite)
        with store.locked(folder) if record else nullcontext():
            yield Job(input_path, video, options, folder, record, is_new)


def write_files(
    files: "Mapping[Path, Write]", *, overwrite: bool, option: str = "--out", locks: bool = False
) -> list[Path]:
    """Write files of one folder that are no result, all or none; `option` names the place.

    With `locks`, the folder is locked against other commands. Returns the files but for figures
    that could not be drawn, which are errors. Raises OutputExistsError if one exists and may not
    be overwritten, and OutputError.
    """
    from dlgmd_cli.results import store

    folder = next(iter(files)).parent
    with store.locked(folder) if locks else nullcontext():
        for path in files:
            store.refuse_existing(path, overwrite=overwrite, option=option)
        writes = {path.name: write for path, write in files.items()}
        undrawn = store.write_files(folder, writes, option=option)
    store.log_undrawn(folder, undrawn)
    return [path for path in files if path.name not in undrawn]
