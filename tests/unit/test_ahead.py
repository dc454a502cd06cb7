"""Reading ahead changes when things happen, never what happens."""

import threading
import time

import cv2
import numpy as np
import pytest

from dlgmd_cli import DLGMD, open_video
from dlgmd_cli.runs.recording import Recording
from dlgmd_cli.runs.single import run
from dlgmd_cli.video.prefetch import ReadAhead, opencv_threads


def threads():
    return [thread for thread in threading.enumerate() if thread.name == "dlgmd-decode"]


@pytest.fixture(autouse=True)
def no_thread_is_left():
    yield
    assert threads() == []


@pytest.mark.parametrize("n_items", [0, 1, 3, 100])
def test_same_items_in_the_same_order(n_items):
    with ReadAhead(range(n_items)) as items:
        assert list(items) == list(range(n_items))


def test_never_further_ahead_than_asked():
    taken = []

    def source():
        for number in range(50):
            taken.append(number)
            yield number

    with ReadAhead(source(), depth=3) as items:
        for number in items:
            time.sleep(0.002)
            # Three wait in the queue, and one more in the hand of the thread.
            assert len(taken) <= number + 1 + 3 + 1


def test_an_error_comes_after_what_was_before_it():
    def source():
        yield from range(5)
        raise OSError("damaged")

    seen = []
    with pytest.raises(OSError, match="damaged"), ReadAhead(source()) as items:
        for item in items:
            seen.append(item)
    assert seen == list(range(5))


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_an_error_of_the_consumer_stops_the_thread(error):
    def endless():
        number = 0
        while True:
            yield number
            number += 1

    with pytest.raises(error), ReadAhead(endless()) as items:
        for number in items:
            if number == 20:
                raise error


def test_leaving_without_reading():
    with ReadAhead(range(1000)):
        pass


@pytest.mark.parametrize("scale", [1.0, 0.5])  # prepared on either side of the queue
def test_run_gives_what_a_plain_loop_gives(clips, scale):
    model, plain, ahead = DLGMD(), Recording(), Recording()
    with open_video(clips / "loom.avi", scale=scale) as source:
        for frame in source:
            plain.append(frame, model.step(frame.grey))
    counts = []
    with open_video(clips / "loom.avi", scale=scale) as source:
        run(source, model, ahead, counts.append)
    assert np.array_equal(plain.columns(), ahead.columns(), equal_nan=True)
    assert len(counts) == len(ahead) and counts == sorted(counts)


def test_run_keeps_what_came_before_an_error(clips):
    class Breaks(DLGMD):
        def step(self, luminance, *, layers=False):
            if len(recording) == 7:
                raise KeyboardInterrupt
            return super().step(luminance, layers=layers)

    recording = Recording()
    with open_video(clips / "loom.avi") as source, pytest.raises(KeyboardInterrupt):
        run(source, Breaks(), recording)
    assert len(recording) == 7


def test_the_host_s_threads_are_restored():
    before = cv2.getNumThreads()
    cv2.setNumThreads(3)
    try:
        with pytest.raises(ValueError), opencv_threads(1):
            assert cv2.getNumThreads() == 1
            raise ValueError
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)
