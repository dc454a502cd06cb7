"""Frames in a file that several processes map into memory, so that a clip is decoded once."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import Frame
from dlgmd_cli.machine import cancel


@dataclass(frozen=True)
class KeptFrames:
    """A file of frames of one size and type; `kind` is the data type of one frame."""

    path: Path
    kind: np.dtype[np.void]

    @classmethod
    def write(
        cls, path: Path, frames: Iterable[Frame], on_frame: Callable[[int], None]
    ) -> "KeptFrames":
        """Write frames, at least one, except for duplicates; `on_frame` gets the number done."""
        with path.open("wb") as file:
            for frame in frames:
                cancel.check()
                if frame.is_repeat:
                    continue
                image = ("grey", frame.grey.dtype, frame.grey.shape)
                facts = [("frame", np.int64), ("time_s", np.float64), ("after_gap", np.bool_)]
                kind = np.dtype([*facts, image], align=True)
                row = frame.index, frame.time_s, frame.after_gap, frame.grey
                file.write(np.array(row, kind).tobytes())
                on_frame(frame.index + 1)
        return cls(path, kind)

    def rows(self) -> npt.NDArray[np.void]:
        """Number, time, gap flag and image of each frame, mapped into memory."""
        return np.asarray(np.memmap(self.path, self.kind, mode="r"))

    def __iter__(self) -> Iterator[Frame]:
        for row in self.rows():
            is_gap = bool(row["after_gap"])
            yield Frame(int(row["frame"]), float(row["time_s"]), row["grey"], after_gap=is_gap)
