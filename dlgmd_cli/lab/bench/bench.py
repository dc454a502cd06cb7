"""Speed of the model on this machine, in the form of the paper's Table IV."""

from __future__ import annotations

import logging
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, product
from pathlib import Path
from statistics import median
from typing import TypedDict

from dlgmd_cli.errors import SourceError, warn
from dlgmd_cli.machine import cancel
from dlgmd_cli.models.base import create_model
from dlgmd_cli.parameters.facts import Json, flat, plain
from dlgmd_cli.parameters.presets import DlgmdParameters, load_set
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import Cells
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.scenes.flights.scenes import find_scene, open_scene
from dlgmd_cli.tasks.call import Progress, Request, Setup, no_progress, silent
from dlgmd_cli.tasks.run import run_models
from dlgmd_cli.video.base import DEFAULT_DECODER
from dlgmd_cli.video.opening import open_video
from dlgmd_cli.video.options import InputOptions
from dlgmd_cli.video.source import Video, opencv_threads
from dlgmd_cli.video.writer import write_video

_log = logging.getLogger(__name__)

TABLE_IV_SET = 7
RADII = (6, 4, 3, 2)
SCALES = (1.0, 0.5, 0.25, 0.1, 0.02)
N_FRAMES = 120
PAPER_SIZE_WH = (1920, 1080)
SCENE = "group1"
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
# The model alone is timed on this many decoded frames in memory, after a few warm-up steps.
MAX_KEPT, N_WARM = 24, 4
# Title of a column in a terminal: key of the row, format.
_SHOWN = {
    "r": ("radius", "d"),
    "scale": ("scale", "g"),
    "size": ("size", ""),
    "engine": ("engine", ""),
    "frames/s": ("frames_per_s", ".0f"),
    "core ms": ("core_ms", ".3f"),
    "decode ms": ("decode_ms", ".3f"),
    "whole ms": ("whole_ms", ".3f"),
    "120 frames s": ("whole_s", ".2f"),
    "paper s": ("paper_s", ".2f"),
    "ratio": ("ratio", ".1f"),
    "paper DA": ("paper_da", ".6g"),
}


class Times(TypedDict):
    """Median times per frame of the model alone, of decoding, and of a whole run, in ms."""

    core_ms: float
    decode_ms: float
    whole_ms: float


class Timing(Times):
    """A row of the table, see `row`."""

    radius: int
    scale: float
    width: int
    height: int
    engine: str
    frames_per_s: float
    whole_s: float
    paper_s: float | None
    ratio: float | None
    paper_da: float | None


