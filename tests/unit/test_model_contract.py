"""What every model of the registry keeps to, whatever it computes."""

import dataclasses
import math
import tracemalloc

import cv2
import numpy as np
import pytest
from dlgmd_cli.models.ensemble import Ensemble
from dlgmd_cli.models.replay import Replay
from reference import clips, slow

from dlgmd_cli.errors import FrameError, ParameterError
from dlgmd_cli.models.base import Layers, Response, create_model
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.parameters import MODELS, DlgmdParameters, Parameters

pytestmark = pytest.mark.usefixtures("each_engine")

SUMS = ("p_sum", "s_sum", "mp", "ffi", "t_de")
N_FRAMES = 9

# Exceptions by nature; a model in none of these sets keeps to everything.
SIGNED = {"lgmd", "emd-lgmd"}  # works on signed changes, not on |dL|
DIRECTIONAL = {"emd-lgmd"}  # tells outward from inward motion

CASES = {name: (name, {}) for name in MODELS} | {
    f"dlgmd-set{number}-{formulation}": ("dlgmd", slow.table_2(number, formulation=formulation))
    for number in (2, 4, 7)
    for formulation in slow.FORMULATIONS
}
UNSIGNED_CASES = [case for case, (name, _) in CASES.items() if name not in SIGNED]
EVEN_CASES = [case for case, (name, _) in CASES.items() if name not in DIRECTIONAL]


def create(case):
    name, values = CASES[case]
    return create_model(MODELS[name].parameters.from_mapping(values))


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


def run(case, frames, *, layers=False):
    model = create(case)
    return [model.step(frame, layers=layers) for frame in frames]


def sums(responses):
    return np.array([[getattr(one, name) for name in SUMS] for one in responses])


def assert_close(responses, others, columns=SUMS):
    for name in columns:
        np.testing.assert_allclose(
            [getattr(one, name) for one in responses],
            [getattr(one, name) for one in others],
            rtol=1e-5,
            atol=1e-5,
            err_msg=name,
        )


