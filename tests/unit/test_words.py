"""Numbers in sentences."""

import pytest

from dlgmd_cli.errors import counted
from dlgmd_cli.results.names import frames_text, threshold_text


def test_one_video_is_no_videos():
    assert [counted(n, "video") for n in range(3)] == ["0 videos", "1 video", "2 videos"]


@pytest.mark.parametrize(
    ("value", "text"), [(0.4, "0.4"), (0.123456, "0.1235"), (1.0, "1"), (0.99999994, "0.99999994")]
)
def test_what_is_below_one_does_not_look_like_one(value, text):
    assert threshold_text(value) == text


def test_frames_say_how_many_were_left_out():
    record = {"processed": {"frames": 60}, "input": {"frames": 60}}
    assert frames_text(record) == "60"
    assert frames_text({**record, "input": {"frames": 120}}) == "60 of 120"
