"""`dlgmd bench` with the engine and the decoder of `dlgmd[fast]`."""

import json

import pytest

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
