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


def released_rows(sequence, number):
    """What the released code printed for a sequence and a set: t -> column -> value."""
    path = reference_dir() / f"released_{sequence}_set{number}.csv"
    with path.open(newline="") as handle:
        return {int(row.pop("t")): {k: float(v) for k, v in row.items()} for row in _rows(handle)}


def _rows(handle):
    return list(csv.DictReader(handle))
