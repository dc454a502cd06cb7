"""The frames of a clip that its contact sheet shows, kept while the clip is rendered."""

import math
from collections.abc import Iterable, Iterator
from typing import Any

from dlgmd_cli.results.clip_sheet import ClipSheet, Still
from dlgmd_cli.stimuli.base import GreyImage, OptionsT, Scene

N_STILLS = 12


def chosen_frames(
    n_frames: int, collision_frame: int | None = None, n_stills: int = N_STILLS
) -> tuple[int, ...]:
    """Which frames a sheet shows: the first, the last, the collision, and others evenly between.

    Parameters
    ----------
    n_frames : int
        Length of the clip, at least 1.
    collision_frame : int, optional
        The steps before it and those after it differ by what it takes to meet it.
    n_stills : int
        How many there are to be, at least 3; all frames where the clip has no more.

    Returns
    -------
    tuple of int
        In order, each once.
    """
    if n_frames <= n_stills:
        return tuple(range(n_frames))
    last, n_steps = n_frames - 1, n_stills - 1
    middle = collision_frame or 0
    if not 0 < middle < last:
        return tuple(_evenly(0, last, n_steps))
    n_before = min(max(1, round(middle * n_steps / last)), n_steps - 1)
    return (*_evenly(0, middle, n_before)[:-1], *_evenly(middle, last, n_steps - n_before))


class Stills:
    """What a sheet shows of a clip, filled in while its frames and its truth go by.

    Parameters
    ----------
    scene : Scene
    options : ClipOptions
        Of that scene.
    name : str
        What the clip is called.
    """

    def __init__(self, scene: Scene[OptionsT], options: OptionsT, name: str) -> None:
        self._name, self._options = name, options
        self._record, self._n_frames = scene.record(options), scene.n_frames(options)
        self._collision: int | None = self._record.get("collision_frame")
        self._wanted = chosen_frames(self._n_frames, self._collision)
        self._images: dict[int, GreyImage] = {}
        self._rows: dict[int, Any] = {}

    def seen(self, frames: Iterable[GreyImage]) -> Iterator[GreyImage]:
        """All frames, in order from the first."""
        for index, frame in enumerate(frames):
            if index in self._wanted:
                self._images[index] = frame.copy()
            yield frame

    def known(self, rows: Iterable[Any]) -> Iterator[Any]:
        """All rows of the ground truth, in order from the first."""
        for index, row in enumerate(rows):
            if index in self._wanted:
                self._rows[index] = row
            yield row

    def sheet(self) -> ClipSheet:
        """What went by."""
        return ClipSheet(
            self._name,
            self._options.fps,
            self._n_frames,
            self._options.seed,
            tuple(map(self._still, self._wanted)),
            self._record.get("target", ""),
            self._collision,
            self._record.get("collision_time_s"),
        )

    def _still(self, index: int) -> Still:
        """One frame; what its scene's truth has no column for is not defined."""
        row = self._rows[index]
        return Still(
            index,
            row.time_s,
            self._images[index],
            getattr(row, "phase", ""),
            getattr(row, "time_to_contact_s", math.nan),
            getattr(row, "angular_size_deg", math.nan),
            index == self._collision,
        )


def _evenly(first: int, last: int, n_steps: int) -> list[int]:
    """`first`, `last` and what lies between them, in steps that differ by 1 at most."""
    return [first + step * (last - first) // n_steps for step in range(n_steps + 1)]
