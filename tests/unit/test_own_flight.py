"""The `released` formulation against the authors' released code, on frames that lie here.

`own_flight` holds 24 frames of a rendered flight, and what the released code answers to them.
"""

from pathlib import Path

import cv2
import pytest
from reference_data import assert_released

from dlgmd_cli import DLGMD, load_set

FOLDER = Path(__file__).parents[1] / "own_flight"
FRAMES = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(FOLDER.glob("*.png"))]


@pytest.mark.parametrize("number", range(1, 10))
def test_every_row_of_the_released_code_is_met(number):
    model = DLGMD(load_set(number, formulation="released-2021"))
    assert len(FRAMES) == 24
    assert_released([model.step(frame) for frame in FRAMES], FOLDER / f"released_set{number}.csv")
