"""An input on disk, decoded once, so that many models, and many processes, can go through it."""

import tempfile
from array import array
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from dlgmd_cli.errors import OutputError
from dlgmd_cli.models.base import Grey, Model
from dlgmd_cli.models.photoreceptors import Photoreceptors
from dlgmd_cli.results.workshop import Workshop
from dlgmd_cli.runs.recording import Recording
from dlgmd_cli.video.frames import Frame

_FRAMES = "frames"
# What a frame of a tape has in place of its picture.
_NO_PICTURE = np.empty((0, 0), np.uint8)


@dataclass
class Tape:
    """What a spool holds; other processes may be given it, and open it.

    Attributes
    ----------
    folder : Path
        Where the pictures lie.
    shape : (int, int)
        Height and width of the frames, in px.
    dtype : str
        Type of their levels.
    lengths : list of int
        Number of frames of each clip.
    frames : list of Frame
        Numbers and times of the frames of all clips, without the pictures.
    p_sums : array of float
        ΣP of each, in units of luminance.
    """

    folder: Path
    shape: tuple[int, int] = (0, 0)
    dtype: str = "uint8"
    lengths: list[int] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    p_sums: "array[float]" = field(default_factory=lambda: array("d"))

    def open(self) -> "Player":
        """Ready to be played, any number of times; constant memory."""
        # Never written to, but Numba would compile all again for an array that cannot be.
        shape = (len(self.frames), *self.shape)
        mapped = np.memmap(self.folder / _FRAMES, self.dtype, mode="c", shape=shape)
        return Player(self, mapped.view(np.ndarray))


class Player:
    """Feeds models with the clips of a tape."""

    def __init__(self, tape: Tape, pictures: Grey) -> None:
        self._tape, self._pictures = tape, pictures

    def play(self, model: Model, max_frames: int | None = None) -> Iterator[Recording]:
        """What the model answers to each clip, or to so many frames of it at most."""
        first = 0
        for length in self._tape.lengths:
            recording = Recording()
            model.reset()
            n_frames = length if max_frames is None else min(length, max_frames)
            for place in range(first, first + n_frames):
                frame = self._tape.frames[place]
                recording.append(frame, model.step(self._pictures[place], frame.time_s))
            first += length
            yield recording


class Spool:
    """Context manager that takes clips down in a temporary folder, and removes it afterwards.

    Attributes
    ----------
    tape : Tape
        What is there so far.

    Raises
    ------
    OutputError
        If there is no room for it.
    """

    def __init__(self) -> None:
        self._files: dict[str, BinaryIO] = {}

    def __enter__(self) -> "Spool":
        try:
            self._workshop = Workshop(Path(tempfile.gettempdir()))
            self.tape = Tape(self._workshop.__enter__().path)
        except OSError as error:
            raise _no_room(error) from None
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):
            self._close()
        self.unlink()

    def unlink(self) -> None:
        """Remove the folder; who has opened the tape may go on, and nothing stays behind."""
        self._workshop.__exit__()

    def add(
        self, frames: Iterable[Frame], on_frame: Callable[[int], None] = lambda n_decoded: None
    ) -> None:
        """Take down a clip, whose frames are like those of the others.

        `on_frame` is called after each with the number of frames of the input that are done.
        """
        tape = self.tape
        receptors = Photoreceptors(1)
        n_before = len(tape.frames)
        try:
            for frame in frames:
                receptors.take(frame.grey)
                if not tape.frames:
                    height, width = frame.grey.shape
                    tape.shape, tape.dtype = (height, width), frame.grey.dtype.name
                self._write(_FRAMES, frame.grey)
                tape.frames.append(Frame(frame.index, frame.time_s, _NO_PICTURE))
                tape.p_sums.append(receptors.p_sum(0))
                on_frame(frame.index + 1)
            for file in self._files.values():
                file.flush()
        except OSError as error:
            raise _no_room(error) from None
        tape.lengths.append(len(tape.frames) - n_before)

    def _write(self, name: str, picture: Grey) -> None:
        """Append a picture to a file."""
        if name not in self._files:
            self._files[name] = (self.tape.folder / name).open("wb")
        self._files[name].write(np.ascontiguousarray(picture).data)

    def _close(self) -> None:
        for file in self._files.values():
            file.close()


def _no_room(error: OSError) -> OutputError:
    return OutputError(
        tempfile.gettempdir(),
        f"the decoded frames cannot be kept there ({error.strerror or error})",
        "Make room, point TMPDIR at another folder, or process smaller frames with --scale.",
    )
