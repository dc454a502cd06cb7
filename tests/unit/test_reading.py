"""What follows from a recording is the same in pieces of any length as at once."""

import math
import os
from contextlib import ExitStack
from dataclasses import fields
from unittest.mock import patch

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from dlgmd_cli.models.base import Response
from dlgmd_cli.parameters import DlgmdParameters
from dlgmd_cli.results.measures import Summary, doubts, summarise
from dlgmd_cli.results.tables import TABLES, Result, write_tables
from dlgmd_cli.runs.reading import Reading
from dlgmd_cli.runs.recording import Recording
from dlgmd_cli.video.frames import Frame

NAN = math.nan
PICTURE = np.empty((0, 0), np.uint8)
rows = st.lists(
    st.tuples(
        st.sampled_from([NAN, 0.0]) | st.floats(1e-3, 1e3),  # ΣS
        st.sampled_from([NAN, 0.0, 2.0, 9.0]) | st.floats(0.0, 20.0),  # K
    ),
    min_size=1,
    max_size=60,
)


def reading_of(rows, n_sp=2, by_sequence=False):
    """What follows from the frames 5, 6, …; they spike from K = 3, or half its range, on."""
    recording = Recording()
    for number, (s_sum, mp) in enumerate(rows, start=5):
        response = Response(p_sum=7.0, s_sum=s_sum, mp=mp, ffi=0.0, t_de=0.0)
        recording.append(Frame(number, number / 30, PICTURE), response)
    params = DlgmdParameters(kappa=1.0, t_mp=0.5, n_sp=n_sp)
    return Reading(recording, (3, 1), params, by_sequence=by_sequence)


def in_pieces(n_frames):
    """Until the context is left, a reading comes in pieces of so many frames."""
    return patch("dlgmd_cli.runs.reading.PIECE_FRAMES", n_frames)


@given(rows, st.integers(1, 20), st.integers(1, 4), st.booleans())
def test_pieces_are_those_of_the_whole(rows, n_frames, n_sp, by_sequence):
    reading = reading_of(rows, n_sp, by_sequence)
    with in_pieces(n_frames):
        pieces, again = list(reading), list(reading)
    whole = reading.whole()
    assert [len(piece.frame) for piece in pieces[:-1]] == [n_frames] * (len(pieces) - 1)
    for name in (field.name for field in fields(Result)):
        expected = getattr(whole, name)
        for found in (pieces, again):
            joined = np.concatenate([getattr(piece, name) for piece in found])
            assert joined.dtype == expected.dtype
            assert np.array_equal(joined, expected, equal_nan=expected.dtype == np.float64)
    assert Summary.of(pieces).to_dict() == summarise(whole)
    assert Summary.of(pieces).doubts() == doubts(whole)


@given(rows, st.integers(1, 4), st.booleans())
def test_the_whole_is_what_its_definition_says(rows, n_sp, by_sequence):
    result, in_a_row = reading_of(rows, n_sp, by_sequence).whole(), 0
    valid = [mp for _, mp in rows if not math.isnan(mp)]
    for row, (_, mp) in enumerate(rows):
        spread = max(valid) - min(valid) if valid else 0.0
        in_sequence = (mp - min(valid)) / spread if spread and not math.isnan(mp) else NAN
        assert result.mp_abs[row] == pytest.approx(mp / 3 / (mp / 3 + 1.0), nan_ok=True)
        assert result.mp_seq[row] == pytest.approx(in_sequence, nan_ok=True)
        level = result.mp_seq[row] if by_sequence else result.mp_abs[row]
        in_a_row = in_a_row + 1 if level >= 0.5 else 0
        assert result.spike[row] == (in_a_row > 0)
        assert result.collision[row] == (in_a_row >= n_sp)
    summary, alarm = summarise(result), result.collision.tolist()
    assert summary["spikes"] == result.spike.sum()
    assert summary["collisions"] == sum(
        now and not before for now, before in zip(alarm, [False, *alarm], strict=False)
    )
    passing = [db for db in result.attenuation_db if math.isfinite(db)]
    mean = math.fsum(passing) / len(passing) if passing else None
    assert summary["mean_attenuation_db"] == mean


def test_an_alarm_over_many_pieces_is_one():
    rows = [(1.0, 9.0)] * 10 + [(1.0, 0.0)] + [(1.0, 9.0)] * 3
    with in_pieces(2):
        summary = Summary.of(reading_of(rows, n_sp=3)).to_dict()
    assert summary["collisions"] == 2 and summary["first_collision_frame"] == 5 + 2
    assert summary["spikes"] == 13 and summary["mp_max_frame"] == 5


def test_tables_of_pieces_are_those_of_the_whole(tmp_path):
    rng = np.random.default_rng(1)
    reading = reading_of([(NAN, NAN)] * 3 + rng.gamma(2.0, 2.0, (200, 2)).tolist())
    for name, n_frames in (("whole", 1000), ("pieces", 7)):
        (tmp_path / name).mkdir()
        with in_pieces(n_frames):
            write_tables(tmp_path / name, reading)
    assert sorted(os.listdir(tmp_path / "pieces")) == sorted(TABLES)
    for table in TABLES:
        text = (tmp_path / "pieces" / table).read_text()
        assert text == (tmp_path / "whole" / table).read_text()
        assert text.count("\n") == 204


def test_a_run_in_pieces_gives_the_files_of_a_run_at_once(dlgmd, clips, tmp_path):
    records = []
    for out, n_frames in (("whole", 1000), ("pieces", 3)):
        with ExitStack() as stack:
            stack.enter_context(in_pieces(n_frames))
            stack.enter_context(
                patch("dlgmd_cli.runs.recording.MAX_FRAMES_IN_MEMORY", 4 * n_frames)
            )
            result = dlgmd("run", clips / "loom.avi", "--normalise", "sequence", "--out", out)
        assert result.exit_code == 0, result.output
        records.append(yaml.safe_load((tmp_path / out / "loom/run.yaml").read_text()))
    assert records[0] == records[1]
    whole, pieces = tmp_path / "whole/loom", tmp_path / "pieces/loom"
    assert set(os.listdir(whole)) == set(os.listdir(pieces)) > {"mp.png", *TABLES}
    for name in os.listdir(whole):
        assert (whole / name).read_bytes() == (pieces / name).read_bytes(), name
