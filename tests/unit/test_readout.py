"""Normalisation, spikes and collisions."""

import numpy as np
from dlgmd_cli.models.readout import (
    in_a_row,
    normalise_absolute,
    normalise_sequence,
    read_out,
    spikes,
)
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

NAN = np.nan
potentials = arrays(np.float64, st.integers(1, 30), elements=st.floats(0, 1e6))


def test_absolute_is_half_at_kappa():
    mp = np.array([NAN, 0.0, 3.0, 9.0])
    assert np.allclose(normalise_absolute(mp, 1000, 0.003), [NAN, 0, 0.5, 0.75], equal_nan=True)


def test_absolute_does_not_depend_on_size():
    assert normalise_absolute(np.array([5.0]), 100, 0.01) == normalise_absolute(
        np.array([20.0]), 400, 0.01
    )


@given(potentials)
def test_absolute_is_causal_and_bounded(mp):
    whole = normalise_absolute(mp, 64, 0.003)
    assert np.all((whole >= 0) & (whole <= 1))
    assert np.array_equal(whole[: len(mp) // 2], normalise_absolute(mp[: len(mp) // 2], 64, 0.003))


def test_sequence_spans_zero_to_one_over_valid_frames():
    mp = np.array([NAN, NAN, 4.0, 2.0, 6.0])
    assert np.array_equal(normalise_sequence(mp), [NAN, NAN, 0.5, 0.0, 1.0], equal_nan=True)


def test_sequence_of_a_still_scene_is_undefined():
    assert np.isnan(normalise_sequence(np.array([NAN, 0.0, 0.0]))).all()
    assert np.isnan(normalise_sequence(np.array([NAN, NAN]))).all()


def test_a_spike_is_at_or_above_the_threshold():
    level = np.array([NAN, 0.39999, 0.4, 0.5])
    assert spikes(level, 0.4).tolist() == [False, False, True, True]


def test_collision_needs_n_sp_in_a_row():
    spike = np.array([1, 0, 1, 1, 1, 0, 1, 1], bool)
    assert in_a_row(spike).tolist() == [1, 0, 1, 2, 3, 0, 1, 2]
    for n_sp in (1, 2, 3):
        readout = read_out(
            spike.astype(float), 1, kappa=1.0, threshold=0.5, n_sp=n_sp, by_sequence=False
        )
        assert readout.collision.tolist() == [n >= n_sp for n in (1, 0, 1, 2, 3, 0, 1, 2)]


def test_which_normalisation_drives_the_spikes():
    mp = np.array([NAN, 0.0, 1.0, 2.0])
    options = {"kappa": 1.0, "threshold": 0.9, "n_sp": 1}
    by_sequence = read_out(mp, 1, by_sequence=True, **options)
    absolute = read_out(mp, 1, by_sequence=False, **options)
    assert by_sequence.spike.tolist() == [False, False, False, True]
    assert not absolute.spike.any()
    assert np.array_equal(by_sequence.level, by_sequence.mp_seq, equal_nan=True)
    assert np.array_equal(absolute.level, absolute.mp_abs, equal_nan=True)
