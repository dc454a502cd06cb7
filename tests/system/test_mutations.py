"""Whatever is changed in a file, what its format shows is reported; of whole files nothing is."""

import shutil

import pytest

pytest.importorskip("av", reason="PyAV reads these videos")
pytest.importorskip("rosbags", reason="it writes the bags")

from mutations import VIDEOS, is_promised, study, variants

from dlgmd_cli.video.opening import open_video

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg writes these videos"),
]
N_MUTANTS = 380


def test_what_is_lost_is_reported_where_the_format_shows_it(tmp_path):
    """The table is in docs/damage.md; nothing hangs, and no error is an internal one."""
    rows = study(tmp_path, N_MUTANTS)
    assert len({row.name for row in rows}) > len(VIDEOS)
    assert not [row for row in rows if row.outcome in ("internal error", "hang or crash")]
    assert not [row for row in rows if is_promised(row.name, row.outcome)]


@pytest.mark.parametrize("variant", ["longer-sound", "late", "variable"])
def test_whole_videos_are_not_called_damaged(tmp_path, decoder, variant):
    n_read = 0
    for path in variants(tmp_path, [variant]):
        with open_video(path, decoder=decoder) as video:
            assert sum(1 for _ in video.pictures()) > 0
            assert not video.progress.damage, path
        n_read += 1
    assert n_read > 10
