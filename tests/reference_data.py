"""Where the authors' frames and the numbers of their released code lie, if they do."""

import csv
import os
from pathlib import Path

import cv2
import pytest

SEQUENCES = ("looming_ball", "ball_and_capsules")


def reference_dir():
    """The folder of reference data; skips the calling test where there is none."""
    beside = Path(__file__).parents[2] / "shared" / "reference"
    folder = Path(os.environ.get("DLGMD_REFERENCE") or beside)
    if not folder.is_dir():
        pytest.skip("no reference data: point DLGMD_REFERENCE at its folder")
    return folder


def reference_frames(sequence):
    """The frames of a sequence in order, as a list of (600, 800) uint8."""
    paths = sorted((reference_dir() / sequence).glob("*.png"))
    return [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths]


def assert_released(responses, path):
    """Every row that the released code printed is met; it computes in single precision."""
    with path.open(newline="") as handle:
        rows = {int(row["t"]): row for row in csv.DictReader(handle)}
    assert [t for t, one in enumerate(responses) if one.is_valid] == sorted(rows)
    assert any(float(row["g_sum"]) > 0.0 for row in rows.values())
    for t, row in rows.items():
        for column in ("s_sum", "g_sum", "ffi", "t_de"):
            expected = float(row[column])
            actual = getattr(responses[t], "mp" if column == "g_sum" else column)
            error = abs(actual - expected)
            assert error <= 1e-5 * max(abs(expected), 1.0), f"t = {t}, {column}"
