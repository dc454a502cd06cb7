"""D-LGMDs with other layers: what is overridden acts, and nothing else changes."""

import importlib
import sys
from dataclasses import replace

import numpy as np
import pytest
from conftest import looming_frames, scene
from documents import blocks
from reference import slow

import dlgmd_cli
from dlgmd_cli.errors import FrameError, ModelError, ParameterError
from dlgmd_cli.models.base import Response, create_model
from dlgmd_cli.models.columns import columns_of
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.on_off import OnOffDLGMD
from dlgmd_cli.parameters.keys import OWN_MODELS
from dlgmd_cli.parameters.presets import DlgmdParameters

SUMS = tuple(one.name for one in columns_of(Response))
# What leaves S, G and K to one go, and what takes the plain path.
BEFORE = ("see", "perceive", "latency", "connect", "net", "feed_forward", "threshold")
LATER = ("excite", "inhibit", "combine", "group", "potential")


@pytest.fixture(autouse=True)
def forgotten():
    """Classes of a test are no models afterwards."""
    before = dict(OWN_MODELS)
    yield
    OWN_MODELS.clear()
    OWN_MODELS.update(before)


def identity(names, base=DLGMD):
    """A class whose methods of some layers only call those of the base."""

    def call(name):
        def method(self, *inputs):
            return getattr(super(kind, self), name)(*inputs)

        return method

    kind = type("Identity", (base,), {name: call(name) for name in names})
    return kind


def steps(model, frames, **options):
    return [model.step(frame, **options) for frame in frames]


def check_equal(one, other, rel=1e-5):
    """The same responses and layers; a cell may be on either side of the threshold."""
    assert one[-1].mp > 0.0
    for t, (a, b) in enumerate(zip(one, other, strict=True)):
        for name in SUMS:
            expected = pytest.approx(getattr(a, name), rel=rel, abs=1e-5, nan_ok=True)
            assert getattr(b, name) == expected, f"{name} at {t}"
        for name in ("p", "s", "g"):
            layer, expected = (getattr(each.layers, name) for each in (b, a))
            assert (layer is None) == (expected is None)
            if expected is not None:
                peak = max(1.0, float(expected.max()))
                apart = np.abs(layer - expected) > 2e-5 * peak**2
                assert apart.sum() <= 2


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize("number", [2, 9])
def test_layer_by_layer_is_what_one_go_computes(number, formulation):
    params = DlgmdParameters(**slow.table_2(number, formulation=formulation, a=0.4))
    frames = scene(40, 61)
    fused = steps(DLGMD(params), frames, layers=True)
    check_equal(fused, steps(identity(BEFORE + LATER)(params), frames, layers=True))


# Around the sides of tiles.
@pytest.mark.parametrize("shape", [(40, 481), (271, 30), (270, 480), (1, 600), (600, 1)])
def test_tiles_are_what_the_whole_frame_is(shape):
    params = DlgmdParameters(**slow.table_2(9, a=0.4))
    frames = scene(*shape)
    tiled = steps(DLGMD(params), frames, layers=True)
    check_equal(tiled, steps(identity(BEFORE + LATER)(params), frames, layers=True))


@pytest.mark.parametrize(("base", "dtype"), [(DLGMD, np.uint8), (OnOffDLGMD, np.float32)])
@pytest.mark.parametrize("name", [*BEFORE, *LATER])
def test_one_layer_that_is_the_same_changes_nothing(name, dtype, base):
    params = base.params_class(**slow.table_2(9, a=0.4))
    frames = scene(40, 61, dtype=dtype)
    expected = steps(base(params), frames, layers=True)
    check_equal(expected, steps(identity([name], base)(params), frames, layers=True))


@pytest.mark.parametrize("name", [*BEFORE, *LATER])
def test_a_mask_holds_by_itself(name):
    hidden = np.zeros((40, 61), np.bool_)
    hidden[:15] = hidden[:, 50:] = True
    params, frames = DlgmdParameters(**slow.table_2(9, a=0.4)), scene(40, 61)
    answers = []
    for kind in (DLGMD, identity([name])):
        model = kind(params)
        model.ignore(hidden)
        answers.append(steps(model, frames, layers=True))
    check_equal(*answers)


def test_a_mask_holds_where_a_layer_is_active_everywhere():
    class Bright(DLGMD):
        def see(self, luminance):
            return luminance + 0.1 * self.receptors.frame

        def combine(self, e, i):
            return np.abs(e - i) + 1.0

        def group(self, s, t_de):
            return s + 1.0

    hidden = np.zeros((24, 32), np.bool_)
    hidden[:10] = True
    model = Bright()
    model.ignore(hidden)
    last = steps(model, looming_frames(), layers=True)[-1]
    for layer in (last.layers.p, last.layers.s, last.layers.g):
        assert not layer[:10].any() and (layer[10:] > 0.0).all()


