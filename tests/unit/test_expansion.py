"""The expansion rate and the time to contact, on images of known rate."""

import cv2
import numpy as np
import pytest

import dlgmd_cli
from dlgmd_cli.frame import small_wh
from dlgmd_cli.models.expansion import Expansion, too_small


def measured(frames, times=None, **options):
    """What the expansion of each frame is."""
    expansion = Expansion(**options)
    times = [None] * len(frames) if times is None else times
    return [expansion.step(frame, time_s) for frame, time_s in zip(frames, times, strict=True)]


def towards_a_still_camera(height, width, rate, fps, *, across=0.0, at=0.6):
    """A square on a still wall; it grows by `rate` a second, and moves `across` cells a second."""
    rng = np.random.default_rng(4)
    ground, skin = (cv2.GaussianBlur(rng.random((99, 99), np.float32), (0, 0), 2) for _ in "ab")
    wall = cv2.resize(ground, (width, height))
    for t in range(fps // 2):
        half = height / 10.0 * (1.0 + rate / fps) ** t
        middle = (at * width + across * t / fps, 0.45 * height)
        grows = cv2.getRotationMatrix2D((0, 0), 0.0, half / 49.0)
        grows[:, 2] = np.subtract(middle, half)
        yield cv2.warpAffine(
            1.0 - skin, grows, (width, height), wall.copy(), borderMode=cv2.BORDER_TRANSPARENT
        )


STILL = list(towards_a_still_camera(24, 30, 4.0, 12))


def test_levels_and_luminance_give_the_same_rate():
    levels = [np.rint(255 * frame).astype(np.uint8) for frame in STILL]
    luminance = [np.float32(frame / np.float32(255)) for frame in levels]
    ours, others = (np.array(measured(frames)) for frames in (levels, luminance))
    np.testing.assert_allclose(ours, others, rtol=1e-4, atol=1e-4)


def test_what_approaches_a_camera_at_rest_has_a_time_to_contact_and_a_place():
    # At 0.85 of the width, nothing changes in the middle so far.
    for rate, across, at in ((3.0, 0.0, 0.6), (3.0, 0.0, 0.85), (0.0, 120.0, 0.6)):
        frames = [*towards_a_still_camera(136, 240, rate, 30, across=across, at=at)]
        *_, one = measured(frames[:13])
        if rate:
            assert one.ttc_s == pytest.approx(1.0 / rate, rel=0.3)
            assert one.expansion_x == pytest.approx(2.0 * at - 1.0, abs=0.1)
            assert one.expansion_y == pytest.approx(-0.1, abs=0.1)
        else:
            assert not one.ttc_s < 1.5


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


@pytest.mark.parametrize(
    ("size_wh", "is_too_small"),
    [
        ((480, 270), False),
        ((480, 76), True),
        ((32, 18), True),
        ((20, 20), False),
        ((96, 72), False),
    ],
)
def test_images_that_are_too_small_have_no_rate_and_say_so(size_wh, is_too_small):
    assert bool(too_small(size_wh)) == is_too_small
    width, height = small_wh(*size_wh)
    rng = np.random.default_rng(1)
    *_, one = measured([rng.integers(0, 256, (height, width), np.uint8) for _ in range(3)])
    assert np.isnan(one.expansion) == is_too_small and (not is_too_small or np.isnan(one.ttc_s))


@pytest.mark.parametrize("name", ["looming-cube", "looming-ball"])
def test_the_time_to_contact_of_a_whole_object_is_its_own(name):
    clip = dlgmd_cli.synth(name)
    truth_s, ttc_s = clip.truth["time_to_contact_s"], dlgmd_cli.run(clip.frames, fps=clip.fps).ttc_s
    timely = (truth_s >= 0.5) & (truth_s <= 2.0)
    assert 0.85 <= np.median(ttc_s[timely] / truth_s[timely]) <= 1.15
    # In the end, the even face of the cube fills what is measured.
    assert np.isnan(ttc_s[truth_s <= 0.3]).all() or name == "looming-ball"
