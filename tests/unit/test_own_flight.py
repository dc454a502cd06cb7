"""The `released` formulation against the authors' released code, on frames that lie here.

`own_flight` holds 24 frames of a rendered flight, and what the released code answers to them.
"""

import csv
from pathlib import Path

import cv2
import pytest

from dlgmd_cli import DLGMD, load_set

FOLDER = Path(__file__).parents[1] / "own_flight"
COLUMNS = {"s_sum": "s_sum", "g_sum": "mp", "ffi": "ffi", "t_de": "t_de"}
TOLERANCE = 1e-5  # the released code computes in single precision


@pytest.fixture(scope="module")
def frames():
    paths = sorted(FOLDER.glob("*.png"))
    return [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths]


@pytest.mark.usefixtures("each_engine")
@pytest.mark.parametrize("number", range(1, 10))
def test_every_row_of_the_released_code_is_met(frames, number):
    model = DLGMD(load_set(number, formulation="released"))
    responses = [model.step(frame) for frame in frames]
    with (FOLDER / f"released_set{number}.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [t for t, one in enumerate(responses) if one.is_valid] == [int(r["t"]) for r in rows]
    assert len(frames) == 24 and any(float(row["g_sum"]) > 0.0 for row in rows)
    for row in rows:
        for column, attribute in COLUMNS.items():
            actual, expected = getattr(responses[int(row["t"])], attribute), float(row[column])
            error = abs(actual - expected)
            assert error <= TOLERANCE * max(abs(expected), 1.0), (row["t"], column)
