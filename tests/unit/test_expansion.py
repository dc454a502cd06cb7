"""The expansion rate, its quality and the time to contact, on images of known rate."""

import math

import cv2
import numpy as np
import pytest
from looming import approach
from reference import slow_growth

from dlgmd_cli import Alarm
from dlgmd_cli.frame import small_wh
from dlgmd_cli.models import growth
from dlgmd_cli.models.approach import NOTHING, approaching
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.expansion import LEAST_S, N_AHEAD, Expansion, too_small
from dlgmd_cli.models.rules import LEAST_QUALITY, rule_of
from dlgmd_cli.models.windows import USUAL_FOV_DEG
from dlgmd_cli.parameters.presets import load_config, parameters_of

SIZE_WH = (160, 90)
RULE = rule_of(parameters_of(load_config("flight")))
# Where the fit and the mean have tuned numbers, the slow reference takes the same ones.
FIT = {
    "n_steps": growth.N_STEPS,
    "residuals": growth.RESIDUALS,
    "least_px": growth.LEAST_PX,
    "overlap": growth.OVERLAP,
}


def measured(frames, times=None, **options):
    """What the expansion of each frame is."""
    expansion = Expansion(**options)
    times = [None] * len(frames) if times is None else times
    return [expansion.step(frame, time_s) for frame, time_s in zip(frames, times, strict=True)]


def at_rate(frames, fps):
    """What is measured at the last of the frames, which come `fps` times a second."""
    return measured(frames, [t / fps for t in range(len(frames))])[-1]


def compared(one):
    """What the default rule compares with its threshold."""
    return RULE.value(Detection(**vars(one)))


def noisy(frames, sigma, seed=1):
    """Frames with independent noise of `sigma` grey levels."""
    rng = np.random.default_rng(seed)
    return [np.uint8(np.clip(one + rng.normal(0.0, sigma, one.shape), 0, 255)) for one in frames]


def panned(px, n_frames=20, exposure=1.0):
    """A camera that yaws by `px` a frame, with the blur of an exposure of so many frames."""
    wall = cv2.GaussianBlur(
        np.random.default_rng(3).random((90, 160 + px * (n_frames + 1)), np.float32), (0, 0), 2
    )
    wall = cv2.normalize(wall, None, 40, 215, cv2.NORM_MINMAX)
    blurred = cv2.blur(wall, (max(1, round(px * exposure)), 1))
    return [np.uint8(blurred[:, px * t : px * t + 160]) for t in range(n_frames)]


