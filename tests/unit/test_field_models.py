"""The models of the field against the numbers of their public code."""

import pickle

import cv2
import numpy as np
import pytest
from field_answers import BENCHMARK, CASES, check_benchmark

import dlgmd_cli
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.parameters.presets import MODELS, PUBLISHED


@pytest.mark.parametrize("model", CASES)
def test_every_frame_is_the_benchmarks(model):
    """The other stimuli are in the slow tier."""
    check_benchmark(model, "noise_64x48")


def test_cascades_of_the_authors_take_the_frame_before():
    still = np.full((5, 24, 32), 200, np.uint8)
    for name in ("lgmd1-lgmd2", "lgmd2-lgmd1"):
        np.testing.assert_array_equal(dlgmd_cli.run(still, name).k, 0.0)
        assert np.nanmax(dlgmd_cli.run(still, name, param=BENCHMARK).k) > 0.01


def test_algmd_of_the_authors_starts_at_its_third_frame():
    noise = np.random.default_rng(0).integers(0, 256, (4, 24, 32), np.uint8)
    result = dlgmd_cli.run(noise, "algmd")
    first = -65 + 2e-3 / 30 * (0.04 * 65**2 - 5 * 65 + 140)
    np.testing.assert_allclose(result.v[:3], [-65, -65, first], rtol=1e-12)


def responses(model, frames, **values):
    """The responses and the numbers before the sigmoid of a model with these parameters."""
    created = create_model(MODELS[model](**values))
    found = [created.step(frame) for frame in frames]
    return np.array([[one.mp, one.more.get("k", np.nan)] for one in found]).T


def test_a_seed_repeats_a_run_and_a_mask_keeps_its_share():
    frames = np.random.default_rng(1).integers(0, 256, (5, 30, 40), np.uint8)
    first, again, other = (responses("plgmd", frames, seed=seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first[1, 2:] != other[1, 2:]).all()
    model = create_model(MODELS["plgmd"](seed=3))
    for p in (0.0, 0.3, 0.8, 1.0):
        assert model.mask(p, (2000, 2000)).mean() == pytest.approx(p, abs=1e-3)


def test_the_defaults_are_the_authors():
    """What the authors' own codes compute, in NumPy and float64, for two frames of noise."""
    frames = np.random.default_rng(2).integers(0, 256, (3, 24, 30), np.uint8)
    grey = frames.astype(float)
    last = dict.fromkeys((1, -1), np.zeros((24, 30)))
    around = np.array([[0.125, 0.25, 0.125], [0.25, 0, 0.25], [0.125, 0.25, 0.125]])
    centre = np.full((3, 3), -1 / 8)
    centre[1, 1] = 1.0
    expected = []
    for change in np.diff(grey, axis=0):
        kept = {}
        for sign in (1, -1):
            p = np.maximum(sign * change, 0.0)
            m = np.tanh(p / (cv2.GaussianBlur(p, (9, 9), 5) + 3))
            s = m - 0.4 * cv2.filter2D(last[sign], -1, around)
            kept[sign], last[sign] = np.maximum(s - abs(cv2.filter2D(m, -1, centre)), 0), m
        s = kept[1] + kept[-1] + kept[1] * kept[-1]
        ce = cv2.blur(s, (3, 3))
        g = s * ce / (ce.max() / 4 + 0.01)
        expected.append(g[0.5 * g >= 0.7].sum() / g.size)
    np.testing.assert_allclose(responses("mc-lgmd", frames)[1, 1:], expected, rtol=1e-5)
    authors, benchmark = MODELS["plgmd"](), MODELS["plgmd"](**BENCHMARK)
    assert (authors.p1, authors.p2, authors.t_s) == (0.5, 0.5, 100.0)
    assert (benchmark.p1, benchmark.t_s) == (pytest.approx(0.2689414), 30.0)


def test_field_models_say_what_they_are():
    for name in PUBLISHED:
        kind = MODELS[name]
        assert kind.source and kind.rest == 0.5 and kind().kappa is None
        assert kind().t_mp > 0.5 and kind.model == kind.preset == name
        for key, spec in kind.specs().items():
            assert spec.meaning, key


@pytest.mark.parametrize("model", PUBLISHED)
def test_another_process_gets_the_same_parameters(model):
    params = MODELS[model](t_mp=0.7)
    assert pickle.loads(pickle.dumps(params)) == params


def test_a_response_is_normalised_by_a_sequence_too():
    frames = np.random.default_rng(5).integers(0, 256, (8, 24, 32), np.uint8)
    result = dlgmd_cli.run(frames, "mc-lgmd", fps=30, normalise="sequence")
    assert result.threshold == 0.4
    assert np.nanmin(result.level) == 0.0 and np.nanmax(result.level) == 1.0
    assert result.rule.peak_text(0.83) == "normalised MP up to 0.83"
    assert rule_of(result.params).peak_text(0.83) == "MP up to 0.83"
