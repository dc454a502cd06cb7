"""The D-LGMD in degrees and milliseconds."""

import math
from itertools import pairwise

import numpy as np
import pytest
from conftest import write_video

import dlgmd_cli
from dlgmd_cli import Alarm, load_set, read_result, run
from dlgmd_cli.errors import FrameError, ParameterError
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.expansion import Expansion
from dlgmd_cli.models.kernels import resized, shares
from dlgmd_cli.models.rules import rule_of, too_slow
from dlgmd_cli.models.windows import Camera

SET = load_set(9, units="degrees")
# So little inhibition that random images have a response.
WEAK = load_set(9, units="degrees", a=0.1)
SHAPE, FOV_DEG, STEP_S = (26, 34), 8.0, 1.0 / 30.0


def random_images(n, seed=0):
    """Images of squares of random luminance, 7 px wide."""
    squares = np.random.default_rng(seed).uniform(0.0, 1.0, (n, 4, 5))
    height, width = SHAPE
    return np.kron(squares, np.ones((7, 7))).astype(np.float32)[:, :height, :width].copy()


def responses(images, times_s, camera=None):
    model = create_model(WEAK)
    model.look(camera or Camera(FOV_DEG))
    return [model.step(image, float(t)) for image, t in zip(images, times_s, strict=True)]


def potentials(*args):
    return [response.mp for response in responses(*args)]


def overlap(a, b, c, d):
    return max(0.0, min(b, d) - max(a, c))


def spread(kernel, s):
    """A kernel whose taps are squares of s x s pixels, by the overlap of areas."""
    r = len(kernel) // 2
    reach = math.ceil(((2 * r + 1) * s - 1) / 2 - 1e-9)
    out = np.zeros((2 * reach + 1, 2 * reach + 1))
    for (i, j), value in np.ndenumerate(kernel):
        for y, x in np.ndindex(out.shape):
            down = overlap((i - r - 0.5) * s, (i - r + 0.5) * s, y - reach - 0.5, y - reach + 0.5)
            across = overlap((j - r - 0.5) * s, (j - r + 0.5) * s, x - reach - 0.5, x - reach + 0.5)
            out[y, x] += value * down * across / s**2
    return out


def correlated(image, weights, first):
    """Σ weights[i, j] image[y + i + first, x + j + first], zero outside."""
    out, (height, width) = np.zeros(image.shape), image.shape
    for (i, j), weight in np.ndenumerate(weights):
        for y in range(max(0, -i - first), min(height, height - i - first)):
            dx = j + first
            inside = slice(max(0, -dx), min(width, width - dx))
            moved = slice(inside.start + dx, inside.stop + dx)
            out[y, inside] += weight * image[y + i + first, moved]
    return out


