"""What a model answered to frame after frame, in memory that does not grow with their number."""

import tempfile
import weakref
from array import array
from collections.abc import Iterator
from contextlib import suppress
from io import FileIO
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.base import Response
from dlgmd_cli.video.frames import Frame

Columns = npt.NDArray[np.float64]

PIECE_FRAMES = 2048
# 18 minutes at 30 frames a second, and 1.5 MB.
MAX_FRAMES_IN_MEMORY = 32_768

_COLUMNS = 6
_ROW_BYTES = 8 * _COLUMNS


class _Kept(NamedTuple):
    """How many rows are to be found in the file, and the values of those that follow them."""

    n_filed: int
    newest: "array[float]"


class Recording:
    """Responses kept as plain numbers, so that an interrupt loses none.

    The first `MAX_FRAMES_IN_MEMORY` take 48 bytes each. With those that follow, the older ones
    move to a temporary file without a name, of which nothing is left however the process ends.
    Where there is no room for it, they stay in memory.
    """

    def __init__(self) -> None:
        self._kept = _Kept(0, array("d"))
        self._file: FileIO | None = None

    def __len__(self) -> int:
        kept = self._kept
        return kept.n_filed + len(kept.newest) // _COLUMNS

    def append(self, frame: Frame, response: Response) -> None:
        """Add one frame's response."""
        n_times_full, rest = divmod(len(self._kept.newest), _COLUMNS * MAX_FRAMES_IN_MEMORY)
        # Where there was no room, the next try is after as many frames again.
        if n_times_full and not rest:
            self._file_away()
        # One call, so that Ctrl-C finds the row whole or absent.
        self._kept.newest.extend(
            (
                frame.index,
                frame.time_s,
                response.p_sum,
                response.s_sum,
                response.attenuation_db,
                response.mp,
            )
        )

    def cut(self, n_frames: int) -> None:
        """Forget what comes after the first `n_frames`."""
        n_filed, newest = self._kept
        if n_frames < n_filed:
            self._kept = _Kept(n_frames, array("d"))
        else:
            del newest[(n_frames - n_filed) * _COLUMNS :]

    @property
    def n_valid(self) -> int:
        """How many frames the model could answer to."""
        return sum(int(np.count_nonzero(~np.isnan(piece[-1]))) for piece in self.pieces())

    def columns(self) -> Columns:
        """A copy, shape (6, n): frame, time_s, p_sum, s_sum, attenuation_db, mp."""
        return self._copy(0, len(self))

    def pieces(self, n_frames: int = PIECE_FRAMES) -> Iterator[Columns]:
        """The `columns` of at most so many frames at a time, in order."""
        for first in range(0, len(self), n_frames):
            yield self._copy(first, min(first + n_frames, len(self)))

    def _copy(self, first: int, end: int) -> Columns:
        """The columns of the frames from `first` up to `end`."""
        n_filed, newest = self._kept
        rows = np.empty((end - first, _COLUMNS))
        n_read = max(0, min(end, n_filed) - first)
        self._read(first, rows[:n_read])
        start, stop = first + n_read - n_filed, end - n_filed
        rows[n_read:] = np.array(newest[start * _COLUMNS : stop * _COLUMNS]).reshape(-1, _COLUMNS)
        return rows.T.copy()

    def _read(self, first: int, rows: Columns) -> None:
        """Fill `rows` from the file; OSError if that is impossible."""
        if self._file is None or not rows.size:
            return
        rest = rows.data.cast("B")
        self._file.seek(first * _ROW_BYTES)
        while rest:
            n_bytes = self._file.readinto(rest)
            if not n_bytes:
                raise OSError("the temporary file of the responses was cut")
            rest = rest[n_bytes:]

    def _file_away(self) -> None:
        """Move what is in memory to the file, or leave it if there is no room."""
        n_filed, newest = self._kept
        try:
            self._write(n_filed, memoryview(newest.tobytes()))
        except OSError:
            if self._file is not None:
                with suppress(OSError):  # others may need what little room there is
                    self._file.truncate(n_filed * _ROW_BYTES)
        else:
            # One assignment, so that Ctrl-C finds the rows in one place.
            self._kept = _Kept(n_filed + len(newest) // _COLUMNS, array("d"))

    def _write(self, first: int, rest: memoryview) -> None:
        """Put rows into the file, after the first so many of it."""
        if self._file is None:
            # Unbuffered, so that nothing that failed is tried again later on.
            file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115, it lives as long as self
            weakref.finalize(self, file.close)
            self._file = file
        self._file.seek(first * _ROW_BYTES)
        while rest:
            rest = rest[self._file.write(rest) :]
