"""Calls that look wrong, and work: each runs."""

import shlex
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1] / "unit"))
from test_mended_calls import folder  # noqa: F401


@pytest.mark.parametrize(
    "line",
    [
        "run '~/flight.mp4'",
        "run flight.mp4 –set 9",
        "run flight.mp4 —set=9",
        "compare flight.mp4 --set 3-6",
        "layers flight.mp4 --frames 1-4",
        "run flight.mp4 --size 24*18 --decoder OpenCV",
        "run flight.mp4 --param expansion_alarm=0.5,r=4",
        "run deep --bit-depth 12",
        "info flight.mp4 frames --decoder opencv",
        "batch flights deep --decoder opencv --jobs 1",
        "batch flights --set 9 --set flight --param expansion_alarm=0.6 --jobs 1",
        "run frames --config repeated.yaml",
    ],
)
def test_what_works(
    runs,
    folder,  # noqa: F811
    here,
    monkeypatch,
    tmp_path,
    line,
):
    monkeypatch.chdir(folder)
    monkeypatch.setenv("HOME", str(folder))
    # Another input may have used the options of a record.
    recorded = tmp_path / "repeated.yaml"
    recorded.write_text("set: 9\noptions:\n  decoder: pyav\n  bit_depth: 12\n  size: 640x480\n")
    out = () if line.startswith("info") else ("--out", tmp_path / "o")
    runs(*shlex.split(line.replace("repeated.yaml", str(recorded))), *out)