@pytest.mark.parametrize("case", CASES)
class TestEveryModel:
    def test_knows_its_name(self, case):
        assert create(case).name == CASES[case][0]

    def test_answers_from_its_first_valid_frame_on(self, case):
        model = create(case)
        first = model.first_valid_frame
        assert 1 <= first < N_FRAMES
        responses = [model.step(frame) for frame in moving()]
        assert [one.is_valid for one in responses] == [t >= first for t in range(N_FRAMES)]
        for response in responses[:first]:
            assert math.isnan(response.mp) and math.isnan(response.attenuation_db)
        for response in responses[first:]:
            assert all(math.isfinite(getattr(response, name)) for name in ("p_sum", "s_sum", "mp"))
        assert model.first_valid_frame == first

    def test_answers_to_motion(self, case):
        # Whatever else is asked of the model here means little where it stays silent.
        assert max(one.s_sum for one in run(case, moving()) if one.is_valid) > 1.0

    def test_rests_in_a_still_scene(self, case):
        responses = run(case, moving(n_frames=1) * N_FRAMES)
        valid = [one for one in responses if one.is_valid]
        assert valid
        for response in valid:
            assert response.p_sum == response.s_sum == response.mp == 0.0
            assert math.isnan(response.attenuation_db)

    def test_later_frames_do_not_alter_earlier_rows(self, case):
        frames = moving()
        other = frames[:5] + [1.0 - frame for frame in frames[5:]]
        before, after = (sums(run(case, clip)) for clip in (frames, other))
        np.testing.assert_array_equal(before[:5], after[:5])
        assert (before[5:] != after[5:]).any()

    def test_reset_forgets_everything(self, case):
        model, frames = create(case), moving()
        first = sums([model.step(frame) for frame in frames])
        model.reset()
        np.testing.assert_array_equal(sums([model.step(frame) for frame in frames]), first)
        model.reset()
        smaller = moving(9, 7)
        again = sums([model.step(frame) for frame in smaller])
        np.testing.assert_array_equal(again, sums(run(case, smaller)))

    def test_models_do_not_share_state(self, case):
        frames = moving()
        one, other = create(case), create(case)
        interleaved = []
        for frame in frames:
            interleaved.append(one.step(frame))
            other.step(1.0 - frame[::-1])
        np.testing.assert_array_equal(sums(interleaved), sums(run(case, frames)))

    @pytest.mark.parametrize("dtype", [np.uint8, np.float32])
    def test_sharing_photoreceptors_changes_nothing(self, case, dtype):
        frames = moving() if dtype == np.float32 else levels_of(moving())
        company = [create(name) for name in ("dlgmd-set2-default", "lgmd", "dlgmd")]
        ensemble = Ensemble([company[0], create(case), *company[1:]])
        for _ in range(2):
            shared = [ensemble.step(frame)[1] for frame in frames]
            np.testing.assert_array_equal(sums(shared), sums(run(case, frames)))
            ensemble.reset()

    @pytest.mark.parametrize("dtype", [np.uint8, np.float32])
    def test_a_replay_says_the_same(self, case, dtype):
        frames = moving() if dtype == np.float32 else levels_of(moving())
        stack = np.stack(frames)
        changes = np.zeros_like(stack)
        for t in range(1, len(stack)):
            cv2.absdiff(stack[t], stack[t - 1], dst=changes[t])
        unit = 1.0 if dtype == np.float32 else 1.0 / 255.0
        replay = Replay(stack, changes, [cv2.sumElems(p)[0] * unit for p in changes])
        model = create(case)
        for _ in range(2):
            replay.rewind()
            responses = []
            for _ in range(len(replay)):
                replay.advance()
                responses.append(model.respond(replay, layers=True))
            # Float sums depend on where in memory the images lie, in the last bit.
            tolerance = 1e-6 if dtype == np.float32 else 0.0
            np.testing.assert_allclose(
                sums(responses), sums(run(case, frames)), rtol=tolerance, atol=0.0
            )

    def test_asking_for_layers_changes_no_sum(self, case):
        with_layers = run(case, moving(), layers=True)
        without = run(case, moving())
        np.testing.assert_array_equal(sums(with_layers), sums(without))
        assert all(one.layers is None for one in without)

    def test_layers_are_the_images_behind_the_sums(self, case):
        for response in run(case, moving(), layers=True):
            layers = response.layers
            assert response.is_valid == (layers.s is not None) == (layers.g is not None)
            for layer in (layers.p, layers.s, layers.g):
                assert layer is None or (layer.shape == (24, 30) and layer.dtype == np.float32)
            if response.is_valid:
                total = np.abs(layers.s).sum(dtype=float)
                assert response.s_sum == pytest.approx(total, rel=1e-5, abs=1e-5)

    def test_layers_are_copies(self, case):
        model, frames = create(case), moving()
        responses = [model.step(frame, layers=True) for frame in frames]
        kept = [
            [None if one is None else one.copy() for one in (r.layers.p, r.layers.s, r.layers.g)]
            for r in responses
        ]
        for frame in moving(seed=12):
            model.step(frame, layers=True)
        for response, copies in zip(responses, kept, strict=True):
            layers = (response.layers.p, response.layers.s, response.layers.g)
            for layer, copy in zip(layers, copies, strict=True):
                assert (layer is None) == (copy is None)
                assert layer is None or np.array_equal(layer, copy)

    def test_what_is_done_to_layers_does_not_come_back(self, case):
        model, frames = create(case), moving()
        responses = []
        for frame in frames:
            response = model.step(frame, layers=True)
            responses.append(response)
            for layer in (response.layers.p, response.layers.s, response.layers.g):
                if layer is not None:
                    layer[:] = 7.0
        np.testing.assert_array_equal(sums(responses), sums(run(case, frames)))

    def test_the_caller_may_reuse_its_array(self, case):
        model, frames = create(case), moving()
        buffer, responses = np.empty((24, 30), np.float32), []
        for frame in frames:
            buffer[:] = frame
            responses.append(model.step(buffer))
            buffer[:] = -9.0
        np.testing.assert_array_equal(sums(responses), sums(run(case, frames)))

    def test_the_input_is_left_alone(self, case):
        frames = moving()
        for frame in frames:
            frame.flags.writeable = False
        run(case, frames)
        for frame, original in zip(frames, moving(), strict=True):
            np.testing.assert_array_equal(frame, original)

    def test_any_memory_layout_will_do(self, case):
        frames = moving()
        expected = sums(run(case, frames))
        layouts = {
            "columns first": [np.asfortranarray(frame) for frame in frames],
            "every other pixel": [np.repeat(frame, 2, axis=1)[:, ::2] for frame in frames],
            "upside down": [np.ascontiguousarray(frame[::-1])[::-1] for frame in frames],
        }
        for name, clip in layouts.items():
            np.testing.assert_array_equal(sums(run(case, clip)), expected, err_msg=name)

    @pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (4, 1), (2, 3)])
    def test_frames_may_be_tiny(self, case, shape):
        responses = run(case, moving(*shape), layers=True)
        assert responses[-1].is_valid
        assert responses[-1].layers.s.shape == shape

    @pytest.mark.parametrize(
        ("frame", "shown"),
        [
            (np.zeros((24, 30), np.uint16), "uint16 of shape (24, 30)"),
            (np.zeros((24, 30), np.float64), "float64 of shape (24, 30)"),
            (np.zeros((24, 30), ">f4"), ">f4 of shape (24, 30)"),
            (np.zeros((24, 30, 3), np.float32), "float32 of shape (24, 30, 3)"),
            (np.zeros(24, np.float32), "float32 of shape (24,)"),
            (np.zeros((), np.float32), "float32 of shape ()"),
            (np.zeros((0, 30), np.float32), "float32 of shape (0, 30)"),
            (np.zeros((24, 0), np.float32), "float32 of shape (24, 0)"),
        ],
    )
    def test_what_is_no_luminance_is_refused(self, case, frame, shown):
        with pytest.raises(FrameError) as caught:
            create(case).step(frame)
        assert shown in str(caught.value)
        assert "is not a float32 or uint8 image (H, W)" in str(caught.value)

    def test_grey_levels_stand_for_luminance(self, case):
        levels = levels_of(moving())
        luminance = [level.astype(np.float32) / np.float32(255) for level in levels]
        for one, other in zip(
            run(case, levels, layers=True), run(case, luminance, layers=True), strict=True
        ):
            for name in SUMS:
                assert getattr(one, name) == pytest.approx(
                    getattr(other, name), rel=1e-5, abs=1e-6, nan_ok=True
                )
            for name in ("p", "s", "g"):
                a, b = getattr(one.layers, name), getattr(other.layers, name)
                assert (a is None) == (b is None)
                if a is not None:
                    assert a.dtype == np.float32
                    np.testing.assert_allclose(a, b, rtol=1e-5, atol=2e-6)

    def test_a_change_of_type_is_refused(self, case):
        model = create(case)
        model.step(moving()[0])
        with pytest.raises(FrameError, match=r"type uint8 is not that of .* float32"):
            model.step(np.zeros((24, 30), np.uint8))

    @pytest.mark.parametrize("at", [1, 5])
    def test_a_change_of_size_is_refused(self, case, at):
        model = create(case)
        for frame in moving()[:at]:
            model.step(frame)
        with pytest.raises(FrameError, match=r"shape \(30, 24\) is not that of .* \(24, 30\)"):
            model.step(moving()[0].T)

    def test_a_refused_frame_leaves_no_trace(self, case):
        model, frames = create(case), moving()
        responses = []
        for frame in frames:
            for wrong in (frame.astype(float), np.zeros((24, 30, 3), np.float32)):
                with pytest.raises(FrameError):
                    model.step(wrong)
            responses.append(model.step(frame))
        np.testing.assert_array_equal(sums(responses), sums(run(case, frames)))

    def test_memory_does_not_grow(self, case):
        model, frames = create(case), moving()
        tracemalloc.start()
        try:
            for _ in range(2):
                for frame in frames:
                    model.step(frame)
            before, _ = tracemalloc.get_traced_memory()
            for _ in range(60):
                for frame in frames:
                    model.step(frame)
            after, _ = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        # A single number kept for each of these 540 frames would take four times as much.
        assert after - before < 4096


