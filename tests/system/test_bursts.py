"""The alarm of a stream whose frames come in bursts from the first one on."""

import warnings

import numpy as np
import pytest
from arrivals import arriving, in_bursts, watched
from watching import ROOT

from dlgmd_cli import Alarm, open_video

pytestmark = pytest.mark.slow
N_NEAR, SETTLED_S = 3, 1.0


@pytest.fixture(scope="module")
def frames():
    with open_video(ROOT / "sample_videos" / "group2.mp4", width_px=120) as video:
        return [frame.grey for frame in video]


@pytest.fixture(scope="module")
def true_times(frames):
    """What comes of the frames at their true times, by frame rate."""
    number = np.arange(len(frames))
    return {fps: watched(frames, number / fps, times="capture") for fps in (30, 60)}


@pytest.mark.parametrize(
    ("fps", "way", "gap_s"),
    [
        *((30, 2, 0.0003), (30, 8, 0.008), (30, "beacons", 0.002), (30, "jitter", 0.008)),
        *((60, 4, 0.002), (60, 4, 0.008), (60, "jitter", 0.0003)),
    ],
)
def test_bursts_from_the_first_frame_on(frames, true_times, fps, way, gap_s):
    """The alarm is that of the true times; only the frame rate leaves frames out, and not soon."""
    true = true_times[fps]
    # At the threshold, the rate of this flight grows by 2 % a frame; jitter makes it 10 % less.
    near = 2 * N_NEAR if way == "jitter" else N_NEAR
    came = arriving(len(frames), fps, way, gap_s)
    first, left_out, is_blind = watched(frames, came)
    assert abs(first - true.first) <= near and not is_blind
    assert len(left_out) == 0 or (fps > 30 and came[left_out[0]] - came[0] >= SETTLED_S)
    assert len(left_out) <= len(true.left_out) + N_NEAR


@pytest.mark.parametrize("size", [4, 8])
def test_the_rate_is_told_and_said_to_be_uncertain(frames, size):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        alarm = Alarm()
        for frame, time_s in zip(frames, in_bursts(len(frames), 30, size, 0.001), strict=True):
            alarm.step(frame, float(time_s))
    assert [str(one.message).split(";")[-1] for one in caught] == [
        " their rate is uncertain, and counts as 30 a second for a second",
        " their rate is about 30 a second, which is uncertain",
    ]
