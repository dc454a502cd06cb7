"""Names of inputs and of results."""

from pathlib import Path

import pytest

from dlgmd_cli.results.names import distinct_names, numbered, recorded_name
from dlgmd_cli.video.names import input_name


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
