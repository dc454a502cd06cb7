"""The paper's Table IV, how long the model takes, on this machine."""

import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from statistics import median
from typing import Any

from dlgmd_cli import cancel
from dlgmd_cli.errors import SourceError
from dlgmd_cli.models.base import Grey, Model, create_model
from dlgmd_cli.parameters import DlgmdParameters
from dlgmd_cli.runs.run import Setup, Tell, run_models
from dlgmd_cli.video.frames import InputOptions, Video
from dlgmd_cli.video.prefetch import opencv_threads

RADII = (6, 4, 3, 2)
SCALES = (1.0, 0.5, 0.25, 0.1, 0.02)
N_FRAMES = 120
PAPER_SIZE_WH = (1920, 1080)
# Seconds for 120 frames by radius and scale, as far as they are known here.
PAPER_S = {(6, 1.0): 9.18, (6, 0.25): 1.06, (2, 0.02): 0.57}
# The core is timed on frames that were decoded before; more of them would only take memory.
MAX_KEPT, N_WARM = 24, 4


@dataclass
class _Timing:
    """One radius at one scale; times are in ms per frame, one for each repeat."""

    params: DlgmdParameters
    scale: float
    video: Video
    decode_ms: list[float]
    core_ms: list[float] = field(default_factory=list)
    whole_ms: list[float] = field(default_factory=list)
    engine: str = "auto"

    def measure(self, engine: str, tell: Tell) -> None:
        """Time the core and the whole once more."""
        model = create_model(self.params, engine=engine, tell=tell)
        kept = [frame.grey for frame in islice(self.video, MAX_KEPT)]
        n_needed = model.first_valid_frame + N_WARM + 1
        if len(kept) < n_needed:
            raise SourceError(
                self.video.info.path,
                f"{len(kept)} frames are too few to time, at least {n_needed} are needed",
                "Use a longer clip.",
            )
        self.core_ms.append(_core_ms(model, kept))
        self.engine = model.engine_name
        setup = Setup(self.params, "bench", self.engine)
        whole = partial(run_models, self.video, [setup], InputOptions(), identity={})
        self.whole_ms.append(_ms_per_frame(self.video, whole))

    def row(self) -> dict[str, Any]:
        """The medians, what follows from them, and what the paper reports for such frames."""
        core_ms, decode_ms, whole_ms = map(median, (self.core_ms, self.decode_ms, self.whole_ms))
        info, whole_s = self.video.info, whole_ms * N_FRAMES / 1000.0
        is_paper_s = (info.width, info.height) == PAPER_SIZE_WH
        paper_s = PAPER_S.get((self.params.r, self.scale)) if is_paper_s else None
        return {
            "radius": self.params.r,
            "scale": self.scale,
            "width": self.video.size_wh[0],
            "height": self.video.size_wh[1],
            "engine": self.engine,
            "frames_per_s": 1000.0 / whole_ms,
            "core_ms": core_ms,
            "decode_ms": decode_ms,
            "whole_ms": whole_ms,
            "whole_s": whole_s,
            "paper_s": paper_s,
            "ratio": None if paper_s is None else paper_s / whole_s,
        }


def measure(
    open_at: Callable[[float], Video],
    params: DlgmdParameters,
    *,
    radii: Sequence[int] = RADII,
    scales: Sequence[float] = SCALES,
    repeats: int = 3,
    engine: str = "auto",
    on_step: Callable[[int], None] = lambda n_done: None,
    tell: Tell = lambda message: None,
) -> dict[str, Any]:
    """Time runs of the model and their parts in turn, so that a slow moment hits all alike.

    Parameters
    ----------
    open_at : callable
        Linear scale -> the input at that scale. The videos are closed at the end.
    params : DlgmdParameters
        Of the model; the radius is replaced.
    radii, scales : sequence of int, sequence of float
        What to combine.
    repeats : int
        How often everything is measured; medians are taken.
    engine : str
        See `DLGMD`.
    on_step : callable, optional
        Called with the number of combinations measured so far, repeats counted.
    tell : callable, optional
        See `DLGMD`.

    Returns
    -------
    dict
        `frames`, `decoder`, `decoding_alone_ms` (a frame, neither turned grey nor resized),
        `input_wh` in px, `warnings`, and `rows`, one per radius and scale: `radius` in px, `scale`,
        `width` and `height` of the processed frames in px, `engine`; medians per frame of the model
        alone on decoded frames (`core_ms`), of decoding with grey and resizing (`decode_ms`), and
        of a run as `dlgmd run` does it (`whole_ms`), which gives `frames_per_s` and `whole_s` for
        120 frames; `paper_s`, what the paper reports for these, and `ratio`, how many times as fast
        this is, None where that is not known.

    Raises
    ------
    SourceError
        If the input has too few frames.
    Interrupted
        If the user asks to stop.
    """
    with ExitStack() as opened, opencv_threads(1):
        videos = {scale: opened.enter_context(open_at(scale)) for scale in scales}
        first = videos[scales[0]]
        decode_ms: dict[float, list[float]] = {scale: [] for scale in scales}
        timings = [
            _Timing(replace(params, r=radius), scale, video, decode_ms[scale])
            for radius in radii
            for scale, video in videos.items()
        ]
        alone_ms: list[float] = []
        n_done = 0
        for _ in range(repeats):
            alone_ms.append(_ms_per_frame(first, partial(_exhaust, first.pictures())))
            for scale, video in videos.items():
                decode_ms[scale].append(_ms_per_frame(video, partial(_exhaust, video)))
            for timing in timings:
                timing.measure(engine, tell)
                cancel.check()
                n_done += 1
                on_step(n_done)
        return {
            "frames": first.progress.n_decoded,
            "decoder": first.info.decoder,
            "decoding_alone_ms": median(alone_ms),
            "input_wh": (first.info.width, first.info.height),
            "warnings": list(dict.fromkeys(first.progress.warnings)),
            "rows": [timing.row() for timing in timings],
        }


def _ms_per_frame(video: Video, act: Callable[[], object]) -> float:
    """How long `act`, which goes through all of `video`, takes for a frame."""
    start = time.perf_counter()
    act()
    elapsed = time.perf_counter() - start
    return 1000.0 * elapsed / video.progress.n_decoded


def _exhaust(items: Iterable[object]) -> None:
    """Go through all items."""
    for _ in items:
        cancel.check()


def _core_ms(model: Model, frames: list[Grey]) -> float:
    """How long the model takes for a frame in memory; the first few only warm up."""
    times = []
    for frame in frames:
        start = time.perf_counter()
        model.step(frame)
        times.append(time.perf_counter() - start)
    return 1000.0 * median(times[model.first_valid_frame + N_WARM :])
