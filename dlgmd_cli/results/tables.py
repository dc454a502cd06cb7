"""The columns of every CSV of a result, in one place."""

import csv
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dlgmd_cli.results.cells import cell

Series = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

TABLES = {
    "mp.csv": ("frame", "time_s", "mp", "mp_abs", "mp_seq"),
    "attenuation.csv": ("frame", "time_s", "p_sum", "s_sum", "attenuation_db"),
    "spikes.csv": ("frame", "time_s", "level", "threshold", "spike", "collision"),
}


@dataclass(frozen=True)
class Result:
    """What a model said about a video; arrays of shape (n,), one entry a processed frame.

    Attributes
    ----------
    frame : int array
        Number of the frame in the input, from 0.
    time_s : array
        Time of the frame, in seconds.
    p_sum, s_sum : array
        Sums of the photoreceptor and the summation layer, in units of luminance.
    attenuation_db : array
        10 lg(ΣS/ΣP) in dB; -inf where nothing passes, NaN where undefined.
    mp, mp_abs, mp_seq : array
        Raw membrane potential and its two normalisations; NaN where undefined.
    level : array
        The normalised membrane potential that drives the spikes.
    threshold : array
        What it was held against; NaN where spikes were not asked for.
    spike, collision : bool array
        Whether it spikes, and whether the spikes amount to a collision alarm.
    """

    frame: npt.NDArray[np.int64]
    time_s: Series
    p_sum: Series
    s_sum: Series
    attenuation_db: Series
    mp: Series
    mp_abs: Series
    mp_seq: Series
    level: Series
    threshold: Series
    spike: Flags
    collision: Flags

    @property
    def has_spikes(self) -> bool:
        """Whether spikes were looked for; if not, none of them is no finding."""
        return not bool(np.isnan(self.threshold).all())


def write_tables(folder: Path, pieces: Iterable[Result]) -> None:
    """Write every CSV into `folder`; OSError passes through.

    Parameters
    ----------
    folder : Path
        Where the files go.
    pieces : iterable of Result
        The result, in one piece or in several in order; none is kept.
    """
    with ExitStack() as stack:
        writers = {}
        for name, columns in TABLES.items():
            file = stack.enter_context((folder / name).open("w", newline="", encoding="ascii"))
            writers[columns] = csv.writer(file, lineterminator="\n")
            writers[columns].writerow(columns)
        for piece in pieces:
            for columns, writer in writers.items():
                series = [getattr(piece, column).tolist() for column in columns]
                writer.writerows(zip(*(map(cell, values) for values in series), strict=True))