def reaching(delay, **changes):
    """A model whose connections reach some frames back, made in `__init__`."""

    class Reaching(DLGMD):
        def __init__(self, params=None):
            super().__init__(params)
            late = {delay: self.connections.inhibition[1]}
            self.connections = replace(self.connections, inhibition=late)

    return Reaching(DlgmdParameters(**slow.table_2(1, **changes)))


@pytest.mark.parametrize("delay", [0, 1, 2, 3, 7])
def test_the_history_follows_from_the_connections(delay):
    model, frames = reaching(delay, a=0.5, ffi_gd=False), looming_frames(14, 24, 32)
    answers = steps(model, frames)
    assert model.first_valid_frame == 1 + max(delay, 1)
    for t in range(model.first_valid_frame, len(frames)):
        p = {d: np.abs(np.float64(frames[t - d]) - frames[t - d - 1]) / 255 for d in (0, delay)}
        taps = model.connections.signed()
        s = sum(convolved(p[d], kernel) for d, kernel in taps.items() if kernel.any())
        assert answers[t].s_sum == pytest.approx(np.maximum(s, 0.0).sum(), rel=1e-5)


def convolved(image, kernel):
    """Zeros outside; the kernel is symmetric."""
    radius = len(kernel) // 2
    wide, (height, width) = np.pad(image, radius), image.shape
    windows = np.lib.stride_tricks.sliding_window_view(wide, kernel.shape)
    return np.einsum("yxij,ij->yx", windows, kernel).reshape(height, width)


def test_a_longer_history_may_be_asked_for_and_no_more_is_answered():
    class Slow(DLGMD):
        first_valid_frame = 5

        def excite(self, p):
            return p(self.reach)

    model = Slow()
    model.reach = 4
    answers = steps(model, looming_frames(8), layers=True)
    assert [one.is_valid for one in answers] == [False] * 5 + [True] * 3
    for reach, words in ((5, r"P\(t-5\): the last 5 are kept"), (-1, "P")):
        model.reach = reach
        with pytest.raises(ModelError, match=words):
            model.step(looming_frames(8)[0])


def test_p_before_the_first_change_is_an_error():
    receptors = dlgmd_cli.Photoreceptors(3)
    frames = looming_frames(3)
    receptors.take(frames[0])
    with pytest.raises(ModelError, match="not defined before the second frame"):
        receptors.p(0)
    receptors.take(frames[1])
    assert receptors.p(0).shape == frames[0].shape and np.isnan(receptors.p_sum(2))
    with pytest.raises(ModelError, match=r"P\(t-2\): there are only 1 so far"):
        receptors.p(2)
    for ask in (receptors.p, receptors.p_sum):
        with pytest.raises(ModelError, match=r"P\(t-3\)"):
            ask(3)


def test_polarities_are_the_halves_of_the_change():
    class Off(DLGMD):
        polarities = ("off",)

    params = DlgmdParameters(**slow.table_2(3))
    rising = [np.full((9, 12), 20 * t, np.uint8) for t in range(6)]
    off, both = Off(params), DLGMD(params)
    assert steps(off, rising)[-1].p_sum == 0.0 and steps(both, rising)[-1].p_sum > 0.0
    off.reset(), both.reset()
    check = zip(steps(off, rising[::-1]), steps(both, rising[::-1]), strict=True)
    for of_off, of_both in list(check)[2:]:
        np.testing.assert_equal(vars(of_off), vars(of_both))


IMAGE = np.ones((24, 32))


def broken(name, answer):
    """A model with a layer that returns something else."""
    kind = type("Broken", (DLGMD,), {name: lambda self, *_: answer})
    return create_model(kind.params_class())


@pytest.mark.parametrize(
    ("name", "answer", "words"),
    [
        ("see", np.zeros((2, 3)), r"see\(\), frame 0: it returns float64 of shape \(2, 3\), not"),
        ("perceive", 1.0, r"perceive\(\), frame 1: it returns float64 of shape \(\), not float32"),
        ("perceive", (), r"perceive\(\), frame 1: it returns no"),
        ("excite", None, r"excite\(\), frame 3: it returns object of shape \(\)"),
        ("combine", IMAGE * 1j, r"combine\(\), frame 3: it returns complex128"),
        ("combine", IMAGE * np.nan, r"combine\(\), frame 3: some of what it returns is infinite"),
        ("group", IMAGE * np.inf, r"group\(\), frame 3: some .* Look for a division by 0\."),
        ("latency", np.zeros((4, 4)), r"Broken, latency\(\): it returns an array of shape \(4, "),
        ("latency", np.full((13, 13), -0.6), r"latency\(\): some of it is negative"),
    ],
)
def test_what_is_no_layer_is_an_error(name, answer, words):
    with pytest.raises(ModelError, match=words):
        steps(broken(name, answer), looming_frames(6))


