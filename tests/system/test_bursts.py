"""The alarm of a stream whose frames come in bursts from the first one on."""

import warnings
from itertools import pairwise

import cv2
import numpy as np
import pytest
from arrivals import at_beacons, in_bursts
from watching import ROOT

from dlgmd_cli import Alarm, open_video

pytestmark = pytest.mark.slow
N_NEAR, SETTLED_S = 3, 1.0
GAPS_S = (0.0003, 0.001, 0.002, 0.005, 0.008)


@pytest.fixture(scope="module")
def frames():
    with open_video(ROOT / "sample_videos" / "group2.mp4", width_px=240) as video:
        return [frame.grey for frame in video]


def watched(frames, arrivals_s, **options):
    """The first frame with an alarm, the frames that were left out, and whether it was blind."""
    alarm, answers = Alarm(**options), []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        answers = [alarm.step(*one) for one in zip(frames, arrivals_s.tolist(), strict=True)]
    first = next(number for number, answer in enumerate(answers) if answer.alarm)
    is_left_out = [answer is before for before, answer in pairwise(answers)]
    return first, 1 + np.flatnonzero(is_left_out), any(answer.blind for answer in answers)


@pytest.mark.parametrize("fps", [25, 30, 50, 60])
@pytest.mark.parametrize("way", [2, 3, 4, 6, 8, "beacons", "jitter"])
def test_bursts_from_the_first_frame_on(frames, fps, way):
    """The alarm is that of the true times; only the frame rate leaves frames out, and not soon."""
    captured, rng = np.arange(len(frames)) / fps, np.random.default_rng(0)
    true_first, true_left_out, _ = watched(frames, captured, times="capture")
    for gap_s in GAPS_S:
        if way == "jitter":
            came = np.maximum.accumulate(captured + rng.uniform(0.0, 4.0 * gap_s, len(frames)))
        elif way == "beacons":
            came = at_beacons(len(frames), fps, gap_s)
        else:
            came = in_bursts(len(frames), fps, way, gap_s)
        first, left_out, is_blind = watched(frames, came)
        n_near = N_NEAR * (2 if fps > 33 else 1)  # frames that are processed
        assert abs(first - true_first) <= n_near and not is_blind
        assert len(left_out) == 0 or (fps > 30 and came[left_out[0]] - came[0] >= SETTLED_S)
        assert len(left_out) <= len(true_left_out) + N_NEAR


@pytest.mark.parametrize("size", [4, 8])
def test_the_rate_is_told_and_said_to_be_uncertain(frames, size):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        alarm = Alarm()
        for frame, time_s in zip(frames, in_bursts(len(frames), 30, size, 0.001), strict=True):
            alarm.step(cv2.resize(frame, (120, 68)), float(time_s))
    assert [str(one.message).split(";")[-1] for one in caught] == [
        " their rate is uncertain, and counts as 30 a second for a second",
        " their rate is about 30 a second, which is uncertain",
    ]
