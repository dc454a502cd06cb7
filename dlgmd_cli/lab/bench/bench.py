"""Speed of the model on this machine, in the form of the paper's Table IV."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from statistics import median
from typing import NamedTuple, TypedDict, cast

import cv2
import numpy as np

from dlgmd_cli import DLGMD, DlgmdParameters, load_set, open_video
from dlgmd_cli.errors import SourceError
from dlgmd_cli.machine import pool
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.video.writer import write_video

TABLE_IV_SET = 7
RADII = (6, 4, 3, 2)
SCALES = (1.0, 0.5, 0.25, 0.1, 0.02)
N_FRAMES = 120
PAPER_SIZE_WH = (1920, 1080)
# Table IV of [Zhao2023]: seconds for 120 frames, and distinguishability, by radius and scale;
# MOST_DA stands for "more than 10000".
MOST_DA = 10_000.0
_PAPER = {
    6: ((9.18, 2.75, 1.06, 0.75, 0.6), (249.33, 9789.28, MOST_DA, MOST_DA, 1354.1)),
    4: ((8.71, 2.54, 0.98, 0.7, 0.59), (33.44, 691.2, 4579.4, 105.33, 184.54)),
    3: ((8.7, 2.53, 0.97, 0.67, 0.57), (9.1, 96.75, 1227.6, 36.13, 76.06)),
    2: ((8.67, 2.49, 0.95, 0.66, 0.57), (3.87, 11.09, 32.29, 11.76, 18.47)),
}
PAPER_S, PAPER_DA = (
    {(r, x): _PAPER[r][part][column] for r in RADII for column, x in enumerate(SCALES)}
    for part in (0, 1)
)
# The first steps of a model take longer, and are not timed.
N_WARM = 4
# Title of a column in a terminal: key of the row, format.
_SHOWN = {
    "r": ("radius", "d"),
    "scale": ("scale", "g"),
    "width": ("width", "d"),
    "height": ("height", "d"),
    "frames/s": ("frames_per_s", ".0f"),
    "core ms": ("core_ms", ".3f"),
    "whole ms": ("whole_ms", ".3f"),
    "120 frames s": ("whole_s", ".2f"),
    "paper s": ("paper_s", ".2f"),
    "ratio": ("ratio", ".1f"),
    "paper DA": ("paper_da", ".6g"),
}


class Timing(TypedDict):
    """A row of the table; times are medians of the repetitions.

    `core_ms` is the time of a frame in the model alone, `whole_ms` with decoding, conversion to
    grey and scaling, one after the other. `whole_s` is that of 120 frames, `ratio` the speed
    relative to the paper's. The paper's values are None where the paper has none.
    """

    radius: int
    scale: float
    width: int
    height: int
    frames_per_s: float
    core_ms: float
    whole_ms: float
    whole_s: float
    paper_s: float | None
    ratio: float | None
    paper_da: float | None


Value = str | float | None


def _values(row: Timing) -> dict[str, Value]:
    """The row as a plain dict, whose values have one type."""
    return cast(dict[str, Value], row)


class Pass(NamedTuple):
    """What is timed once: a model over the first frames of a video, at a scale."""

    video: str
    params: DlgmdParameters
    scale: float
    n_frames: int


class PassTimes(NamedTuple):
    """Times per frame of one pass, the sizes of input and processed frames."""

    core_ms: float
    whole_ms: float
    input_wh: tuple[int, int]
    size_wh: tuple[int, int]


@dataclass(eq=False)
class Bench(Outcome):
    """How long the model takes; `rows` has one row for each radius and scale."""

    TABLES = ("bench.csv",)

    rows: list[Timing]

    def cells(self) -> dict[str, tuple[list[str], list[list[Value]]]]:
        """The rows as `bench.csv` has them."""
        return {"bench.csv": ([*self.rows[0]], [[*_values(row).values()] for row in self.rows])}

    def shown(self) -> Iterator[Shown]:
        """The table, and the path of its file if there is one."""
        lines = []
        for row in self.rows:
            values = [(_values(row)[key], form) for key, form in _SHOWN.values()]
            lines.append(tuple("" if v is None else format(v, form) for v, form in values))
        yield tuple(_SHOWN), lines
        yield from self.paths


def bench(
    video: str | os.PathLike[str],
    params: DlgmdParameters | None = None,
    *,
    radii: Iterable[int] = RADII,
    scales: Iterable[float] = SCALES,
    frames: int = N_FRAMES,
    repeats: int = 3,
    on_pass: Callable[[int], object] = lambda n_done: None,
) -> Bench:
    """Measure how long the model takes, as in the paper's Table IV.

    Each repetition goes through all radii and scales, so that slow moments of the machine affect
    all alike. OpenCV has one thread.

    Parameters
    ----------
    video : str or path
        The input, see `open_video`; `moving_texture` makes one in the paper's size.
    params : DlgmdParameters, optional
        The model, whose radius is replaced; set 7 unless given.
    radii, scales : iterable of int, of float
        Radii of the kernels in px, and scales of the processed frames.
    frames, repeats : int
        Number of frames to process, and how often each measurement is repeated.
    on_pass : callable
        Called with the number of passes that are done.

    Returns
    -------
    Bench

    Raises
    ------
    SourceError
        If the input cannot be decoded, or has too few frames.
    ParameterError, MissingExtraError
        As in `run`.
    """
    params = params or load_set(TABLE_IV_SET)
    points = [*product(radii, scales)]
    passes = [
        Pass(str(video), replace(params, r=radius), scale, frames)
        for _ in range(repeats)
        for radius, scale in points
    ]
    times: dict[tuple[int, float], list[PassTimes]] = {point: [] for point in points}
    for n_done, (one, end) in enumerate(pool.run_tasks(_timed, passes, jobs=1), start=1):
        times[one.params.r, one.scale].append(end.result())
        on_pass(n_done)
    return Bench([_row(*point, times[point]) for point in points])


def _timed(one: Pass) -> PassTimes:
    """Time a model over the first frames of a video."""
    cv2.setNumThreads(1)
    model = DLGMD(one.params)
    n_cold = model.first_valid_frame + N_WARM
    core_s: list[float] = []
    ends_s: list[float] = []
    with open_video(one.video, scale=one.scale, max_frames=one.n_frames) as video:
        for frame in video:
            begin_s = time.perf_counter()
            model.step(frame.grey)
            ends_s.append(time.perf_counter())
            core_s.append(ends_s[-1] - begin_s)
        n_timed = len(ends_s) - n_cold
        if n_timed < 1:
            why = f"{len(ends_s)} frames are too few to time, at least {n_cold + 1} are needed"
            raise SourceError(one.video, why, "Use a longer clip.")
        return PassTimes(
            core_ms=1e3 * median(core_s[n_cold:]),
            whole_ms=1e3 * (ends_s[-1] - ends_s[n_cold - 1]) / n_timed,
            input_wh=(video.info.width, video.info.height),
            size_wh=video.size_wh,
        )


def _row(radius: int, scale: float, passes: list[PassTimes]) -> Timing:
    """The row of a radius and a scale."""
    whole_ms = median(one.whole_ms for one in passes)
    whole_s = whole_ms * N_FRAMES / 1000.0
    is_paper_s = passes[0].input_wh == PAPER_SIZE_WH
    paper_s = PAPER_S.get((radius, scale)) if is_paper_s else None
    return {
        "radius": radius,
        "scale": scale,
        "width": passes[0].size_wh[0],
        "height": passes[0].size_wh[1],
        "frames_per_s": 1000.0 / whole_ms,
        "core_ms": median(one.core_ms for one in passes),
        "whole_ms": whole_ms,
        "whole_s": whole_s,
        "paper_s": paper_s,
        "ratio": None if paper_s is None else paper_s / whole_s,
        "paper_da": PAPER_DA.get((radius, scale)) if is_paper_s else None,
    }


@contextmanager
def moving_texture(n_frames: int) -> Iterator[Path]:
    """A temporary video in the paper's frame size, past whose texture the camera pans.

    Raises OutputError if it cannot be written.
    """
    width, height = PAPER_SIZE_WH
    coarse = np.random.default_rng(0).integers(0, 256, (height // 8, width // 8), np.uint8)
    texture = cv2.resize(coarse, PAPER_SIZE_WH, interpolation=cv2.INTER_CUBIC)
    with tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
        path = Path(folder, "texture.mp4")
        panned = (np.roll(texture, -2 * n, axis=1) for n in range(n_frames))
        write_video(path, panned, (height, width), 30.0)
        yield path
