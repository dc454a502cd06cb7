"""The first spike of set 9 through other lenses, at other sizes and rates: a rendered square."""

import math
import subprocess
from itertools import islice, pairwise
from statistics import median

import numpy as np
import pytest
from watching import fed, lines_of, live

from dlgmd_cli import load_set
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.normalise import absolute
from dlgmd_cli.models.windows import Camera

pytestmark = pytest.mark.slow

SIDE_M, FRAME_S, FIRST_S = 0.5, 1.0 / 30.0, 1.0
USUAL = (30, 80, 480)
# Frames a second, lens in degrees, width in px.
OTHERS = [
    *((60, 80, 480), (120, 80, 480), (240, 80, 480)),
    *((30, 40, 480), (30, 60, 480), (30, 120, 480), (30, 80, 240), (30, 80, 960)),
]
BETWEEN = [(24, 80, 480), (25, 80, 480), (40, 80, 480), (50, 80, 480), (100, 80, 480)]
FEWER = [(120, 80, 480), (50, 80, 480), (30, 40, 480), (30, 120, 480), (30, 80, 240)]


def shares(n_px, edges_px):
    """How much of each pixel lies in each cell, (n_px, n cells), by the cells' edges."""
    left = np.arange(n_px)[:, None]
    return np.clip(np.minimum(left + 1, edges_px[1:]) - np.maximum(left, edges_px[:-1]), 0, None)


def cells(n_px, centre_px, side_px, n):
    return shares(n_px, centre_px + side_px * np.linspace(-0.5, 0.5, n + 1))


class Scene:
    """A square of 0.5 m that approaches head on, before a background at infinity."""

    def __init__(self, kind, fov_deg, width):
        rng = np.random.default_rng(5)
        self.shape, self.kind = (width * 9 // 16, width), kind
        self.focal_px = width / 2 / math.tan(math.radians(fov_deg) / 2)
        n = 12 if kind == "texture" else 1
        self.object = rng.uniform(0.05, 0.5, (n, n)) if kind == "texture" else np.array([[0.2]])
        self.ground = np.full(self.shape, 0.8)
        if kind == "texture":
            patches = rng.uniform(0.5, 0.9, (400, 400))
            down, across = (cells(n_px, n_px / 2, 4 * self.focal_px, 400) for n_px in self.shape)
            self.ground = down @ patches @ across.T
        self.rng = np.random.default_rng(0)

    def at(self, distance_m):
        side_px, n = self.focal_px * SIDE_M / distance_m, len(self.object)
        down, across = (cells(n_px, n_px / 2, side_px, n) for n_px in self.shape)
        covered = down.sum(1)[:, None] * across.sum(1)
        image = self.ground * (1 - covered) + down @ self.object @ across.T
        if self.kind == "noise":
            image = image + self.rng.normal(0, 0.01, self.shape)
        return np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8)


def first_spike_s(camera, kind, speed_m_s, units="degrees", left_out=()):
    """Seconds before contact of the first spike; NaN without one."""
    fps, fov_deg, width = camera
    params, scene = load_set(9, units=units), Scene(kind, fov_deg, width)
    model = create_model(params)
    model.look(Camera(fov_deg))
    for k in range(int(FIRST_S * fps), 0, -1):
        if k % 4 in left_out:
            continue
        response = model.step(scene.at(speed_m_s * k / fps), 10.0 - k / fps)
        if absolute(response.mp, model.n_cells, params.kappa) >= params.t_mp:
            return k / fps
    return math.nan


def is_near(found_s, usual_s, fps, n_frames=1):
    return abs(found_s - usual_s) <= max(0.15 * usual_s, n_frames / min(fps, 30) + 1e-6)


def test_a_plain_square_at_two_speeds():
    rows = [USUAL, *OTHERS]
    found = {
        (units, speed): [first_spike_s(row, "plain", speed, units) for row in rows]
        for units in ("pixels", "degrees")
        for speed in (2.0, 3.0)
    }
    for number, row in enumerate(rows):
        cells_of_row = (f"{name}: {some[number]:.3f}" for name, some in found.items())
        print(row, *cells_of_row, sep="; ")
    for speed in (2.0, 3.0):
        usual_s, *others_s = found["degrees", speed]
        assert all(map(is_near, others_s, [usual_s] * len(others_s), [row[0] for row in OTHERS]))
        in_pixels_s = found["pixels", speed]
        assert max(in_pixels_s) > 3.5 * min(in_pixels_s)


@pytest.mark.parametrize("kind", ["plain", "texture", "noise"])
@pytest.mark.parametrize("speed_m_s", [2.0, 3.0])
def test_texture_noise_and_rates_between(kind, speed_m_s):
    usual_s = first_spike_s(USUAL, kind, speed_m_s)
    for camera in BETWEEN if kind == "plain" else FEWER:
        found_s = first_spike_s(camera, kind, speed_m_s)
        n_frames = 2 if kind == "noise" else 1
        assert is_near(found_s, usual_s, camera[0], n_frames), (camera, found_s, usual_s)


def test_dropped_frames_and_a_slow_camera_lose_time():
    usual_s = first_spike_s(USUAL, "plain", 2.0)
    late_s = [usual_s - first_spike_s(USUAL, "plain", 2.0, left_out=(n,)) for n in range(4)]
    assert min(late_s) >= -1e-6 and max(late_s) <= 3 * FRAME_S + 1e-6
    assert math.isnan(first_spike_s((15, 80, 480), "plain", 2.0))


@pytest.mark.parametrize(("options", "least_step"), [((), 2), (("--physical",), 1)])
def test_live_takes_every_frame(options, least_step):
    """Of a camera of 60 frames/s, once its rate is known."""
    arguments = ("-", "--input-size", "64x48", "--set", 9, "--jsonl", *options)
    with live(*arguments, stdin=subprocess.PIPE, bufsize=0) as process, fed(process):
        lines = (one["frame"] for one in lines_of(process) if one["latency_ms"] is not None)
        frames = [*islice(lines, 200)][-50:]
    assert median(b - a for a, b in pairwise(frames)) == least_step
