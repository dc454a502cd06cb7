"""`dlgmd bench` with the engine and the decoder of `dlgmd[fast]`, and on a clip of its own."""

import json
from types import SimpleNamespace

import pytest

from dlgmd_cli.tasks import bench as benchmark

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("package", "options", "key"),
    [("numba", ["--engine", "numba"], "engine"), ("av", ["--decoder", "pyav"], "decoder")],
)
def test_engine_and_decoder(dlgmd, clips, package, options, key):
    pytest.importorskip(package, reason="comes with dlgmd[fast]")
    options = [*options, "--frames", 15, "--json"]
    result = dlgmd(
        "bench", clips / "loom.avi", "--radius", 2, "--scale", 0.5, "--repeat", 1, *options
    )
    found = json.loads(result.stdout)
    assert {**found, **found["rows"][0]}[key] == options[1] and found["frames"] == 15


def test_own_clip_is_compared_with_the_paper(runs):
    options = ["--radius", 2, "--scale", 0.02, "--repeat", 1, "--frames", 12]
    result = runs("bench", *options)
    assert "Rendering 12 frames of 1920x1080" in result.stderr
    assert "38x22" in result.stdout and " 0.57 " in result.stdout
    video = SimpleNamespace(info=SimpleNamespace(width=1920, height=1080), size_wh=(1920, 1080))
    row = benchmark.row(6, 1.0, video, "opencv", {"whole_ms": 7.65})
    assert (row["paper_s"], row["ratio"]) == (9.18, pytest.approx(10.0))  # ten times as fast
