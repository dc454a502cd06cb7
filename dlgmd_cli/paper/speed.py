"""The paper's Table IV, how long the model takes, on this machine."""

import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from statistics import median

from dlgmd_cli.errors import SourceError
from dlgmd_cli.models.base import Grey, Model, create_model
from dlgmd_cli.parameters import DlgmdParameters
from dlgmd_cli.runs.recording import Recording
from dlgmd_cli.runs.single import run
from dlgmd_cli.video.frames import Video
from dlgmd_cli.video.prefetch import opencv_threads

RADII = (6, 4, 3, 2)
SCALES = (1.0, 0.5, 0.25, 0.1, 0.02)
N_FRAMES = 120
PAPER_SIZE_WH = (1920, 1080)
# Seconds for 120 frames by radius and scale, as far as they are known here.
PAPER_S = {(6, 1.0): 9.18, (6, 0.25): 1.06, (2, 0.02): 0.57}
# The core is timed on frames that were decoded before; more of them would only take memory.
MAX_KEPT, N_WARM = 24, 4


@dataclass(frozen=True)
class Timing:
    """One radius at one scale; times are medians, in ms a frame.

    Attributes
    ----------
    radius, scale : int, float
        Calculating radius r in px, linear scale.
    width, height : int
        Size at which frames are processed, in px.
    engine : str
        What computed the model.
    core_ms : float
        The model alone, on decoded frames.
    decode_ms : float
        Decoding, grey, resizing, without the model.
    whole_ms : float
        A run as `dlgmd run` does it: decoding ahead of the model.
    paper_s : float or None
        What the paper reports for 120 frames of 1080p, where it is known and the input is such.
    """

    radius: int
    scale: float
    width: int
    height: int
    engine: str
    core_ms: float
    decode_ms: float
    whole_ms: float
    paper_s: float | None

    @property
    def frames_per_s(self) -> float:
        """Frames per second of the whole."""
        return 1000.0 / self.whole_ms

    @property
    def whole_s(self) -> float:
        """The whole for 120 frames, in seconds."""
        return self.whole_ms * N_FRAMES / 1000.0

    @property
    def ratio(self) -> float | None:
        """How many times as fast as the paper."""
        return None if self.paper_s is None else self.paper_s / self.whole_s


@dataclass(frozen=True)
class Measurement:
    """A whole table, and what it is held against: decoding every frame and nothing else."""

    timings: list[Timing]
    decoding_alone_ms: float
    n_frames: int
    input_wh: tuple[int, int]
    decoder: str
    warnings: list[str]


@dataclass
class _Cell:
    """One radius at one scale while it is being measured."""

    params: DlgmdParameters
    scale: float
    source: Video
    core_ms: list[float] = field(default_factory=list)
    whole_ms: list[float] = field(default_factory=list)
    engine: str = ""

    def time_once(self, engine: str, tell: Callable[[str], None]) -> None:
        """Measure the core and the whole once more."""
        model = create_model(self.params, engine=engine, tell=tell)
        kept = [frame.grey for frame in islice(self.source, MAX_KEPT)]
        n_needed = model.first_valid_frame + N_WARM + 1
        if len(kept) < n_needed:
            raise SourceError(
                self.source.info.path,
                f"{len(kept)} frames are too few to time, it takes at least {n_needed}",
                "Use a longer clip.",
            )
        self.core_ms.append(_core_ms(model, kept))
        whole = partial(run, self.source, model, Recording())
        self.whole_ms.append(_ms_a_frame(self.source, whole))
        self.engine = model.engine_name


def measure(
    open_at: Callable[[float], Video],
    params: DlgmdParameters,
    *,
    radii: Sequence[int] = RADII,
    scales: Sequence[float] = SCALES,
    repeats: int = 3,
    engine: str = "auto",
    on_step: Callable[[int], None] = lambda n_done: None,
    tell: Callable[[str], None] = lambda message: None,
) -> Measurement:
    """Time runs of the model and their parts in turn, so that a slow moment hits all alike.

    Parameters
    ----------
    open_at : callable
        Linear scale -> the input at that scale. The sources are closed at the end.
    params : DlgmdParameters
        Of the model; the radius is replaced.
    radii, scales : sequence of int, sequence of float
        What to combine.
    repeats : int
        Times that everything is measured; medians are taken.
    engine : str
        See `DLGMD`.
    on_step : callable, optional
        Called with the number of combinations measured so far, repeats counted.
    tell : callable, optional
        See `DLGMD`.

    Raises
    ------
    SourceError
        If the input has too few frames.
    """
    with ExitStack() as opened, opencv_threads(1):
        sources = {scale: opened.enter_context(open_at(scale)) for scale in scales}
        first = sources[scales[0]]
        cells = [
            _Cell(replace(params, r=radius), scale, source)
            for radius in radii
            for scale, source in sources.items()
        ]
        decode_ms: dict[float, list[float]] = {scale: [] for scale in scales}
        alone_ms: list[float] = []
        n_done = 0
        for _ in range(repeats):
            alone_ms.append(_ms_a_frame(first, partial(_exhaust, first.pictures())))
            for scale, source in sources.items():
                decode_ms[scale].append(_ms_a_frame(source, partial(_exhaust, source)))
            for cell in cells:
                cell.time_once(engine, tell)
                n_done += 1
                on_step(n_done)
        return Measurement(
            [_timing(cell, decode_ms[cell.scale]) for cell in cells],
            median(alone_ms),
            first.progress.n_decoded,
            (first.info.width, first.info.height),
            first.info.decoder,
            list(dict.fromkeys(first.progress.warnings)),
        )


def _timing(cell: _Cell, decode_ms: list[float]) -> Timing:
    """The medians of a cell."""
    info = cell.source.info
    is_papers = (info.width, info.height) == PAPER_SIZE_WH
    return Timing(
        radius=cell.params.r,
        scale=cell.scale,
        width=cell.source.size_wh[0],
        height=cell.source.size_wh[1],
        engine=cell.engine,
        core_ms=median(cell.core_ms),
        decode_ms=median(decode_ms),
        whole_ms=median(cell.whole_ms),
        paper_s=PAPER_S.get((cell.params.r, cell.scale)) if is_papers else None,
    )


def _ms_a_frame(source: Video, act: Callable[[], None]) -> float:
    """What `act`, which goes through all of `source`, takes for a frame."""
    start = time.perf_counter()
    act()
    elapsed = time.perf_counter() - start
    return 1000.0 * elapsed / source.progress.n_decoded


def _exhaust(items: Iterable[object]) -> None:
    for _ in items:
        pass


def _core_ms(model: Model, frames: list[Grey]) -> float:
    """What the model takes for a frame that lies decoded in memory; the first few only warm up."""
    times = []
    for frame in frames:
        start = time.perf_counter()
        model.step(frame)
        times.append(time.perf_counter() - start)
    return 1000.0 * median(times[model.first_valid_frame + N_WARM :])