def test_connections_that_do_not_fit_are_an_error():
    ours = DLGMD().connections
    with pytest.raises(ModelError, match="not all kernels have the shape of the latency"):
        replace(ours, excitation=np.zeros((3, 3)))
    with pytest.raises(ModelError, match="are not whole numbers of frames"):
        replace(ours, inhibition={1.5: ours.excitation})
    with pytest.raises(ModelError, match=r"shape \(4, 4\), not \(2r \+ 1, 2r \+ 1\)"):
        replace(ours, latency=np.ones((4, 4)))


def test_frames_that_are_none_are_refused_before_a_layer_sees_them():
    model = identity(["see"])()
    with pytest.raises(FrameError, match="is not a float32 or uint8 image"):
        model.step(np.zeros((9, 9)))
    model.step(np.zeros((9, 9), np.uint8))
    with pytest.raises(FrameError, match="but the frames before are"):
        model.step(np.zeros((9, 8), np.uint8))


# The page


@pytest.fixture
def page(tmp_path, monkeypatch):
    """The module that "Change one layer" shows, importable."""
    files = {name: code for _, name, code in blocks("docs/change-one-layer.md")}
    code = files["variants.py"]
    (tmp_path / "variants.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("variants")
    sys.modules.pop("variants")


def test_contrast_normalisation_needs_no_contrast(page):
    frames = scene(60, 81, dtype=np.float32)
    full = steps(page.Contrast(), frames)[-1]
    half = steps(page.Contrast(), [0.5 * frame for frame in frames])[-1]
    usual, fainter = (steps(DLGMD(), each)[-1].p_sum for each in (frames, [f / 2 for f in frames]))
    assert fainter / usual == pytest.approx(0.5) and half.p_sum / full.p_sum > 0.6


def test_the_latency_of_the_page_reaches_back_three_frames(page):
    model = page.Latency(page.Latency.params_class(latency="nearest"))
    assert model.connections.max_delay_frames == 3 and model.first_valid_frame == 4


def test_divisive_inhibition_is_division(page):
    frames, model = scene(40, 61), page.Divisive()
    last = steps(model, frames, layers=True)[-1]
    e, i = (getattr(model, name)(model.receptors.pathways[0]) for name in ("excite", "inhibit"))
    np.testing.assert_allclose(last.layers.s, e / (1 + 10 * i), rtol=1e-6)
    assert 0 in model.connections.inhibition


def test_leaky_grouping_adds_up(page):
    frames = scene(40, 61)
    usual, leaky = (
        create_model(kind(a=0.4)) for kind in (DlgmdParameters, page.Leaky.params_class)
    )
    expected = 0.0
    for a, b in zip(steps(usual, frames), steps(leaky, frames), strict=True):
        expected = 0.5 * expected + (a.mp if a.is_valid else 0.0)
        assert not b.is_valid or b.mp == pytest.approx(expected, rel=1e-5)


def test_a_variant_is_of_the_models_that_have_its_keys(page, dlgmd, runs, clips):
    both = ["compare", clips / "loom.avi", "--set", 9, "--model", "variants:Leaky", "--format=none"]
    runs(*both, "--variant", "fast:leak=0.2")
    compared = dlgmd_cli.read_comparison("dlgmd-out/loom")
    assert list(compared) == ["set9", "Leaky", "Leaky/fast"]
    assert compared["Leaky/fast"].params.leak == 0.2
    refused = dlgmd(*both, "--variant", "fast:leek=0.2", "--overwrite")
    assert refused.exit_code == 2 and "unknown parameter 'leek'" in refused.stderr
    nine, leaky = dlgmd_cli.run(clips / "loom.avi", [9, page.Leaky], param={"leak": 0.2, "r": 4})
    assert (nine.params.r, leaky.params.r, leaky.params.leak) == (4, 4, 0.2)
    with pytest.raises(ParameterError, match="unknown parameter 'leek'"):
        dlgmd_cli.run(clips / "loom.avi", [9, page.Leaky], param={"leek": 0.2})
