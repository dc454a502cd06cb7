"""The images of real clips are sound, however few of them a camera gives."""

import numpy as np
import pytest
from reference_data import reference_dir

from dlgmd_cli import open_video
from dlgmd_cli.models.health import Health


@pytest.mark.parametrize(
    ("name", "right"),
    [
        ("clips/nc07", {None}),  # two vehicles pass close
        ("footage/neg_gopro_walk", {None}),
        ("approach/tof_A02", {None, "frozen"}),  # a drone that stands still before it starts
        ("approach/chessboard_60fps", {None, "frozen"}),
    ],
)
def test_real_clips_are_sound_at_any_rate(name, right):
    with open_video(reference_dir() / f"{name}.mp4") as video:
        frames = [(one.time_s, one.grey) for one in video.frames((160, 90)) if one.index < 300]
    times_s = [time_s for time_s, _ in frames]
    for fps in (3, 5, 6, 7.5, 10, 15, 30):
        health = Health()
        chosen = np.unique(np.searchsorted(times_s, np.arange(0.0, times_s[-1], 1.0 / fps)))
        assert {health.step(frames[i][1], frames[i][0]) for i in chosen} <= right
