"""Every tag of colours that FFmpeg can write: the levels stay those of the file."""

import numpy as np
import pytest

pytest.importorskip("av", reason="PyAV writes these videos")

from damaged import encode

from dlgmd_cli.video.opening import open_video

pytestmark = pytest.mark.slow

# Every tag that FFmpeg can write, one at a time: primaries, transfers and matrices.
PRIMARIES, TRANSFERS, MATRICES = (*range(4, 13), 22), range(4, 19), (0, *range(4, 18))
EVERY = [
    *((number, 2, 2) for number in PRIMARIES),
    *((1, number, 1) for number in TRANSFERS),
    *((1, 1, number) for number in MATRICES),
]
# The files that PyAV reads, whatever the option says.
HANDED_OVER = {(1, number, 1) for number in (9, 10, 16, 17, 18)}
HANDED_OVER |= {(number, 2, 2) for number in (*range(8, 13), 22)}
HANDED_OVER |= {(1, 1, number) for number in (8, *range(10, 18))}
RAMP = [np.tile(np.arange(16, 236, dtype=np.uint8), (16, 1))] * 2


def tagged(path, colours, colour_range):
    """A video of grey frames without loss, with these tags."""
    return encode(path, RAMP, "ffv1", colours=colours, colour_range=colour_range)


def levels(video):
    """The first frame of an open video, as whole numbers."""
    return next(iter(video)).grey.astype(int)


@pytest.mark.parametrize("colour_range", [1, 2])
@pytest.mark.parametrize("colours", EVERY, ids=str)
def test_every_tag_keeps_the_levels(tmp_path, colours, colour_range):
    plain = tagged(tmp_path / "plain.mkv", (2, 2, 2), colour_range)
    path = tagged(tmp_path / "x.mkv", colours, colour_range)
    with open_video(plain, decoder="pyav") as video:
        expected = levels(video)
    with open_video(path) as video:
        assert np.abs(levels(video) - expected).max() <= 2
        assert video.info.decoder == ("pyav" if colours in HANDED_OVER else "opencv")
