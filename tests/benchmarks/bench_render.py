"""A frame of a flight on one core, beside a single homography over the whole image.

Not part of the test run. From the repository:

    python -m pytest tests/benchmarks/bench_render.py --benchmark-columns=median,iqr,rounds

"homography" is one textured plane that fills the image: `cv2.warpPerspective`, the least that a
frame can take. "render" is the light of frames of the group2 flight, "film" those frames with
vignette, noise and gamma, as they are encoded, and "blurred" with an exposure of half a frame.
"truth" is what stands in the CSV of a frame.
"""

import itertools

import cv2
import numpy as np
import pytest

from dlgmd_cli.scenes.flights.camera import Camera
from dlgmd_cli.scenes.flights.painter import Renderer
from dlgmd_cli.scenes.flights.scenes import SCENES

SIZES = [(360, 640), (1080, 1920)]
SCENE = SCENES["group2"]
EVERY = 10  # of its frames, one in so many


@pytest.mark.parametrize("method", ["homography", "render", "film", "blurred", "truth"])
@pytest.mark.parametrize("shape", SIZES, ids=lambda shape: f"{shape[1]}x{shape[0]}")
def test_frame(benchmark, set_threads, shape, method):
    set_threads(1)
    if method == "homography":
        texture = np.random.default_rng(0).random(shape, np.float32)
        matrix = np.array([[0.9, 0.02, 8.0], [0.01, 0.9, 6.0], [1e-5, 1e-5, 1.0]])
        size_wh = shape[::-1]
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        benchmark(lambda: cv2.warpPerspective(texture, matrix, size_wh, flags=flags))
        return
    exposure_ms = 500.0 / 30.0 if method == "blurred" else 0.0
    # A tenth of the frame rate takes every tenth frame.
    options = SCENE.configure({"size": shape, "fps": 30.0 / EVERY, "exposure": exposure_ms})
    stage = SCENE.stage(options)
    if method == "render":
        renderer = Renderer(stage.world, Camera(shape, options.fov_deg))
        times = itertools.cycle(np.arange(SCENE.n_frames(options)) / options.fps)
        benchmark.pedantic(
            lambda time: renderer.render(stage.path.pose(time), time),
            setup=lambda: ((next(times),), {}),
            rounds=3 * SCENE.n_frames(options),
            warmup_rounds=SCENE.n_frames(options),
        )
        return
    of_clip = SCENE.truth if method == "truth" else SCENE.frames
    frames = itertools.chain.from_iterable(of_clip(options) for _ in itertools.count())
    rounds = SCENE.n_frames(options) * (1 if method == "blurred" else 3)
    benchmark.pedantic(lambda: next(frames), rounds=rounds, warmup_rounds=2)
