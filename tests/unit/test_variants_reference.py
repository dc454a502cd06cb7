"""The contrast-relative and the ON/OFF D-LGMD against nested loops in float64."""

from functools import cache

import cv2
import numpy as np
import pytest
from model_checks import check_contrast, check_dlgmd
from reference import clips, slow

from dlgmd_cli.models.contrast import ContrastDLGMD
from dlgmd_cli.models.detection import absolute
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.on_off import OnOffDLGMD
from dlgmd_cli.parameters.presets import (
    ContrastParameters,
    DlgmdParameters,
    OnOffParameters,
    load_config,
    parameters_of,
)

CLIPS = {
    "drifting 9x12": clips.drifting(9, 12, 8, seed=1),
    "looming 10x13": clips.looming(10, 13, 8, seed=2),
    "faint": [np.float32(0.5) + frame / 32 for frame in clips.drifting(8, 9, 8, seed=5)],
    "smaller than the kernel": clips.drifting(4, 1, 6, seed=3),
    "one cell": clips.drifting(1, 1, 6, seed=4),
}
CONNECTIONS = {
    "set 3": {},
    "set 6": {"alpha": -0.1, "beta": 0.5, "lam": 0.7},
    "late": {"alpha": 3.0, "r": 2},
    "no inhibition": {"a": 0.0},
    "wide": {"sigma_e": 2.0, "sigma_i": 5.0, "a": 0.4, "r": 3},
}
THRESHOLDS = [
    {"c_p": 0.0, "p_min": 0.0},
    {"c_p": 0.5, "c_s": 0.02, "s_min": 0.0},
    {"p_min": 0.1, "s_min": 0.1},
    {"w_sigma": 1.0},
    {"w_sigma": 0.01},
    {"c_s": 100.0},
    {"c_n": 0.5, "c_p": 0.0, "p_min": 0.0},
    {"growth": 0.5, "w_m": 1.0},
    {"growth": 1000.0, "sigma_c": 0.2},
]


@pytest.mark.parametrize("clip", CLIPS)
@pytest.mark.parametrize("connections", CONNECTIONS)
def test_contrast_agrees_with_its_equations(clip, connections):
    check_contrast(CLIPS[clip], **CONNECTIONS[connections])


@pytest.mark.parametrize("changes", THRESHOLDS, ids=str)
def test_contrast_with_other_thresholds(changes):
    check_contrast(CLIPS["drifting 9x12"], **changes)
    check_contrast(CLIPS["looming 10x13"], **changes)


