"""The sample videos are what `dlgmd synth` makes of the commands in their README."""

import csv
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import read_video

from dlgmd_cli.scenes.flights.scenes import SCENES, FlightScene

pytestmark = pytest.mark.slow

SAMPLES = Path(__file__).parents[2] / "sample_videos"


def sample_commands() -> list[str]:
    """The commands in the samples' README."""
    return re.findall(r"^dlgmd (synth .+)$", (SAMPLES / "README.md").read_text("utf-8"), re.M)


def columns_of(path: Path) -> tuple[list[str], np.ndarray, list[list[str]]]:
    """Header, numbers (NaN for empty cells) and texts of a CSV."""
    header, *rows = csv.reader(path.read_text("utf-8").splitlines())
    texts = [column for column in zip(*rows, strict=True) if column[0].isalpha()]
    numbers = [column for column in zip(*rows, strict=True) if not column[0].isalpha()]
    return header, np.array([[float(cell or "nan") for cell in c] for c in numbers]), texts


@pytest.mark.parametrize("command", sample_commands())
def test_sample_is_what_its_command_makes(runs, command):
    result = runs(*shlex.split(command))
    video, truth, *records = (Path(line) for line in result.stdout.splitlines())
    assert truth.parent == Path("sample_videos")
    header, numbers, texts = columns_of(truth)
    kept_header, kept_numbers, kept_texts = columns_of(SAMPLES / truth.name)
    assert (header, texts) == (kept_header, kept_texts)
    # Another processor may round in another way.
    assert numbers == pytest.approx(kept_numbers, rel=1e-6, abs=1e-6, nan_ok=True)
    for record in records[:1]:
        made, kept = (
            yaml.safe_load((d / record.name).read_text()) for d in (Path(record.parent), SAMPLES)
        )
        for of_this_machine in ("versions", "codec"):
            del made[of_this_machine], kept[of_this_machine]
        assert made == kept
    sample = SAMPLES / video.name
    assert sample.stat().st_size <= 1_000_000
    kept_frames, frames = (np.array(read_video(path)[1], float) for path in (sample, video))
    assert kept_frames.shape == frames.shape
    # Another release of the codec may round in another way, but sees the same image.
    assert np.mean(np.abs(kept_frames - frames)) < 2.0


def test_every_sample_has_its_command():
    scenes = {command.split()[1] for command in sample_commands()}
    assert {path.stem for path in SAMPLES.glob("*.mp4")} == scenes
    assert {path.stem for path in SAMPLES.glob("*.csv")} == scenes
    flights = {name for name in scenes if isinstance(SCENES[name], FlightScene)}
    assert {path.stem for path in SAMPLES.glob("*.yaml")} == flights
