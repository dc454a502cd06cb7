"""What the shipped thresholds promise: on the real clips, and on real approaches."""

import json

import pytest
from reference_data import reference_dir

pytestmark = pytest.mark.slow

NUMBERS = (3, 9)
OTHERS = ("lgmd", "dlgmd-onoff")


def test_no_model_raises_a_false_alarm_on_the_clips(dlgmd):
    asked = ["--set=flight", *(f"--set={number}" for number in NUMBERS)]
    asked += [f"--model={name}" for name in OTHERS]
    labels = reference_dir() / "clips" / "labels.csv"
    result = dlgmd("evaluate", labels, *asked, "--no-baselines", "--format=none", "--json")
    models = json.loads(result.stdout)["models"]
    assert len(models) == 1 + len(NUMBERS) + len(OTHERS)
    assert {label: one["false_alarms_per_min"] for label, one in models.items()} == (
        dict.fromkeys(models, 0.0)
    )
    # It waits until the whole image expands, so it misses what crosses the way: three of four.
    assert models["flight"]["recall"] >= 0.25
    assert all(models[f"set{number}"]["recall"] >= 0.5 for number in NUMBERS)


def test_real_approaches_are_scored_by_their_labels_and_truth(dlgmd, tmp_path):
    """The hand-held camera over a chessboard, and one flight that only turns."""
    place = reference_dir() / "approach"
    if not place.is_dir():
        pytest.skip(f"there are no real approaches in {place}")
    kept = ("video,", "chessboard", "tof_R02", "tof_A08")
    for part in ("truth", "chessboard_60fps.mp4", "tof_R02.mp4", "tof_A08.mp4"):
        (tmp_path / part).symlink_to(place / part)
    lines = (place / "labels.csv").read_text("utf-8").splitlines(keepends=True)
    labels = tmp_path / "labels.csv"
    labels.write_text("".join(line for line in lines if line.startswith(kept)), "utf-8")
    asked = ("--param", "expansion_alarm=0.3", "--no-baselines", "--format=none", "--json")
    result = dlgmd("evaluate", labels, *asked)
    facts = json.loads(result.stdout)["models"]["flight expansion_alarm=0.3"]
    assert (facts["videos"], facts["contacts"]) == (3, 7) and facts["announced"] >= 6
    assert facts["missed"] == 7 - facts["hits"]
