"""Names of inputs and of results, and numbers in sentences."""

from pathlib import Path

import pytest

from dlgmd_cli.results.names import (
    distinct_names,
    frames_text,
    numbered,
    part_text,
    recorded_name,
    threshold_text,
)
from dlgmd_cli.video.base import input_name


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("/day1/frames/%04d.png", "frames"),
        ("/day1/frames.v2/*.png", "frames.v2"),
        ("/day1/frames.v2", "frames.v2"),
        ("/day1/*/[ab]/%d.png", "day1"),
    ],
)
def test_pictures_are_called_as_their_folder(path, name):
    assert recorded_name({"path": path, "pictures": 8}) == name
    assert input_name(Path("."), are_pictures=True) == Path.cwd().name


def test_a_file_is_called_by_its_stem():
    assert recorded_name({"path": "day1/flight.v2.mp4"}) == "flight.v2"
    assert recorded_name({}) == ""


def test_distinct_names():
    assert distinct_names([Path("/a/b"), Path("/c/b"), Path("/c/d")]) == ["a/b", "c/b", "d"]
    assert numbered(["a", "a", "a (2)", "a"]) == ["a", "a (2)", "a (2) (2)", "a (3)"]


@pytest.mark.parametrize(
    ("value", "text"), [(0.4, "0.4"), (0.123456, "0.1235"), (1.0, "1"), (0.99999994, "0.99999994")]
)
def test_what_is_below_one_does_not_look_like_one(value, text):
    assert threshold_text(value) == text


def test_frames_say_how_many_were_left_out():
    record = {"processed": {"frames": 60}, "input": {"frames": 60}}
    assert frames_text(record) == "60"
    assert frames_text({**record, "input": {"frames": 120}}) == "60 of 120"
    assert part_text([1.0, 1.5]) == ", only 1.000 to 1.500 s of the input"
    assert part_text([]) == ", no part of the input"
