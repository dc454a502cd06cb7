"""Speed of every model of the package on this machine."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from statistics import median

import cv2
import numpy as np

from dlgmd_cli.lab.bench.bench import N_WARM
from dlgmd_cli.models.base import Grey, create_model
from dlgmd_cli.parameters.presets import MODELS
from dlgmd_cli.results.outcome import Outcome, Shown

# The size of the LGMD benchmark's videos, and that of a camera.
SIZES_WH = ((432, 240), (1280, 720))


@dataclass(eq=False)
class ModelTimes(Outcome):
    """Median CPU time of a frame in each model alone; `rows` has (model, width, height) -> ms."""

    TABLES = ("models.csv",)

    rows: dict[tuple[str, int, int], float]

    def cells(self) -> dict[str, tuple[list[str], list[list[str | float | None]]]]:
        """The rows as `models.csv` has them."""
        header = ["model", "width", "height", "core_ms", "frames_per_s"]
        return {"models.csv": (header, [[*key, ms, 1e3 / ms] for key, ms in self.rows.items()])}

    def shown(self) -> Iterator[Shown]:
        """The table, and the path of its file if there is one."""
        lines = [
            (name, f"{width}x{height}", f"{ms:.2f}", f"{1e3 / ms:.0f}")
            for (name, width, height), ms in self.rows.items()
        ]
        yield ("model", "size", "core ms", "frames/s"), lines
        yield from self.paths


def every_model(
    frames: int, repeats: int, on_pass: Callable[[int], object] = lambda n_done: None
) -> ModelTimes:
    """Time all models in turn, `repeats` times, with one thread of OpenCV.

    `on_pass` is called with the number of passes done: one for each model, size and repetition.
    """
    cv2.setNumThreads(1)
    times: dict[tuple[str, int, int], list[float]] = {}
    n_done = 0
    for _ in range(repeats):
        for width, height in SIZES_WH:
            clip = [*_panned(width, height, frames)]
            for name in MODELS:
                times.setdefault((name, width, height), []).append(_core_ms(name, clip))
                on_pass(n_done := n_done + 1)
    return ModelTimes({key: median(of) for key, of in times.items()})


def _panned(width: int, height: int, n_frames: int) -> Iterator[Grey]:
    """Grey frames past whose texture the camera pans, each with other noise."""
    random = np.random.default_rng(0)
    coarse = random.integers(0, 256, (height // 8, width // 8), np.uint8)
    texture = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    for n in range(n_frames):
        noise = random.integers(0, 8, (height, width), np.uint8)
        yield cv2.add(np.roll(texture, -2 * n, axis=1), noise)


def _core_ms(name: str, clip: Iterable[Grey]) -> float:
    """The median CPU time of a frame, without the first frames."""
    model = create_model(MODELS[name]())
    taken = []
    for frame in clip:
        begin_s = time.thread_time()
        model.step(frame)
        taken.append(time.thread_time() - begin_s)
    return 1e3 * median(taken[model.first_valid_frame + N_WARM :])
