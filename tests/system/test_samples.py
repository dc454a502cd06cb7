"""The sample videos: their truth, how plain ones are made, and what the preset `flight` says.

`group2.mp4` is a rendered flight; nothing renders it again.
"""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from conftest import csv_rows, read_video, yaml_of
from looming import approach

from dlgmd_cli import run

pytestmark = pytest.mark.slow

SAMPLES = Path(__file__).parents[2] / "sample_videos"
COMMANDS = re.findall(r"^dlgmd (synth .+)$", (SAMPLES / "README.md").read_text("utf-8"), re.M)


@pytest.mark.parametrize("command", COMMANDS)
def test_sample_is_what_its_command_makes(runs, command):
    video, truth = map(Path, runs(*shlex.split(command)).stdout.splitlines())
    assert video.parent == Path("sample_videos")
    made, kept = csv_rows(truth), csv_rows(SAMPLES / truth.name)
    assert [row.keys() for row in made] == [row.keys() for row in kept]
    # Another processor may round in another way.
    numbers, kept_numbers = (
        [[float(cell or "nan") for cell in row.values()] for row in rows] for rows in (made, kept)
    )
    assert np.allclose(numbers, kept_numbers, rtol=1e-6, atol=1e-6, equal_nan=True)
    kept_frames, frames = (
        np.array(read_video(path)[1], float) for path in (SAMPLES / video.name, video)
    )
    assert kept_frames.shape == frames.shape
    # Another release of the codec may round in another way, but sees the same image.
    assert np.mean(np.abs(kept_frames - frames)) < 2.0


def test_every_sample_is_small_and_has_its_truth():
    videos = sorted(SAMPLES.glob("*.mp4"))
    assert [path.stem for path in videos] == sorted(path.stem for path in SAMPLES.glob("*.csv"))
    assert {path.stem for path in videos} == {"group2", *(one.split()[1] for one in COMMANDS)}
    for path in videos:
        rate, frames = read_video(path)
        rows = csv_rows(path.with_suffix(".csv"))
        assert rate == 30.0 and [int(row["frame"]) for row in rows] == [*range(len(frames))]
        assert path.stat().st_size <= 1_000_000
    assert yaml_of(SAMPLES / "group2.yaml")["collision_frame"] == 140


@pytest.mark.parametrize(
    ("name", "contact_s"),
    [
        ("group2", 140 / 30),
        ("looming-ball", 2.5),
        ("looming-cube", 2.5),
        ("receding-cube", None),
        ("translating-cubes", None),
    ],
)
def test_the_default_announces_the_contacts_of_the_samples_and_nothing_else(name, contact_s):
    onsets_s = [alarm.start_s for alarm in run(SAMPLES / f"{name}.mp4").alarm_list]
    if contact_s is None:
        assert not onsets_s
    else:
        before_s = [contact_s - onset_s for onset_s in onsets_s if onset_s < contact_s]
        assert before_s and max(before_s) <= 1.7


def test_an_approach_raises_the_same_alarm_at_24_30_and_60_frames_a_second():
    """Within three frames of 24 a second; at 60 a second, every second frame is processed."""
    first_s = []
    for fps in (24, 30, 60):
        frames = approach(int(3.5 * fps), fps, contact_s=3.6, size_wh=(240, 136))
        first_s.append(run(frames, fps=fps).alarm_list[0].start_s)
    assert min(first_s) > 1.0 and max(first_s) - min(first_s) <= 0.125