def bench(
    video: str | os.PathLike[str] | None = None,
    *,
    radii: Iterable[int] = (),
    scales: Iterable[float] = (),
    frames: int = N_FRAMES,
    repeats: int = 3,
    engine: str | None = None,
    decoder: str | None = None,
    csv: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> Bench:
    """Measure how long the model takes, as in the paper's Table IV.

    Parameters
    ----------
    video : str or path, optional
        The input; a rendered 1080p flight, `SCENE`, unless given.
    radii, scales : iterable of int, of float
        Radii of the kernels in px, and scales of the processed frames; those of the paper unless
        given.
    frames, repeats : int
        Number of frames to process, and how often each measurement is repeated.
    engine, decoder
        As in `run`.
    csv : str or path, optional
        Also write the table to this file; an earlier one is replaced only with `overwrite`.
    progress
        As in `batch`.

    Returns
    -------
    Bench
        `table` has a row for each radius and scale.

    Raises
    ------
    SourceError
        If the input cannot be decoded, or has too few frames.
    ParameterError, MissingExtraError, OutputError, OutputExistsError
        As in `run`.

    Examples
    --------
    >>> bench(radii=[6], scales=[1.0]).table["whole_ms"]  # doctest: +SKIP
    array([23.1])
    """
    radii, scales = tuple(dict.fromkeys(radii)) or RADII, tuple(dict.fromkeys(scales)) or SCALES
    with ExitStack() as opened:
        path = None if csv is None else Path(csv)
        if path is not None:  # an unwritable folder fails at once, not after minutes
            claimed = store.claimed(
                path.parent, names=[path.name], overwrite=overwrite, named_by="csv", locks=False
            )
            stage = opened.enter_context(opened.enter_context(claimed).staged())
        if video is None:
            _log.info("Rendering %d frames of %dx%d.", frames, *PAPER_SIZE_WH)
        given = video or opened.enter_context(rendered_flight(frames))
        open_at = partial(open_video, given, max_frames=frames, decoder=decoder or DEFAULT_DECODER)
        with progress("bench", repeats * len(radii) * len(scales), "step") as on_step:
            result = measure(
                open_at,
                load_set(TABLE_IV_SET),
                radii=radii,
                scales=scales,
                repeats=repeats,
                engine=engine or "auto",
                on_step=on_step,
            )
        for warning in result.warnings:
            warn(f"{video or 'the clip'}: {warning}")
        if path is not None:
            result.tables()[Bench.TABLES[0]](stage / path.name)
            result.paths = (path,)
    return result


@dataclass(eq=False, repr=False)
class Bench(Outcome):
    """How long a model takes.

    Attributes
    ----------
    frames : int
        Number of frames that were processed.
    decoder : str
        What decoded them.
    decoding_alone_ms : float
        Time per frame of decoding, without conversion and resizing.
    rows : list of dict
        One for each radius and scale, see `row`.
    input_wh : (int, int)
        Width and height of the input in px.
    warnings : list of str
        Doubts about the input.
    """

    TABLES = ("bench.csv",)

    frames: int
    decoder: str
    decoding_alone_ms: float
    rows: list[Timing]
    input_wh: tuple[int, int]
    warnings: list[str]

    def __repr__(self) -> str:
        first = self.rows[0]
        return f"<Bench of {len(self.rows)} models: {first['frames_per_s']:.0f} frames/s at first>"

    def cells(self) -> Cells:
        """The rows: radius, scale, size, engine, times, and what the paper states."""
        return {"bench.csv": ([*self.rows[0]], [[*flat(row).values()] for row in self.rows])}

    def facts(self) -> dict[str, Json]:
        """What its JSON has."""
        return {
            "frames": self.frames,
            "decoder": self.decoder,
            "decoding_alone_ms": self.decoding_alone_ms,
            "rows": [plain(row) for row in self.rows],
        }

    def shown(self) -> Iterator[Shown]:
        """The table, and how long the whole pipeline takes compared with decoding alone."""
        cells, shares = [], []
        for row in self.rows:
            size = f"{row['width']}x{row['height']}"
            values = {**row, "size": size}
            shown = [(values.get(key), form) for key, form in _SHOWN.values()]
            cells.append(tuple("" if v is None else format(v, form) for v, form in shown))
            if row["radius"] == self.rows[0]["radius"]:
                ratio = row["whole_ms"] / self.decoding_alone_ms
                shares.append(f"{ratio:.2f} times as long at {size}")
        yield tuple(_SHOWN), cells
        width, height = self.input_wh
        yield (
            f"Decoding {self.frames} frames of {width}x{height} alone takes "
            f"{self.decoding_alone_ms:.3f} ms per frame ({self.decoder}). "
            f"With r = {self.rows[0]['radius']}, the whole pipeline takes {', '.join(shares)}."
        )
        yield from self.paths


@contextmanager
def rendered_flight(n_frames: int) -> Iterator[str]:
    """A temporary video of a flight, in the paper's frame size; raises OutputError."""
    width, height = PAPER_SIZE_WH
    options = {"size": (height, width), "frames": n_frames}
    with tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
        path = Path(folder) / "flight.mp4"
        with open_scene(find_scene(SCENE), options, scale=1.0) as flight:
            write_video(path, (frame.grey for frame in flight), (height, width), 30.0)
        yield str(path)


def measure(
    open_at: Callable[..., Video],
    params: DlgmdParameters,
    *,
    radii: Sequence[int] = RADII,
    scales: Sequence[float] = SCALES,
    repeats: int = 1,
    engine: str = "auto",
    on_step: Callable[[int], None] = silent,
) -> Bench:
    """Time the model for every radius and scale, in turn so that slow moments affect all alike.

    `open_at` opens the input at a linear `scale`; the radius of `params` is replaced. All times are
    medians of `repeats` measurements. `on_step` is called with the number of measurements done.
    Raises SourceError if the input has too few frames.
    """
    with ExitStack() as opened, opencv_threads(1):
        videos = {scale: opened.enter_context(open_at(scale=scale)) for scale in scales}
        first, combinations = videos[scales[0]], list(product(radii, scales))
        alone_ms, decode_ms, model_ms = [], defaultdict(list), defaultdict(list)
        for repeat in range(repeats):
            alone_ms.append(_ms_per_frame(first, partial(_exhaust, first.pictures())))
            for scale, video in videos.items():
                decode_ms[scale].append(_ms_per_frame(video, partial(_exhaust, video)))
            n_before = repeat * len(combinations)
            for n_done, (radius, scale) in enumerate(combinations, start=n_before + 1):
                timed = _model_ms(videos[scale], replace(params, r=radius), engine)
                model_ms[radius, scale].append(timed)
                cancel.check()
                on_step(n_done)
        rows = []
        for radius, scale in combinations:
            core_ms, whole_ms, engines = zip(*model_ms[radius, scale], strict=True)
            times: Times = {
                "core_ms": median(core_ms),
                "decode_ms": median(decode_ms[scale]),
                "whole_ms": median(whole_ms),
            }
            rows.append(row(radius, scale, videos[scale], engines[0], times))
        return Bench(
            first.progress.n_decoded,
            first.info.decoder,
            median(alone_ms),
            rows,
            (first.info.width, first.info.height),
            list(dict.fromkeys(first.progress.warnings)),
        )


def row(radius: int, scale: float, video: Video, engine: str, times: Times) -> Timing:
    """A row of the table: median times per frame, and the paper's values, None where not given.

    Of `times`, `core_ms` is the model alone on decoded frames, `decode_ms` decoding with conversion
    and resizing, and `whole_ms` a complete run as by `dlgmd run`. `whole_s` is a complete run of
    120 frames, `ratio` the speed relative to the paper, `paper_da` its distinguishability.
    """
    whole_s = times["whole_ms"] * N_FRAMES / 1000.0
    is_paper_s = (video.info.width, video.info.height) == PAPER_SIZE_WH
    paper_s = PAPER_S.get((radius, scale)) if is_paper_s else None
    return {
        "radius": radius,
        "scale": scale,
        "width": video.size_wh[0],
        "height": video.size_wh[1],
        "engine": engine,
        "frames_per_s": 1000.0 / times["whole_ms"],
        **times,
        "whole_s": whole_s,
        "paper_s": paper_s,
        "ratio": None if paper_s is None else paper_s / whole_s,
        "paper_da": PAPER_DA.get((radius, scale)) if is_paper_s else None,
    }


def _model_ms(video: Video, params: DlgmdParameters, engine: str) -> tuple[float, float, str]:
    """Time per frame of the model alone and of a complete run, in ms, and the engine's name."""
    model = create_model(params, engine=engine)
    kept = [frame.grey for frame in islice(video, MAX_KEPT)]
    n_cold = model.first_valid_frame + N_WARM
    if len(kept) <= n_cold:
        why = f"{len(kept)} frames are too few to time, at least {n_cold + 1} are needed"
        raise SourceError(video.info.path, why, "Use a longer clip.")
    times_s = []
    for frame in kept:
        start = time.perf_counter()
        model.step(frame)
        times_s.append(time.perf_counter() - start)
    setup = Setup(params, "bench", model.engine_name)
    request = Request((setup,), InputOptions(size=video.size_wh))
    whole = partial(run_models, video, request, identity={}, measures=False)
    return 1000.0 * median(times_s[n_cold:]), _ms_per_frame(video, whole), model.engine_name


def _ms_per_frame(video: Video, act: Callable[[], object]) -> float:
    """Time per frame, in ms, of `act`, which reads all of `video`."""
    start = time.perf_counter()
    act()
    return 1000.0 * (time.perf_counter() - start) / video.progress.n_decoded


def _exhaust(items: Iterable[object]) -> None:
    """Iterate to the end."""
    for _ in items:
        cancel.check()
