"""A comb, as interlaced video has it, is seen, and no other pattern is taken for one."""

import cv2
import numpy as np
import pytest

from dlgmd_cli.video.content import has_comb

HEIGHT, WIDTH, N = 480, 320, 24
RNG = np.random.default_rng(5)
GROUND = cv2.GaussianBlur(RNG.integers(0, 256, (HEIGHT, 1200), np.uint8), (0, 0), 3.0)
GROUND = cv2.normalize(GROUND, None, 20, 235, cv2.NORM_MINMAX)


def at(x_px):
    """What a camera sees that has turned by so many px."""
    return GROUND[:, x_px : x_px + WIDTH]


def woven(first, second):
    """The even lines of an image and the odd ones of another."""
    picture = first.copy()
    picture[1::2] = second[1::2]
    return picture


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