@pytest.mark.parametrize("case", UNSIGNED_CASES)
class TestModelsOnUnsignedChange:
    def test_summation_is_never_negative(self, case):
        for response in run(case, moving(), layers=True):
            if response.is_valid:
                assert response.layers.s.min() >= 0.0
                assert response.s_sum >= 0.0 and response.mp >= 0.0

    def test_brightness_does_not_matter(self, case):
        dark = [frame * np.float32(0.5) for frame in moving()]
        bright = [frame + np.float32(0.25) for frame in dark]
        np.testing.assert_array_equal(sums(run(case, dark)), sums(run(case, bright)))

    def test_contrast_may_be_reversed(self, case):
        reverse = [np.float32(1.0) - frame for frame in moving()]
        np.testing.assert_array_equal(sums(run(case, moving())), sums(run(case, reverse)))

    def test_comes_to_rest_after_motion(self, case):
        model, frames = create(case), moving()
        for frame in frames:
            model.step(frame)
        after = [model.step(frames[-1]) for _ in range(model.first_valid_frame)]
        assert after[-1].p_sum == after[-1].s_sum == after[-1].mp == 0.0

    def test_membrane_potential_sums_the_grouping_layer(self, case):
        for response in run(case, moving(), layers=True):
            if response.is_valid:
                layers = response.layers
                assert response.mp == pytest.approx(layers.g.sum(dtype=float), rel=1e-5)
                assert response.p_sum == pytest.approx(layers.p.sum(dtype=float), rel=1e-5)


