"""What every model of the registry keeps to, whatever it computes."""

import math
from functools import lru_cache

import numpy as np
import pytest
from reference import clips, slow

from dlgmd_cli.errors import FrameError, ParameterError
from dlgmd_cli.models.base import Response, create_model
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.parameters.presets import MODELS, PUBLISHED, DlgmdParameters, Parameters

SUMS = ("p_sum", "s_sum", "mp", "ffi", "t_de")
N_FRAMES = 9

# Exceptions by nature; a model in none of these sets keeps to everything.
SIGNED = {"lgmd", "emd-lgmd", *PUBLISHED}  # works on signed changes, not on |dL|
# What a cell gets depends on where the frame ends: looks towards the centre, mirrors the frame at
# its border, draws a number for each cell of the frame, or sees no motion in the last row.
CENTRED = {"emd-lgmd", "mc-lgmd", "plgmd", "emd-lplc2"}
SILENT = {"lgmd"}  # nothing of the small disc reaches its threshold

CASES = {name: (name, {}) for name in MODELS} | {
    f"dlgmd-set{number}-{formulation}": ("dlgmd", slow.table_2(number, formulation=formulation))
    for number, formulation in [(4, "released-2021"), (7, "equations")]
}
UNSIGNED_CASES = [case for case, (name, _) in CASES.items() if name not in SIGNED]


def create(case):
    name, values = CASES[case]
    return create_model(MODELS[name].from_mapping(values))