def slow_reference(images, params):
    """K and FFI of four images 1/30 s apart, from the text of the model, without its code."""
    s = SHAPE[1] / 2 / math.tan(math.radians(FOV_DEG / 2)) * math.radians(0.3)
    side = math.ceil(s)
    box = [overlap(i - 0.5, i + 0.5, -s / 2, s / 2) / s for i in range(-side, side + 1)]
    padded = [np.pad(image, side, mode="edge") for image in images]
    seen = [correlated(one, np.outer(box, box), -side)[side:-side, side:-side] for one in padded]
    p = [np.abs(new - old) for old, new in pairwise(seen)][::-1]
    axis = np.arange(-params.r, params.r + 1.0)
    squared = axis[:, None] ** 2 + axis**2
    g_e, g_i = (
        np.exp(-squared / 2 / sigma**2) / sigma / math.sqrt(2 * math.pi)
        for sigma in (params.sigma_e, params.sigma_i)
    )
    tau = params.alpha + 1 / (params.beta + np.exp(-(params.lam**2) * squared))
    late = [params.a * g_i * band for band in (tau < 1, (tau >= 1) & (tau <= 1.8999), tau > 1.8999)]
    excitation = np.maximum(g_e - late[0], 0) * (tau <= 1)
    parts = [spread(kernel, s) for kernel in (excitation, -late[1], -late[2])]
    first = -(len(parts[0]) // 2)
    total = sum(correlated(p[d], kernel, first) for d, kernel in enumerate(parts))
    summed = np.maximum(total, 0)
    reach = math.ceil(2.5 * s + 0.5)
    window = [overlap(i - 0.5, i + 0.5, -1.5 * s, 2.5 * s) / s for i in range(-reach, reach + 1)]
    g = params.k * summed * correlated(summed, np.outer(window, window), -reach)
    focal = SHAPE[1] / 2 / math.tan(math.radians(FOV_DEG / 2))
    y, x = ((np.arange(n) - (n - 1) / 2) / focal for n in SHAPE)
    solid = (1 + x**2 + y[:, None] ** 2) ** -1.5
    solid /= solid.mean()
    ffi = (p[1] * solid).sum()
    t_de = min(ffi / p[1].size * params.t0 / params.m, 0.3)
    return (np.where(g >= t_de, np.minimum(g, 1), 0) * solid).sum(), ffi


def test_the_response_is_that_of_the_slow_reference():
    images = random_images(4)
    *early, found = responses(images, STEP_S * np.arange(4))
    assert not any(response.is_valid for response in early) and found.mp > 1.0
    assert (found.mp, found.ffi) == pytest.approx(slow_reference(images, WEAK), rel=1e-5)


def test_a_camera_of_the_papers_pixels_has_the_papers_connections():
    fov_deg = 2 * math.degrees(math.atan(SHAPE[1] / 2 * math.radians(0.3)))
    model = create_model(SET)
    model.look(Camera(fov_deg))
    model.step(random_images(1)[0], 0.0)
    in_pixels = DLGMD(load_set(9)).connections
    assert np.allclose(model.connections.excitation, in_pixels.excitation)
    assert model.connections.inhibition.keys() == in_pixels.inhibition.keys()


@pytest.mark.parametrize("scale", [0.37, 1.0, 1.5, 4.2])
def test_spread_connections_keep_their_sums(scale):
    narrow = DLGMD(load_set(6)).connections
    wide = resized(narrow, scale)
    assert wide.excitation.sum() == pytest.approx(narrow.excitation.sum())
    for delay, kernel in narrow.inhibition.items():
        assert wide.inhibition[delay].sum() == pytest.approx(kernel.sum())
    assert shares(3, scale).sum() == pytest.approx(3 * scale)
    assert len(shares(3, scale)) % 2 == 1


def test_frames_between_those_of_the_papers_camera_change_nothing():
    images = random_images(7)
    slow = potentials(images[::2], STEP_S * np.arange(4))[-1]
    assert potentials(images, STEP_S / 2 * np.arange(7))[-1] == pytest.approx(slow) and slow > 1.0


def test_between_two_steps_the_root_is_interpolated():
    images = random_images(7)
    # 50 frames/s: steps of 20 and 40 ms, a third and two thirds of the way apart.
    one, two = (responses(some, STEP_S * np.arange(4))[-1] for some in (images[3:], images[::2]))
    found = responses(images, np.arange(7) / 50.0)[-1]
    assert found.mp == pytest.approx((one.mp**0.5 / 3 + two.mp**0.5 * 2 / 3) ** 2, rel=1e-5)
    for name in ("p_sum", "s_sum"):
        between = getattr(one, name) / 3 + getattr(two, name) * 2 / 3
        assert getattr(found, name) == pytest.approx(between, rel=1e-5)
    assert one.mp > 1.0 and found.ffi == two.ffi  # of the nearer step


def test_a_missing_image_is_interpolated_and_a_slow_camera_is_told():
    images = random_images(4)
    images[2] = (images[1] + images[3]) / 2
    whole = potentials(images, STEP_S * np.arange(4))[-1]
    without = potentials(images[[0, 1, 3]], STEP_S * np.array([0, 1, 3]))[-1]
    assert without == pytest.approx(whole, rel=1e-4) and whole > 1.0
    rule = rule_of(SET)
    assert "needs 24 frames/s" in too_slow(rule, np.arange(9) / 20.0)
    assert too_slow(rule, np.arange(9) / 24.0) == ""


def test_ignored_cells_and_the_part_of_a_cropped_image():
    images = random_images(4)
    model = create_model(WEAK)
    model.look(Camera(FOV_DEG))
    hidden = np.zeros(SHAPE, bool)
    hidden[:, :17] = True
    model.ignore(hidden)
    for number, image in enumerate(images):
        response = model.step(image, STEP_S * number, layers=True)
    assert model.n_cells == 26 * 17 and response.mp > 1.0
    assert not response.layers.g[hidden].any()
    # A cell far from the optical axis has a smaller solid angle.
    wide = Camera(140.0, crop=(0.5, 0.0, 1.0, 1.0))
    model.ignore(None)
    model.look(wide)
    model.reset()
    model.step(images[0], 0.0)
    assert model._weights[13, 0] > 5.0 * model._weights[13, -1]
    assert model._weights.mean() == pytest.approx(1.0, rel=1e-5)


def test_spikes_last_for_the_time_of_n_sp_frames():
    def alarms(fps, n_on):
        rule = rule_of(load_set(9, units="degrees", n_sp=3))
        rows = (
            rule.step(Detection(frame=k, time_s=k / fps, level=0.5 if k >= 20 else 0.0))
            for k in range(20 + n_on)
        )
        return [row.frame for row in rows if row.alarm]

    assert alarms(30, 4) == [22, 23]
    assert alarms(120, 10) == [28, 29]  # 67 ms after the first spike
    assert rule_of(SET).text == "spikes: for 33 ms, at a normalised MP of 0.4 or more"


def test_every_frame_has_a_response_at_its_own_size(tmp_path):
    frames = [np.full((30, 700), 8 * k, np.uint8) for k in range(24)]
    video = write_video(tmp_path / "fast.avi", frames, fps=120)
    result = run(video, 9, param={"units": "degrees"}, fov=60)
    assert len(result) == 24 and result.record["processed"]["width"] == 700
    assert np.isnan(result.mp[:12]).all() and np.isfinite(result.mp[12:]).all()
    alarm = Alarm(SET, fov=60)
    answers = [alarm.step(frame, k / 120.0) for k, frame in enumerate(frames)]
    assert answers[-1].mp == pytest.approx(result.mp[-1])


def test_the_camera_of_an_alarm_is_that_of_its_expansion():
    images = random_images(4)
    far, near = Camera(FOV_DEG), Camera(3 * FOV_DEG)
    alarm = Alarm(WEAK, expansion=Expansion(camera=near))
    found = [[alarm.step(image, STEP_S * t).mp for t, image in enumerate(images)][-1]]
    alarm.reset()
    alarm.look(far)
    found += [[alarm.step(image, STEP_S * t).mp for t, image in enumerate(images)][-1]]
    wanted = [potentials(images, STEP_S * np.arange(4), camera)[-1] for camera in (near, far)]
    assert found == pytest.approx(wanted) and wanted[0] != pytest.approx(wanted[1])


def test_a_preset_of_ones_own_names_its_units(dlgmd, tmp_path):
    (tmp_path / "own.yaml").write_text("set: 6\nunits: degrees\n")
    write_video(tmp_path / "x.avi", [np.full((30, 700), 8 * k, np.uint8) for k in range(9)])
    assert dlgmd("run", "x.avi", "--config", "own.yaml", "--fov", 60, "--out", "o").exit_code == 0
    assert dlgmd("run", "x.avi", "--set", 6, "--physical", "--fov", 60, "--out", "p").exit_code == 0
    one, other = (read_result(f"{out}/x") for out in "op")
    assert one.record["processed"]["width"] == 700 and np.array_equal(one.mp, other.mp, True)
    assert one.params == other.params == load_set(6, units="degrees")


def test_what_has_no_degrees_says_so(dlgmd):
    with pytest.raises(ParameterError, match="create_model"):
        DLGMD(SET)
    with pytest.raises(ParameterError, match="counts pixels"):
        load_set(9, units="degrees", formulation="released-2021")
    with pytest.raises(FrameError, match="no time"):
        create_model(SET).step(random_images(1)[0])
    with pytest.raises(ParameterError, match="no C version of a model in degrees"):
        dlgmd_cli.export(9, param={"units": "degrees"})
    with pytest.raises(ParameterError, match="a sweep works in px"):
        dlgmd_cli.sweep(x="units=pixels,degrees", y="a=1,2")
    with pytest.raises(ParameterError, match="only the D-LGMD"):
        run("x.mp4", "lgmd", param={"units": "degrees"})
