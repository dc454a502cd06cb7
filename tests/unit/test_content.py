"""A comb, as interlaced video has it, is seen, and no other pattern is taken for one."""

import numpy as np
import pytest
from interlaced import GROUND, HEIGHT, RNG, WIDTH, at, woven

from dlgmd_cli.video.content import has_comb


def test_a_comb_is_seen_where_fields_differ():
    assert has_comb(woven(at(0), at(3))) and not has_comb(at(0))
    # An object of 96x96 px that moves before a still ground is enough.
    here, there = at(500).copy(), at(500).copy()
    here[100:196, 100:196] = there[100:196, 104:200] = GROUND[:96, 900:996]
    assert has_comb(woven(here, there)) and not has_comb(woven(here, here))


@pytest.mark.parametrize(
    "picture",
    [
        RNG.integers(0, 256, (HEIGHT, WIDTH), np.uint8),  # noise
        np.tile(np.uint8([[20], [20], [220], [220]]), (HEIGHT // 4, WIDTH)),  # fine stripes
        np.repeat(GROUND[::2, :WIDTH], 2, axis=0),  # a field, doubled
        np.clip(at(0) + RNG.normal(0, 15, (HEIGHT, WIDTH)), 0, 255).astype(np.uint8),
        np.full((HEIGHT, WIDTH), 90, np.uint8),
        np.zeros((5, 3), np.uint8),
    ],
)
def test_other_pictures_have_no_comb(picture):
    assert not has_comb(picture)
