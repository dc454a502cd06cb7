"""Whatever is changed in a video, frames that are lost are told."""

from collections import Counter

import pytest

pytest.importorskip("av", reason="PyAV writes these videos")

from mutations import study

pytestmark = pytest.mark.slow
N_MUTANTS = 500


def test_frames_are_lost_with_a_word(tmp_path):
    """Less than one mutant in a hundred loses some without, and no crash ends the study."""
    rows = study(tmp_path, N_MUTANTS)
    assert len(rows) == 2 * N_MUTANTS
    for decoder in ("opencv", "pyav"):
        silent = [row for row in rows if row.where and row.decoder == decoder]
        # The rate that an AVI's header states is all that there is.
        lost = [row for row in silent if not row.name.endswith(".avi")]
        assert len(lost) < 0.01 * N_MUTANTS, Counter(row[1:5] for row in lost)
        assert len(silent) < 0.02 * N_MUTANTS, Counter(row[1:5] for row in silent)