@pytest.mark.parametrize("case", EVEN_CASES)
class TestModelsWithoutDirection:
    # The 4x4 window of the D-LGMD reaches further down and right, so that G of a mirror image is
    # not the mirror image of G. What comes before it is; and rows and columns may be exchanged.

    @pytest.mark.parametrize("axis", [0, 1])
    def test_mirror_images_agree_up_to_summation(self, case, axis):
        frames = moving()
        straight = run(case, frames, layers=True)
        mirrored = run(case, [np.flip(frame, axis) for frame in frames], layers=True)
        assert_close(straight, mirrored, ("p_sum", "s_sum", "ffi", "t_de"))
        for one, other in zip(straight, mirrored, strict=True):
            if one.is_valid:
                np.testing.assert_allclose(
                    one.layers.s, np.flip(other.layers.s, axis), rtol=1e-5, atol=1e-6
                )

    def test_rows_and_columns_may_be_exchanged(self, case):
        frames = moving()
        straight = run(case, frames, layers=True)
        transposed = run(case, [frame.T for frame in frames], layers=True)
        assert_close(straight, transposed)
        for one, other in zip(straight, transposed, strict=True):
            if one.is_valid:
                np.testing.assert_allclose(one.layers.g, other.layers.g.T, rtol=1e-5, atol=1e-5)


def test_a_half_turn_keeps_the_potential_without_threshold():
    # Σ S(i) S(i+o) over the window's offsets o is Σ S(i) S(i-o): only T_de and the cap at 1 tell.
    frames = moving()
    model = DLGMD(DlgmdParameters(**slow.table_2(4, formulation="equations", ffi_gd=False)))
    straight = [model.step(frame) for frame in frames]
    model.reset()
    assert_close(straight, [model.step(frame[::-1, ::-1]) for frame in frames])
    assert max(one.mp for one in straight if one.is_valid) > 1.0


@pytest.mark.parametrize("number", sorted(slow.TABLE_2))
@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
def test_warm_up_of_the_dlgmd(formulation, number):
    model = DLGMD(DlgmdParameters(**slow.table_2(number, formulation=formulation)))
    expected = 2 if number <= 3 and formulation != "released" else 3
    assert model.first_valid_frame == expected
    responses = [model.step(frame) for frame in moving()]
    for t, response in enumerate(responses):
        assert math.isnan(response.p_sum) == (t == 0)
        for name in ("s_sum", "mp", "ffi", "t_de"):
            assert math.isnan(getattr(response, name)) == (t < expected)


@pytest.mark.parametrize(
    ("changes", "formulation", "expected"),
    [
        # No inhibition is late here, and yet FFI looks back.
        ({"alpha": -0.3, "beta": 0.9, "lam": 0.05}, "default", 2),
        ({"alpha": -0.3, "beta": 0.9, "lam": 0.05}, "released", 3),
        ({"alpha": 3.0}, "default", 3),
        ({"alpha": 3.0}, "equations", 6),  # τ up to 4.9
        ({"alpha": 10.0, "beta": 1.0, "lam": 0.0}, "equations", 12),  # τ = 10.5
        ({"alpha": 0.0, "beta": 0.0, "lam": 0.0, "a": 0.0}, "equations", 2),
    ],
)
def test_warm_up_follows_the_latency(changes, formulation, expected):
    model = DLGMD(DlgmdParameters(**slow.table_2(4, formulation=formulation) | changes))
    assert model.first_valid_frame == expected
    valid = [model.step(frame).is_valid for frame in moving(n_frames=15)]
    assert valid == [t >= expected for t in range(15)]


def test_the_default_model_is_set_9():
    model = DLGMD()
    assert model.params == DlgmdParameters(**slow.table_2(9))


def test_every_model_has_parameters():
    assert list(MODELS) == list(MODELS)


def test_parameters_of_no_model_are_refused():
    with pytest.raises(ParameterError, match=r"^no model takes Parameters\.$"):
        create_model(Parameters.__new__(Parameters))


@pytest.mark.parametrize(
    ("p_sum", "s_sum", "attenuation_db"),
    [
        (10.0, 1.0, -10.0),
        (2.0, 2.0, 0.0),
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


def test_responses_and_layers_are_frozen():
    for frozen, name in ((Response(1.0, 1.0, 1.0, 1.0, 1.0), "mp"), (Layers(), "s")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(frozen, name, 2.0)