@lru_cache(maxsize=8)
def moving(height=24, width=30, n_frames=N_FRAMES, seed=11):
    """A disc that looms and recedes over a drifting texture.

    Float32 holds every value, difference and complement of it exactly.
    """
    near = clips.looming(height, width, n_frames // 2 + 1, seed, grid=256)
    disc = near + near[-2::-1]
    ground = clips.drifting(height, width, n_frames, seed, grid=256)
    return [(15 * a + b) / np.float32(16) for a, b in zip(disc, ground, strict=False)]


def levels_of(frames):
    return [np.rint(frame * 255).astype(np.uint8) for frame in frames]


def steps(model, frames, *, layers=False):
    return [model.step(frame, layers=layers) for frame in frames]


def run(case, frames, *, layers=False):
    return steps(create(case), frames, layers=layers)


def sums(responses):
    return np.array([[getattr(one, name) for name in SUMS] for one in responses])


def images(response):
    return [response.layers.p, response.layers.s, response.layers.g]


def assert_same(responses, others):
    np.testing.assert_array_equal(sums(responses), sums(others))


def assert_close(responses, others):
    np.testing.assert_allclose(sums(responses), sums(others), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("case", CASES)
class TestEveryModel:
    def test_says_what_it_is(self, case):
        model = create(case)
        assert model.name == CASES[case][0] == model.params.model
        assert len(model.layer_units) == 3

    def test_answers_from_its_first_valid_frame_on(self, case):
        first = create(case).first_valid_frame
        responses = run(case, moving())
        assert 0 <= first < N_FRAMES
        assert [one.is_valid for one in responses] == [t >= first for t in range(N_FRAMES)]
        for response in responses[:first]:
            assert math.isnan(response.mp) and math.isnan(response.attenuation_db)
        assert np.isfinite(sums(responses)[first:, :3]).all()
        # Whatever else is asked of the model here means little where it stays silent.
        assert max(one.s_sum for one in responses[first:]) > 1.0

    def test_rests_in_a_still_scene(self, case):
        valid = [one for one in run(case, moving(n_frames=1) * N_FRAMES) if one.is_valid]
        assert valid
        for response in valid:
            assert response.p_sum == response.s_sum == 0.0
            assert response.mp == (create(case).params.rest or 0.0)
            assert math.isnan(response.attenuation_db)

    def test_later_frames_do_not_alter_earlier_rows(self, case):
        frames = moving()
        other = frames[:5] + [1.0 - frame for frame in frames[5:]]
        before, after = (sums(run(case, clip)) for clip in (frames, other))
        np.testing.assert_array_equal(before[:5], after[:5])
        assert (before[5:] != after[5:]).any()

    def test_reset_forgets_everything(self, case):
        model, frames, smaller = create(case), moving(), moving(9, 7)
        expected = run(case, frames)
        for clip, answers in ((frames, expected), (smaller, run(case, smaller))):
            assert_same(steps(model, clip), answers)
            model.reset()
        assert_same(steps(model, frames[:4]), expected[:4])

    def test_models_do_not_share_state(self, case):
        frames = moving()
        one, other = create(case), create(case)
        interleaved = [(one.step(frame), other.step(1.0 - frame[::-1]))[0] for frame in frames]
        assert_same(interleaved, run(case, frames))

    def test_the_time_is_optional(self, case):
        model, frames = create(case), moving()
        assert_close([model.step(f, t / 30) for t, f in enumerate(frames)], run(case, frames))

    def test_layers_are_the_images_behind_the_sums(self, case):
        responses, without = run(case, moving(), layers=True), run(case, moving())
        assert_same(responses, without)
        assert all(one.layers is None for one in without)
        for response in responses:
            p, s, g = images(response)
            assert response.is_valid == (s is not None) == (g is not None)
            for layer in (p, s, g):
                assert layer is None or (layer.shape == (24, 30) and layer.dtype == np.float32)
            if response.is_valid:
                total = np.abs(s).sum(dtype=float)
                assert response.s_sum == pytest.approx(total, rel=1e-5, abs=1e-5)

    def test_the_centroid_is_that_of_g(self, case):
        frames = moving()
        n_active = 0
        for response in run(case, [frame[:, :22] for frame in frames], layers=True):
            g = response.layers.g
            if g is None or not g.any():
                assert math.isnan(response.g_x) and math.isnan(response.g_y)
                continue
            n_active += 1
            rows, columns = (np.arange(side) for side in g.shape)
            x = (g * ((2 * columns + 1) / g.shape[1] - 1)).sum(dtype=float) / g.sum(dtype=float)
            y = (g * ((2 * rows + 1) / g.shape[0] - 1)[:, None]).sum(dtype=float) / g.sum(
                dtype=float
            )
            assert (response.g_x, response.g_y) == pytest.approx((x, y), abs=1e-5)
            assert abs(x) > 1e-3 and abs(y) > 1e-3  # neither the centre nor the other axis' place
        assert n_active or case in SILENT

    def test_layers_are_copies(self, case):
        model, frames = create(case), moving()
        expected = run(case, frames, layers=True)
        for frame, answer in zip(frames, expected, strict=True):
            response = model.step(frame, layers=True)
            assert_same([response], [answer])
            for layer, before in zip(images(response), images(answer), strict=True):
                if layer is not None:
                    np.testing.assert_array_equal(layer, before)
                    layer[:] = 7.0

    def test_the_caller_may_reuse_its_array(self, case):
        model, frames = create(case), moving()
        buffer, responses = np.empty((24, 30), np.float32), []
        for frame in frames:
            buffer[:] = frame
            responses.append(model.step(buffer))
            buffer[:] = -9.0
        assert_same(responses, run(case, frames))

    def test_any_memory_layout_will_do_and_the_input_is_left_alone(self, case):
        frames = moving()
        expected = run(case, frames)
        layouts = {
            "read only": [frame.copy() for frame in frames],
            "columns first": [np.asfortranarray(frame) for frame in frames],
            "every other pixel": [np.repeat(frame, 2, axis=1)[:, ::2] for frame in frames],
            "upside down": [np.ascontiguousarray(frame[::-1])[::-1] for frame in frames],
        }
        for frame in layouts["read only"]:
            frame.flags.writeable = False
        for clip in layouts.values():
            assert_same(run(case, clip), expected)

    def test_what_ignored_cells_show_makes_no_difference(self, case):
        hidden = np.zeros((24, 30), np.bool_)
        hidden[:7], hidden[12:17, 4:19], hidden[20, 20] = True, True, True
        noise, frames = np.random.default_rng(3), moving()
        other = [np.where(hidden, noise.random((24, 30), np.float32), one) for one in frames]
        answers = []
        for clip in (frames, other):
            model = create(case)
            model.ignore(hidden)
            answers.append(steps(model, clip[:2]))
            model.reset()  # which does not end it
            answers[-1] += steps(model, clip, layers=True)
        assert_same(*answers)
        assert model.n_cells == np.count_nonzero(~hidden)
        assert all((layer[hidden] == 0.0).all() for layer in images(answers[1][-1]))
        assert max(one.s_sum for one in answers[1] if one.is_valid) > 1.0
        model.ignore(None)
        model.reset()
        assert_same(steps(model, frames), run(case, frames))
        model.ignore(hidden[:5])
        with pytest.raises(FrameError, match=r"ignore are \(5, 30\), the frame is \(24, 30\)"):
            model.step(frames[0])

    @pytest.mark.parametrize("shape", [(1, 1), (2, 3)])
    def test_frames_may_be_tiny(self, case, shape):
        last = run(case, moving(*shape), layers=True)[-1]
        assert last.is_valid and last.layers.s.shape == shape

    def test_what_is_no_luminance_is_refused_without_a_trace(self, case):
        model, frames, responses = create(case), moving(), []
        wrong = [
            (
                np.zeros((24, 30), np.uint16),
                r"uint16 of shape \(24, 30\) is not a float32 or uint8",
            ),
            (np.zeros((24, 30), np.float64), r"float64 of shape \(24, 30\) is not"),
            (np.zeros((24, 30), ">f4"), r">f4 of shape \(24, 30\) is not"),
            (np.zeros((24, 30, 3), np.float32), r"float32 of shape \(24, 30, 3\) is not"),
            (np.zeros((), np.float32), r"float32 of shape \(\) is not"),
            (np.zeros((0, 30), np.float32), r"float32 of shape \(0, 30\) is not"),
        ]
        later = [
            (np.zeros((24, 30), np.uint8), r"uint8 .* frames before are float32"),
            (frames[0].T, r"shape \(30, 24\), but .* \(24, 30\)"),
        ]
        for t, frame in enumerate(frames):
            for one, why in wrong + (later if t else []):
                with pytest.raises(FrameError, match=why):
                    model.step(one)
            responses.append(model.step(frame))
        assert_same(responses, run(case, frames))

    def test_grey_levels_stand_for_luminance(self, case):
        levels = levels_of(moving())
        luminance = [level.astype(np.float32) / np.float32(255) for level in levels]
        ours, others = (run(case, clip, layers=True) for clip in (levels, luminance))
        assert_close(ours, others)
        for one, other in zip(ours, others, strict=True):
            for a, b in zip(images(one), images(other), strict=True):
                assert (a is None) == (b is None)
                if a is not None:
                    assert a.dtype == np.float32
                    rounding = 2e-5 if case in PUBLISHED else 2e-6  # of grey levels, or luminance
                    np.testing.assert_allclose(a, b, rtol=1e-5, atol=rounding)


@pytest.mark.parametrize("case", UNSIGNED_CASES)
class TestModelsOnUnsignedChange:
    def test_layers_are_never_negative_and_their_sums_are_what_is_said(self, case):
        for response in run(case, moving(), layers=True):
            if response.is_valid:
                p, s, g = images(response)
                assert s.min() >= 0.0 and g.min() >= 0.0
                assert response.mp == pytest.approx(g.sum(dtype=float), rel=1e-5)
                assert response.p_sum == pytest.approx(p.sum(dtype=float), rel=1e-5)

    def test_comes_to_rest_after_motion(self, case):
        model, frames = create(case), moving()
        steps(model, frames)
        last = steps(model, [frames[-1]] * model.first_valid_frame)[-1]
        assert last.p_sum == last.s_sum == last.mp == 0.0


@pytest.mark.parametrize(
    ("number", "formulation", "changes", "expected"),
    [
        *((number, "default", {}, 2 if number <= 3 else 3) for number in sorted(slow.TABLE_2)),
        (1, "released-2021", {}, 3),
        (9, "released-2021", {}, 3),
        (1, "equations", {}, 2),
        (9, "equations", {}, 3),
        # No inhibition is late here, and yet FFI looks back.
        (4, "default", {"alpha": -0.3, "beta": 0.9, "lam": 0.05}, 2),
        (4, "released-2021", {"alpha": -0.3, "beta": 0.9, "lam": 0.05}, 3),
        (4, "default", {"alpha": 3.0}, 3),
        (4, "equations", {"alpha": 3.0}, 6),  # τ up to 4.9
        (4, "equations", {"alpha": 10.0, "beta": 1.0, "lam": 0.0}, 12),  # τ = 10.5
        (4, "equations", {"alpha": 0.0, "beta": 0.0, "lam": 0.0, "a": 0.0}, 2),
    ],
)
def test_warm_up_follows_the_latency(number, formulation, changes, expected):
    model = DLGMD(DlgmdParameters(**slow.table_2(number, formulation=formulation) | changes))
    assert model.first_valid_frame == expected
    undefined = np.isnan(sums(steps(model, moving(n_frames=15))))
    assert undefined[:, 0].tolist() == [t == 0 for t in range(15)]
    for column in undefined.T[1:]:
        assert column.tolist() == [t < expected for t in range(15)]


def test_the_default_model_is_set_9():
    assert DLGMD().params == DlgmdParameters(**slow.table_2(9))


def test_parameters_of_no_model_are_refused():
    with pytest.raises(ParameterError, match=r"^no model takes Parameters\.$"):
        create_model(Parameters.__new__(Parameters))


@pytest.mark.parametrize(
    ("p_sum", "s_sum", "attenuation_db"),
    [
        (10.0, 1.0, -10.0),
        (1.0, 100.0, 20.0),
        (5.0, 0.0, -math.inf),
        (0.0, 0.0, math.nan),
        (5.0, math.nan, math.nan),
        (math.nan, math.nan, math.nan),
    ],
)
def test_attenuation(p_sum, s_sum, attenuation_db):
    response = Response(p_sum, s_sum, 0.0, 0.0, 0.0)
    assert response.attenuation_db == pytest.approx(attenuation_db, abs=1e-12, nan_ok=True)


@pytest.mark.parametrize("case", [case for case in CASES if case not in CENTRED])
def test_an_ignored_border_is_as_if_cut_off(case):
    hidden, levels = np.ones((24, 30), np.bool_), levels_of(moving())
    inside = np.s_[3:21, 4:28]
    hidden[inside] = False
    model = create(case)
    model.ignore(hidden)
    answers, expected = steps(model, levels), run(case, [one[inside].copy() for one in levels])
    for name in SUMS:
        values, others = ([getattr(one, name) for one in all_] for all_ in (answers, expected))
        np.testing.assert_allclose(values, others, rtol=1e-5, atol=1e-5)