def towards_a_still_camera(height, width, rate, fps, *, across=0.0, at=0.6, sway_px=0.0):
    """A square on a still wall; it grows by `rate` a second, and moves `across` cells a second.

    The camera sways: each image is shifted by up to `sway_px`, and turned a little.
    """
    rng = np.random.default_rng(4)
    ground, skin = (cv2.GaussianBlur(rng.random((99, 99), np.float32), (0, 0), 2) for _ in "ab")
    wall = cv2.resize(ground, (width, height))
    for t in range(fps // 2):
        half = height / 10.0 * (1.0 + rate / fps) ** t
        middle = (at * width + across * t / fps, 0.45 * height)
        grows = cv2.getRotationMatrix2D((0, 0), 0.0, half / 49.0)
        grows[:, 2] = np.subtract(middle, half)
        seen = cv2.warpAffine(
            1.0 - skin, grows, (width, height), wall.copy(), borderMode=cv2.BORDER_TRANSPARENT
        )
        if sway_px:
            phase = 2.0 * math.pi * 3.0 * t / fps
            sways = cv2.getRotationMatrix2D((width / 2, height / 2), 0.3 * math.sin(phase), 1.0)
            sways[:, 2] += sway_px * math.sin(phase + 1.0), sway_px * math.cos(phase)
            seen = cv2.warpAffine(seen, sways, (width, height), borderMode=cv2.BORDER_REFLECT)
        yield seen


@pytest.mark.parametrize("n_outliers", [0, 8])
def test_the_fit_is_that_of_its_definition(n_outliers):
    """A shift, a growth and a turn, with errors of 0.1 px; outliers keep little weight."""
    rng = np.random.default_rng(7)
    points = growth.grid((60.0, 20.0, 110.0, 70.0), 7)
    z = points[:, 0] + 1j * points[:, 1]
    there = z + (1.5 - 0.7j) + (0.03 + 0.01j) * (z - z.mean())
    there += rng.normal(0.0, 0.1, z.size) + 1j * rng.normal(0.0, 0.1, z.size)
    there[:n_outliers] += rng.uniform(3.0, 6.0, n_outliers)
    there = np.stack([there.real, there.imag], axis=1).astype(np.float32)
    fit = growth.similarity(points, there)
    # float32 places, of about 100 px.
    *right, weights = slow_growth.fitted(points, there, **FIT)
    found = fit.slope.real, fit.error, fit.shift.real, fit.shift.imag
    assert found == pytest.approx(right, rel=1e-4)
    assert fit.weight == pytest.approx(weights, rel=1e-3)
    grown = growth.upright(points, there, fit.weight)
    assert grown == pytest.approx(slow_growth.upright(points, there, weights), rel=1e-3)
    assert fit.slope == pytest.approx(0.03 + 0.01j, abs=0.01)
    assert fit.shift == pytest.approx(1.5 - 0.7j, abs=0.15)


def test_points_that_do_not_come_back_are_left_out():
    """The right half of the later image is another scene; all points are told apart."""
    before, other = (approach(1, 30, 1.0, (240, 135), seed=seed)[0] for seed in (5, 6))
    now = np.roll(before, (1, 3), axis=(0, 1))
    now[:, 120:] = other[:, 120:]
    points = growth.grid((40.0, 30.0, 200.0, 105.0), 10)
    there, found, _ = growth.tracked(before, now, points)
    left = points[:, 0] < 100
    assert found[left].mean() > 0.9 and found[points[:, 0] > 140].mean() < 0.2
    np.testing.assert_allclose(
        (there - points)[left & found], [[3.0, 1.0]] * (left & found).sum(), atol=0.1
    )
    few = growth.growth(before, now, points[:5])
    assert few == growth.Growth() and not len(growth.visible(points + 500.0, before.shape))


@pytest.mark.parametrize("fps", [75.0, 30.0, 8.0])
def test_the_expansion_is_that_of_its_definition(fps):
    """Window, points, pairs of images and mean; only the tracking is the same code."""
    frames = noisy(approach(12, fps, 2.0 + 12 / fps, SIZE_WH), 3.0)
    rng = np.random.default_rng(2)
    times = np.cumsum(rng.uniform(0.8, 1.2, len(frames)) / fps)
    edges = slow_growth.window(*SIZE_WH, USUAL_FOV_DEG, 0.0, 0.0)
    points = np.float32(slow_growth.places(edges, N_AHEAD))
    rates, upright, errors = [], [], []
    for n in range(1, len(frames)):
        m = max([k for k in range(n) if times[n] - times[k] >= LEAST_S], default=0)
        there, found, _ = growth.tracked(frames[m], frames[n], points)
        rate, error, *_, weights = slow_growth.fitted(points[found], there[found], **FIT)
        grown = slow_growth.upright(points[found], there[found], weights)
        rates.append(rate / (times[n] - times[m]))
        upright.append(grown / (times[n] - times[m]))
        errors.append(error / (times[n] - times[m]))
    first, *answers = measured(frames, times.tolist())
    assert math.isnan(first.expansion) and math.isnan(first.expansion_quality)
    for n, one in enumerate(answers, 1):
        intervals = np.diff(times)[:n].tolist()
        expected = slow_growth.mean_of(rates[:n], errors[:n], intervals)
        standing, _ = slow_growth.mean_of(upright[:n], errors[:n], intervals)
        # Both differ by the rounding of float32 places, of the order of 1e-5 px.
        assert (one.expansion, one.expansion_quality) == pytest.approx(expected, abs=1e-3)
        assert one.expansion_upright == pytest.approx(standing, abs=2e-3)


@pytest.mark.parametrize("fps", [30, 10])
def test_a_plane_has_its_true_rate_at_any_rate_of_frames(fps):
    """From 1.5 to 0.9 s before contact; the mean may lag by its time constant."""
    frames = noisy(approach(round(1.6 * fps) + 1, fps, 2.5, (240, 135)), 2.0)
    times = np.arange(len(frames)) / fps
    answers = measured(frames, times.tolist())
    share = np.array([one.expansion for one in answers]) * (2.5 - times)
    late = times >= 1.0
    assert np.abs(share[late] - 1.0).max() < 0.15
    assert all(one.expansion_quality > 0.5 for one in answers[len(answers) // 2 :])
    ttc_s = np.array([one.ttc_s for one in answers])
    assert np.abs(ttc_s[late] / (2.5 - times[late]) - 1.0).max() < 0.1
    still = at_rate(noisy(frames[-1:] * 20, 2.0), fps)
    assert abs(still.expansion) < 0.05 and still.expansion_quality > 0.5 and math.isnan(still.ttc_s)


def over_ground(n_frames, fps, *, down_deg, speed_m_s=2.0, height_m=1.5, focal=143.0):
    """A level flight over textured ground, seen by a camera that looks down by an angle."""
    grain = np.random.default_rng(8).random((700, 500), np.float32)
    ground = cv2.normalize(cv2.GaussianBlur(grain, (0, 0), 3), None, 20, 235, cv2.NORM_MINMAX)
    sine, cosine, px_m = math.sin(math.radians(down_deg)), math.cos(math.radians(down_deg)), 0.02
    to_image = np.array([[focal, 0.0, 119.5], [0.0, focal, 67.0], [0.0, 0.0, 1.0]])
    frames = []
    for t in range(n_frames):
        near_m = 1.5 - speed_m_s * t / fps
        seen = [
            [px_m, 0.0, -250.0 * px_m],
            [0.0, -px_m * sine, height_m * cosine - near_m * sine],
            [0.0, px_m * cosine, height_m * sine + near_m * cosine],
        ]
        warped = cv2.warpPerspective(ground, to_image @ seen, (240, 135), borderValue=128)
        frames.append(np.uint8(warped))
    return frames


@pytest.mark.parametrize("down_deg", [15.0, 25.0])
def test_ground_grows_twice_as_fast_down_as_across_and_raises_no_alarm(down_deg):
    """As while a drone tilts to accelerate; a wall at the same rate raises one."""
    frames = over_ground(15, 30, down_deg=down_deg)
    one = at_rate(frames, 30)
    assert one.expansion > RULE.threshold and one.expansion_quality > LEAST_QUALITY
    assert abs(one.expansion_upright) < 0.2 * one.expansion
    assert compared(one) < 0.5 * RULE.threshold
    alarm = Alarm(times="capture")
    answers = [alarm.step(frame, t / 30) for t, frame in enumerate(frames)]
    assert not any(answer.alarm for answer in answers)
    assert answers[-1].expansion == one.expansion
    wall = at_rate(approach(15, 30, 2.0, (240, 135)), 30)
    assert RULE.threshold < compared(wall) == pytest.approx(wall.expansion, rel=0.1)


def test_the_rate_is_that_of_a_scene_that_also_moves():
    """A growth about another point is a growth and a shift."""
    shown = approach(20, 30, 1.5, (240, 135))
    moved = [
        cv2.warpAffine(one, np.float32([[1, 0, 2 * t], [0, 1, -t]]), (240, 135), borderMode=2)
        for t, one in enumerate(shown)
    ]
    expected, found = at_rate(shown, 30), at_rate(moved, 30)
    assert found.expansion == pytest.approx(expected.expansion, rel=0.1)


@pytest.mark.parametrize(
    ("name", "frames"),
    [
        ("a blank wall", noisy([np.full((90, 160), 120.0)] * 20, 2.0)),
        ("a wall of one grey level", [np.full((90, 160), 120, np.uint8)] * 20),
        ("a dark image", noisy([0.02 * one for one in approach(20, 30, 1.5, SIZE_WH)], 1.5)),
        ("a fast yaw", noisy(panned(60), 2.0)),
        ("other images each time", list(np.random.default_rng(1).integers(0, 256, (20, 90, 160)))),
    ],
)
def test_what_cannot_be_measured_has_a_low_quality(name, frames):
    frames = [np.uint8(frame) for frame in frames]
    *_, one = every = measured(frames, [t / 30 for t in range(len(frames))])
    assert one.expansion_quality < LEAST_QUALITY and math.isnan(one.ttc_s), name
    assert not any(compared(one) >= RULE.threshold for one in every)


def test_quality_falls_with_noise_and_in_a_gap():
    clean = approach(20, 30, 1.5, SIZE_WH)
    qualities = [at_rate(noisy(clean, sigma), 30).expansion_quality for sigma in (0, 8, 50)]
    assert qualities == sorted(qualities, reverse=True) and qualities[0] > 0.8 > qualities[-1] + 0.7
    # Half a second without texture: earlier rates are four time constants old.
    blind = measured([*clean, *[np.full_like(clean[0], 9)] * 15], [t / 30 for t in range(35)])
    later = [one.expansion_quality for one in blind[20:]]
    assert later == sorted(later, reverse=True) and later[-1] < 0.05


def test_earlier_frames_do_not_depend_on_later_ones_and_a_reset_forgets_all():
    frames, times = noisy(approach(20, 30, 1.5, SIZE_WH), 2.0), [t / 30 for t in range(20)]
    whole = measured(frames, times)
    np.testing.assert_array_equal(measured(frames[:12], times[:12]), whole[:12])
    expansion = Expansion()
    for _ in "ab":
        again = [expansion.step(one, time_s) for one, time_s in zip(frames, times, strict=True)]
        np.testing.assert_array_equal(again, whole)
        expansion.reset()


def test_levels_and_luminance_give_the_same_rate():
    still = list(towards_a_still_camera(68, 120, 4.0, 24))
    for frames in (still, [one / np.float32(255) for one in approach(12, 30, 1.5, (120, 68))]):
        levels = [np.rint(255 * frame).astype(np.uint8) for frame in frames]
        luminance = [np.float32(frame / np.float32(255)) for frame in levels]
        ours, others = measured(levels), measured(luminance)
        np.testing.assert_array_equal(ours, others)
        assert ours[-1].approach > 0.0 or ours[-1].expansion > 0.3


@pytest.mark.parametrize("sway_px", [0.0, 2.0])
def test_what_approaches_a_camera_at_rest_has_a_time_to_contact_and_a_place(sway_px):
    """Also if a hovering drone sways; what passes by, and the sway alone, raise no alarm."""
    for rate, across, at in ((2.0, 0.0, 0.2), (0.0, 90.0, 0.4), (0.0, 0.0, 0.6)):
        images = towards_a_still_camera(136, 240, rate, 30, across=across, at=at, sway_px=sway_px)
        *_, one = measured([*images][:14])
        if rate:
            assert 0.7 * rate < one.approach < 1.4 * rate
            assert one.ttc_s == pytest.approx(1.0 / one.approach) and compared(one) == one.approach
            assert one.expansion_x == pytest.approx(2.0 * at - 1.0, abs=0.15)
            assert one.expansion_y == pytest.approx(-0.1, abs=0.15)
        else:
            assert one.approach == 0.0 and compared(one) < 0.1


def test_a_stream_that_stalls_shows_no_faster_approach(n_copies=6):
    """The images of a stall are copies; the one after it has moved on by as much as was missed."""
    images = [*towards_a_still_camera(136, 240, 2.0, 60)][:24]
    smooth = [one.approach for one in measured(images, [t / 30 for t in range(24)])][1:]
    stalled = [images[10] if 10 <= t < 11 + n_copies else images[t] for t in range(24)]
    rates = [one.approach for one in measured(stalled, [t / 30 for t in range(24)])][1:]
    assert 0.3 < max(rates) < 1.2 * max(smooth) and min(rates[8:]) > 0.0
    # A scene that comes to rest does not keep its rate.
    ends = [*images, *[images[-1]] * 30]
    assert measured(ends, [t / 30 for t in range(54)])[-1].approach == 0.0


def test_what_approaches_is_that_of_its_definition():
    """Background, group and growth; only the tracking is the same code."""
    frames = [*towards_a_still_camera(136, 240, 2.0, 30, sway_px=2.0)][:14]
    contrast = np.linspace(0.2, 1.0, 240)  # half of the points have too little texture
    frames = noisy([128.0 + 255.0 * contrast * (one - 0.5) for one in frames], 0.5)
    n_near = 0
    for before, now in zip(frames, frames[3:], strict=False):
        points = np.float32(slow_growth.middles(240, 136, 24))
        there, found, texture = growth.tracked(before, now, points)
        right = slow_growth.approach(points, there, found, texture, 24, **FIT)
        rate, (x, y) = approaching(before, now)
        assert rate == pytest.approx(right[0], abs=1e-3)
        n_near += rate > 0.0
        if rate > 0.0:
            assert (120.0 * (x + 1.0) - 0.5, 68.0 * (y + 1.0) - 0.5) == pytest.approx(right[1])
    assert n_near > 6


def test_nothing_approaches_where_nothing_can_be_tracked_or_the_background_is_torn():
    wall, other = (approach(1, 30, 1.0, (240, 135), seed=seed)[0] for seed in (5, 6))
    torn = wall.copy()
    torn[:, :120] = np.roll(wall, 3, axis=1)[:, :120]
    blank = np.full((135, 240), 90, np.uint8)
    for before, now in ((blank, blank), (wall, other), (wall, torn), (wall, blank), (wall, wall)):
        assert approaching(before, now) == NOTHING
    frames = [np.uint8(255.0 * one) for one in towards_a_still_camera(136, 240, 2.0, 30)]
    shown = np.ones((136, 240), bool)
    assert approaching(frames[9], frames[12], shown)[0] > 0.1
    shown[:, 90:200] = False
    assert approaching(frames[9], frames[12], shown) == NOTHING
    assert approaching(frames[9], frames[12], np.zeros((136, 240), bool)) == NOTHING


def grown(wall, scale, *squares):
    """Squares on a wall, before and after both grow; `squares` are x, y, half a side and growth."""
    skin = cv2.GaussianBlur(np.random.default_rng(9).random((99, 99), np.float32), (0, 0), 2)
    skin = cv2.normalize(skin, None, 20, 240, cv2.NORM_MINMAX)
    scales = cv2.getRotationMatrix2D((120, 68), 0.0, scale)
    after = cv2.warpAffine(wall, scales, (240, 136), borderMode=cv2.BORDER_REFLECT)
    images = [wall.copy(), after]
    for image, is_later in zip(images, (False, True), strict=True):
        for x, y, half, growth_of in squares:
            half *= growth_of if is_later else 1.0
            places = cv2.getRotationMatrix2D((0, 0), 0.0, half / 49.0)
            places[:, 2] = x - half, y - half
            cv2.warpAffine(skin, places, (240, 136), image, borderMode=cv2.BORDER_TRANSPARENT)
    return [np.uint8(image) for image in images]


def test_an_object_approaches_only_alone_and_before_a_camera_at_rest():
    """Not in flight, where the wall grows; not if parts of it move; not if two objects grow."""
    wall = np.random.default_rng(3).random((136, 240), np.float32)
    wall = cv2.normalize(cv2.GaussianBlur(wall, (0, 0), 2), None, 40, 215, cv2.NORM_MINMAX)
    one, other = (150, 60, 25, 1.15), (60, 70, 25, 1.15)
    before, now = grown(wall, 1.0, one)
    assert approaching(before, now)[0] == pytest.approx(0.15, rel=0.3)
    assert approaching(*grown(wall, 1.0, one, other)) == NOTHING
    assert approaching(*grown(wall, 1.03, one)) == NOTHING
    torn = now.copy()
    for row, px in enumerate((1, -1, 1, -1, 1)):
        band = slice(27 * row, 27 * (row + 1))
        torn[band, :110] = np.roll(now[band], px, axis=1)[:, :110]
    assert approaching(before, torn) == NOTHING


def test_an_object_approaches_under_a_masked_display_while_the_drone_sways():
    """Marks that stay in place, as those of an on-screen display, are no background."""
    hidden = np.zeros((136, 240), bool)
    for y in range(5, 130, 24):
        for x in range(5, 90, 24):
            hidden[y : y + 6, x : x + 6] = True
    expansion = Expansion()
    expansion.ignore(hidden)
    for t, frame in enumerate([*towards_a_still_camera(136, 240, 2.0, 30, sway_px=2.0)][:14]):
        frame[hidden] = 1.0
        one = expansion.step(frame, t / 30)
    assert one.approach == pytest.approx(2.0, rel=0.3)


@pytest.mark.parametrize("n_frames", [1, 4, 8])
def test_a_lamp_that_is_switched_on_raises_no_alarm(n_frames):
    """It brightens a part of a still scene within so many frames."""
    wall = cv2.GaussianBlur(np.random.default_rng(3).random((136, 240), np.float32), (0, 0), 2)
    wall = cv2.normalize(wall, None, 40, 140, cv2.NORM_MINMAX)
    y, x = np.mgrid[:136, :240]
    lit = 100.0 * np.exp(-(np.hypot(x - 150, y - 60) ** 2) / (2 * 20.0**2))
    frames = [np.uint8(wall + lit * min(max(t - 6, 0) / n_frames, 1.0)) for t in range(20)]
    rates = [compared(one) for one in measured(frames)]
    assert np.nanmax(rates) < 0.47


def test_a_hidden_mark_does_not_hold_the_image():
    frames = [frame.copy() for frame in towards_a_still_camera(136, 240, 3.0, 30)]
    hidden = np.zeros((136, 240), bool)
    hidden[:, :40] = True
    expansion = Expansion()
    expansion.ignore(hidden)
    expected = [expansion.step(frame, t / 30) for t, frame in enumerate(frames)]
    for frame in frames:
        frame[hidden] = 0.3
    expansion.reset()  # which does not end it
    found = [expansion.step(frame, t / 30) for t, frame in enumerate(frames)]
    np.testing.assert_array_equal(found, expected)
    assert found[-1].ttc_s < 1.0


def test_a_still_mark_in_the_window_does_not_change_the_rate_if_it_is_masked():
    frames = approach(20, 30, 1.5, (240, 135))
    marked = [one.copy() for one in frames]
    hidden = np.zeros((135, 240), bool)
    hidden[40:72, 90:150] = True
    for one in marked:
        one[hidden] = np.uint8(np.random.default_rng(8).integers(0, 256, (32, 60))).ravel()
    expansion = Expansion()
    expansion.ignore(hidden)
    masked = [expansion.step(one, t / 30).expansion for t, one in enumerate(marked)][-1]
    clean, unmasked = (at_rate(one, 30).expansion for one in (frames, marked))
    assert masked == pytest.approx(clean, rel=0.1) and unmasked < 0.8 * clean
    everything = np.ones((135, 240), bool)
    everything[0, 0] = False
    expansion.ignore(everything)
    expansion.reset()
    answers = [expansion.step(one, t / 30) for t, one in enumerate(marked)]
    assert math.isnan(answers[-1].expansion) and answers[-1].expansion_quality == 0.0


@pytest.mark.parametrize(
    ("size_wh", "is_too_small"),
    [
        ((480, 270), False),
        ((480, 38), True),
        ((32, 18), True),
        ((40, 19), True),
        ((96, 72), False),
    ],
)
def test_images_that_are_too_small_have_no_rate_and_say_so(size_wh, is_too_small):
    assert bool(too_small(size_wh)) == is_too_small
    *_, one = measured(approach(4, 30, 1.5, small_wh(*size_wh)))
    assert np.isnan(one.expansion) == is_too_small and (not is_too_small or np.isnan(one.ttc_s))
