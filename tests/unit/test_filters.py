"""Tiles cover the frame, thresholds hold at the last digit, and NaN is not hidden."""

import math

import numpy as np
import pytest
from conftest import scene

from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.filters import TILE_HW, just_below, tiles
from dlgmd_cli.parameters.presets import MODELS


def test_tiles_cover_every_pixel_once_with_what_it_depends_on():
    for shape in ((1, 1), TILE_HW, (TILE_HW[0] + 1, TILE_HW[1] + 1), (700, 1300)):
        count = np.zeros(shape, int)
        for tile in tiles(shape, radius=6):
            count[tile.target] += 1
            whole = np.arange(shape[0] * shape[1]).reshape(shape)
            window = whole[tile.window]
            assert np.array_equal(window[tile.core], whole[tile.target])
            for place, side in enumerate(shape):
                needed = tile.target[place].start - 7, tile.target[place].stop + 8
                assert tile.window[place].start == max(0, needed[0])
                assert tile.window[place].stop == min(side, needed[1])
        assert np.all(count == 1)


@pytest.mark.parametrize("name", ["dlgmd", "dlgmd-onoff"])
def test_what_is_no_number_is_in_the_sums_as_long_as_in_the_history(name):
    frames = scene(20, 30, n_frames=10, dtype=np.float32)
    frames[0][5, 5] = frames[5][5, 5] = np.nan
    model = create_model(MODELS[name](a=0.4))
    responses = [model.step(frame) for frame in frames]
    assert math.isnan(responses[5].s_sum)
    for t in (4, 9):  # it has left the history
        assert math.isfinite(responses[t].s_sum) and math.isfinite(responses[t].t_de)


@pytest.mark.parametrize("threshold", [1e-30, 0.1, 0.25, 1 / 3, 0.3, 1.0, 7.25])
def test_just_below_turns_greater_into_at_least(threshold):
    below = just_below(threshold)
    assert below == np.float32(below) < threshold
    assert float(np.nextafter(np.float32(below), np.float32(math.inf))) >= threshold