def towards_a_still_camera(height, width, rate, fps, *, across=0.0):
    """A square on a still wall; it grows by `rate` a second, and moves `across` cells a second."""
    rng = np.random.default_rng(4)
    ground, skin = (cv2.GaussianBlur(rng.random((99, 99), np.float32), (0, 0), 2) for _ in "ab")
    wall = cv2.resize(ground, (width, height))
    for t in range(fps // 2):
        half = height / 10.0 * (1.0 + rate / fps) ** t
        middle = (0.6 * width + across * t / fps, 0.45 * height)
        grows = cv2.getRotationMatrix2D((0, 0), 0.0, half / 49.0)
        grows[:, 2] = np.subtract(middle, half)
        yield cv2.warpAffine(
            1.0 - skin, grows, (width, height), wall.copy(), borderMode=cv2.BORDER_TRANSPARENT
        )


# A picture that turns by up to 8 cells from frame to frame.
_GROUND = np.kron(clips.drifting(26, 30, 1, seed=7)[0], np.ones((3, 3), np.float32))
TURNING = [
    _GROUND[20 + dy : 44 + dy, 20 + dx : 48 + dx] + frame / 8
    for frame, dy, dx in zip(
        clips.looming(24, 28, 8, seed=6),
        (0, 1, 3, 3, 0, -8, -9, -9),
        (0, 4, 8, 16, 17, 17, 14, 6),
        strict=True,
    )
]
STILL = list(towards_a_still_camera(24, 30, 4.0, 12))
UNEVEN_S = (0.0, 0.02, 0.06, 0.1, 0.15, 0.16, 0.2, 0.3)
QUIET = [
    {"shift": 8},
    {"balance": True},
    {"c_m": 0.7, "tau_m": 0.1},
    {"w_fps": 30.0},
    {"shift": 9, "d_0": 0.3},
    {
        "shift": 9,
        "balance": True,
        "c_m": 0.4,
        "tau_m": 0.2,
        "w_fps": 24.0,
        "d_0": 0.5,
        "k_0": 0.01,
    },
]


@pytest.mark.parametrize(
    ("changes", "times"), [*((one, UNEVEN_S) for one in QUIET), (QUIET[-1], None)], ids=str
)
def test_what_keeps_contrast_quiet_agrees_with_its_equations(changes, times):
    for frames in (CLIPS["looming 10x13"], CLIPS["one cell"], TURNING):
        answers = check_contrast(frames, times=times and times[: len(frames)], **changes)
    if "shift" in changes:
        assert len({one.shift for one in answers}) > 3
    if "d_0" in changes:
        still = check_contrast(STILL, times=times and times[: len(STILL)], **changes)
        assert max(one.beside for one in still) > 0.5 and max(one.rate for one in still) > 0.3
    assert [one.mp for one in answers[2:]] != plain_mp()


@cache
def plain_mp():
    """The potentials of `TURNING` with nothing that keeps them quiet."""
    return [one.mp for one in check_contrast(TURNING)[2:]]


def test_a_camera_that_turns_changes_nothing():
    y, x = np.mgrid[:100, :160].astype(np.float32)
    ground = 0.5 + 0.2 * np.sin(x / 9) + 0.2 * np.sin(y / 7 + x / 23)
    frames = [ground[20:80, 8 * t : 8 * t + 80] for t in range(6)]
    still, follows = (ContrastDLGMD(ContrastParameters(shift=shift)) for shift in (0, 12))
    for t, frame in enumerate(frames):
        moved, followed = still.step(frame), follows.step(frame)
        if t > 0:
            assert moved.p_sum > 200.0 and followed.p_sum == 0.0


def test_the_faster_a_picture_expands_the_higher_is_the_potential_at_any_frame_rate():
    ground = cv2.GaussianBlur(np.random.default_rng(8).random((120, 160), np.float32), (0, 0), 4)
    ground = cv2.normalize(ground, None, 0.0, 1.0, cv2.NORM_MINMAX)
    params = ContrastParameters(shift=16, d_0=0.25, k_0=0.001, s_min=100.0)  # no cell is active
    for rate in (0.0, 0.8, 1.6, -1.6):  # 1/s
        for fps in (15, 30, 60):
            model = ContrastDLGMD(params)
            for t in range(fps // 2):
                grows = cv2.getRotationMatrix2D((80, 60), 0.0, (1.0 + rate / fps) ** t)
                frame = cv2.warpAffine(ground, grows, (160, 120), flags=cv2.INTER_CUBIC)
                answer = model.step(frame, t / fps)
            found = 0.25 * np.sqrt(answer.mp / ground.size / 0.001 + 1.0)
            assert found == pytest.approx(max(rate, 0.25), rel=0.1), (rate, fps)
            if rate > 0.0:
                assert answer.ttc_s == pytest.approx(0.5 / rate, rel=0.1)
            else:
                assert np.isnan(answer.ttc_s)


def test_what_comes_at_a_still_camera_beside_its_middle_has_a_time_to_contact():
    params = parameters_of(load_config("flight"))
    for rate, across in ((3.0, 0.0), (0.0, 120.0)):
        model = ContrastDLGMD(params)
        for t, frame in enumerate(towards_a_still_camera(136, 240, rate, 30, across=across)):
            answer = model.step(frame, t / 30)
        if rate:
            assert answer.ttc_s == pytest.approx(1.0 / rate, rel=0.3)
        else:
            assert not answer.ttc_s < 1.5
        share = answer.mp / frame.size
        assert (absolute(share, 1, params.kappa) >= params.t_mp) == bool(rate)


def test_one_side_alone_raises_no_potential_and_a_hidden_side_does_not_matter():
    noise = np.random.default_rng(2).random((6, 24, 30), np.float32)
    beside = noise.copy()
    beside[:, :, :22] = 0.5
    model = ContrastDLGMD(ContrastParameters(balance=True, growth=1e6, a=0.2))
    assert [model.step(frame).mp for frame in beside][-1] == 0.0
    assert [model.step(frame).mp for frame in noise][-1] > 50.0
    model.reset()
    hidden = np.zeros((24, 30), np.bool_)
    hidden[:, :22] = True
    model.ignore(hidden)
    assert [model.step(frame).mp for frame in beside][-1] > 20.0


def test_what_goes_on_all_the_time_is_no_news():
    noise = np.random.default_rng(3).random((60, 24, 30), np.float32)
    noise[30:50] = noise[29]  # a pause
    model = ContrastDLGMD(ContrastParameters(c_m=2.0, tau_m=0.1, a=0.2, growth=1e6))
    mp = [model.step(frame, t / 30).mp for t, frame in enumerate(noise)]
    assert max(mp[2:50]) == 0.0 and mp[50] > 50.0 and max(mp[55:]) == 0.0


def test_the_clips_reach_every_branch_of_contrast():
    answers = [
        one for frames in CLIPS.values() for one in check_contrast(frames) if one.g is not None
    ]
    floors, thresholds = ({getattr(one, n) for one in answers} for n in ("floor", "t_de"))
    assert min(floors) == 0.01 < max(floors) and min(thresholds) == 0.005 < max(thresholds)
    assert any((one.p == 0).any() and (one.p > 0).any() for one in answers)
    assert any(0 < one.mp < one.g.size and ((one.g == 0) & (one.s > 0)).any() for one in answers)


def test_contrast_of_the_picture_does_not_matter_above_the_least_thresholds():
    # Powers of two: float32 has every product exactly.
    def counts(share):
        model = ContrastDLGMD(ContrastParameters(p_min=0.0, s_min=0.0, c_s=0.1, a=0.5))
        return [model.step(frame * np.float32(share)).mp for frame in CLIPS["looming 10x13"]][2:]

    assert max(counts(1.0)) > 3 and counts(1.0) == counts(0.5) == counts(2.0**-9)


def test_an_alarm_of_contrast_takes_92_cells_of_10000():
    params = ContrastParameters()
    levels = [absolute(share * 1000.0, 1000, params.kappa) for share in (0.00915, 0.00925)]
    assert levels[0] < params.t_mp < levels[1]


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize("number", [3, 4, 9])
@pytest.mark.parametrize("clip", CLIPS)
def test_on_off_agrees_with_its_equations(clip, number, formulation):
    check_dlgmd(CLIPS[clip], slow.table_2(number, formulation=formulation), on_off=True)


def test_on_and_off_do_not_inhibit_each_other():
    frames, both = CLIPS["drifting 9x12"], slow.table_2(3)
    models = OnOffDLGMD(OnOffParameters(**both)), DLGMD(DlgmdParameters(**both))
    brightening = np.maximum.accumulate(frames)
    for t, frame in enumerate(brightening):  # with one pathway at work, it is the D-LGMD
        apart, together = (model.step(frame) for model in models)
        if t >= 2:
            assert apart.s_sum == pytest.approx(together.s_sum, rel=1e-5)
            assert apart.mp == pytest.approx(together.mp, rel=1e-5)
    for model in models:
        model.reset()
    answers = [[model.step(frame, layers=True) for model in models] for frame in frames]
    assert all((a.layers.s >= b.layers.s - 1e-6).all() for a, b in answers[2:])
    assert sum(a.s_sum for a, _ in answers[2:]) > 1.2 * sum(b.s_sum for _, b in answers[2:])
