"""A recording holds every row whole and once, in memory or on disk, whatever happens."""

import gc
import os
import sys
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dlgmd_cli.models.base import Response
from dlgmd_cli.runs import recording as module
from dlgmd_cli.runs.recording import Recording
from dlgmd_cli.video.frames import Frame

IN_MEMORY = 8
PICTURE = np.empty((0, 0), np.uint8)


@pytest.fixture(autouse=True)
def little_memory(monkeypatch):
    monkeypatch.setattr(module, "MAX_FRAMES_IN_MEMORY", IN_MEMORY)


def append(recording, number):
    """Add a row of which every value tells the number."""
    mp = np.nan if number % 3 == 0 else number + 0.75
    response = Response(p_sum=number + 0.25, s_sum=number + 0.5, mp=mp, ffi=0.0, t_de=0.0)
    recording.append(Frame(number, number / 32, PICTURE), response)


def numbers(recording):
    """The numbers of the rows, each checked to be whole."""
    frame, time_s, p_sum, s_sum, attenuation_db, mp = recording.columns()
    assert np.array_equal(time_s, frame / 32)
    assert np.array_equal(p_sum, frame + 0.25) and np.array_equal(s_sum, frame + 0.5)
    assert np.allclose(attenuation_db, 10 * np.log10(s_sum / p_sum))
    assert np.array_equal(mp, np.where(frame % 3 == 0, np.nan, frame + 0.75), equal_nan=True)
    return frame.astype(int).tolist()


def filled(n_frames):
    recording = Recording()
    for number in range(n_frames):
        append(recording, number)
    return recording


changes = st.lists(
    st.tuples(st.just("append"), st.integers(1, 30)) | st.tuples(st.just("cut"), st.integers(0, 60))
)


@given(changes, st.integers(1, 20))
def test_it_is_a_list_of_rows(changes, n_frames):
    recording, rows, count = Recording(), [], 0
    for change, n in changes:
        if change == "cut":
            recording.cut(n)
            del rows[n:]
            continue
        for _ in range(n):
            append(recording, count)
            rows.append(count)
            count += 1
    assert len(recording) == len(rows) and numbers(recording) == rows
    assert recording.n_valid == sum(number % 3 > 0 for number in rows)
    pieces = list(recording.pieces(n_frames))
    assert [piece.shape[1] for piece in pieces[:-1]] == [n_frames] * (len(pieces) - 1)
    joined = np.concatenate([*pieces, np.empty((6, 0))], axis=1)
    assert np.array_equal(joined, recording.columns(), equal_nan=True)


@contextmanager
def interrupted_at(step):
    """Ctrl-C before one of the bytecodes of the module, counted from 0; yields what is left."""
    left = [step]

    def trace(frame, event, _):
        if frame.f_code.co_filename != module.__file__:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            left[0] -= 1
            if left[0] == -1:
                raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        yield left
    finally:
        sys.settrace(before)


@pytest.mark.filterwarnings("ignore:unclosed file")
@pytest.mark.parametrize("n_before", [3, IN_MEMORY, 3 * IN_MEMORY])
def test_an_interrupt_at_any_bytecode_finds_every_row_whole_and_once(n_before):
    step, found, ends = 0, set(), False
    while not ends:
        recording = filled(n_before)
        with interrupted_at(step) as left:
            try:
                append(recording, n_before)
                ends = left[0] >= 0
            except KeyboardInterrupt:
                pass
        n_found = len(recording)
        found.add(n_found)
        assert numbers(recording) == list(range(n_found))
        for number in range(n_found, n_before + 2 * IN_MEMORY):
            append(recording, number)
        assert numbers(recording) == list(range(n_before + 2 * IN_MEMORY))
        step += 1
    assert found == {n_before, n_before + 1} and step > 30


def test_a_short_one_never_touches_the_disk(monkeypatch):
    asked = []
    monkeypatch.setattr(module.tempfile, "TemporaryFile", lambda **_: asked.append(1))
    assert numbers(filled(IN_MEMORY)) == list(range(IN_MEMORY))
    assert asked == []


def test_without_a_place_for_the_file_all_stays_in_memory(monkeypatch):
    asked = []

    def full(**_):
        asked.append(1)
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(module.tempfile, "TemporaryFile", full)
        recording = filled(5 * IN_MEMORY)
    assert len(asked) == 4  # not with every frame
    assert numbers(recording) == list(range(5 * IN_MEMORY))
    append(recording, 5 * IN_MEMORY)
    assert len(recording._kept.newest) == module._COLUMNS
    assert numbers(recording) == list(range(5 * IN_MEMORY + 1))


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such limits on Windows")
def test_what_does_not_fit_into_the_file_stays_in_memory():
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    recording = filled(IN_MEMORY + 1)
    size = os.fstat(recording._file.fileno()).st_size
    # A file may grow by two and a half rows more.
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 120, before[1]))
    try:
        for number in range(IN_MEMORY + 1, 4 * IN_MEMORY):
            append(recording, number)
        assert os.fstat(recording._file.fileno()).st_size == size
        assert numbers(recording) == list(range(4 * IN_MEMORY))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    for number in range(4 * IN_MEMORY, 6 * IN_MEMORY):
        append(recording, number)
    assert os.fstat(recording._file.fileno()).st_size > size
    assert numbers(recording) == list(range(6 * IN_MEMORY))


def test_a_file_that_was_cut_is_an_error_not_a_wrong_row():
    recording = filled(3 * IN_MEMORY)
    recording._file.truncate(100)
    with pytest.raises(OSError, match="was cut"):
        recording.columns()


@pytest.mark.skipif(sys.platform != "linux", reason="/proc lists open files on Linux only")
def test_the_file_has_no_name_and_goes_with_the_recording(monkeypatch, tmp_path):
    monkeypatch.setattr(module.tempfile, "tempdir", str(tmp_path))
    n_open = len(os.listdir("/proc/self/fd"))
    recording = filled(3 * IN_MEMORY)
    assert os.listdir(tmp_path) == []
    assert len(os.listdir("/proc/self/fd")) == n_open + 1
    del recording
    gc.collect()
    assert len(os.listdir("/proc/self/fd")) == n_open
