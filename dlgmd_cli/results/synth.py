"""What `synth` renders: `RenderedClip`, a stimulus with its truth, and `Flights`, many of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import DlgmdError, counted
from dlgmd_cli.results import labels, store
from dlgmd_cli.results.csv import Table
from dlgmd_cli.results.outcome import Outcome, Shown


@dataclass(eq=False, repr=False)
class RenderedClip(Outcome):
    """A rendered stimulus; `save` writes its images as NAME.npy and its truth as NAME.csv.

    Attributes
    ----------
    name : str
        The scene's name.
    fps : float
        Frames per second.
    truth : structured ndarray, shape (n,)
        The ground truth of each frame; its columns are those of the CSV.
    record : dict
        Of a flight: its phases, and the frame of the collision.
    frames : ndarray, shape (n, H, W), uint8, or None
        The images, for `run(clip.frames, fps=clip.fps)`; None if they were written to files.
    paths : tuple of Path
        The files, the video first.
    """

    name: str
    fps: float
    truth: Table
    record: dict[str, Any]
    frames: npt.NDArray[np.uint8] | None = None
    paths: tuple[Path, ...] = ()

    def __repr__(self) -> str:
        where = f" in {self.paths[0]}" if self.paths else ""
        return f"<RenderedClip {self.name}: {counted(len(self.truth), 'frame')}{where}>"

    def cells(self) -> dict[str, Any]:
        """The columns and rows of the truth."""
        return {f"{self.name}.csv": (self.truth.dtype.names or (), self.truth.tolist())}

    def tables(self) -> dict[str, store.Write]:
        """The functions that write the truth, and the images that are in memory."""
        tables = super().tables()
        if self.frames is not None:
            tables[f"{self.name}.npy"] = partial(_write_array, array=self.frames)
        return tables

    def shown(self) -> Iterator[Shown]:
        """Where the files are, and how a flight with the alarm in the loop ends."""
        yield from self.paths
        if "avoid" in self.record:
            yield "Without: {without}. With {avoid}: {with}.".format(**self.record)


@dataclass(eq=False, repr=False)
class Flights(Outcome):
    """Many flights in a folder.

    `path` is the file of labels, and `labels` has its rows: a structured array with the columns
    ``video``, ``collision_frame``, ``target``, ``kind`` and ``manner``. `failed` says which flights
    could not be rendered, and why, of the `count` that were asked for.
    """

    TABLES = (labels.LABELS,)

    path: Path
    labels: Table
    failed: dict[str, str]
    count: int

    def __repr__(self) -> str:
        n_hits = np.count_nonzero(~np.isnan(self.labels["collision_frame"].astype(float)))
        n_videos = counted(len(self.labels), "video")
        return f"<Flights in {self.path}: {n_videos}, {n_hits} with a collision>"

    def cells(self) -> dict[str, Any]:
        """The columns and rows of the labels."""
        rows = [[None if v != v else v for v in row] for row in self.labels.tolist()]
        return {labels.LABELS: (labels.COLUMNS, rows)}

    @property
    def failure(self) -> DlgmdError | None:  # type: ignore[override]
        """Why the exit code is 1: some flights could not be rendered."""
        n_present = len(self.labels)
        if n_present == self.count:
            return None
        kept = f"the other {n_present} are in {self.path.parent}"
        why = f"{self.count - n_present} of {self.count} flights failed; {kept}"
        return DlgmdError("", why, "Fix what is named above, then run the same command again.")

    def facts(self) -> dict[str, Any]:
        """The file of labels, and what failed."""
        return {"labels": str(self.path), "failed": self.failed}

    def shown(self) -> Iterator[Shown]:
        """Where the labels are."""
        if len(self.labels):
            yield self.path


def _write_array(path: Path, array: npt.NDArray[Any]) -> None:
    with path.open("wb") as file:  # given a name, NumPy would append .npy to it
        np.save(file, array)
