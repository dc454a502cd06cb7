"""Times at which frames arrive that were captured evenly, and the alarm at such times."""

import warnings
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from dlgmd_cli import Alarm


def stalled(fps, stall_s, n_frames=300, burst_s=0.001):
    """Times of capture, and of arrival over a link that stalls once a second and loses nothing."""
    captured = np.arange(n_frames) / fps
    came = captured + 0.02
    for second in range(1, int(n_frames / fps)):
        waits = (captured >= second) & (captured < second + stall_s)
        came[waits] = second + stall_s + 0.02 + burst_s * np.arange(waits.sum())
    return captured, np.maximum.accumulate(came)


def in_bursts(n_frames, fps, size, gap_s):
    """Times of arrival where the frames of a burst wait for its last one, from frame 0."""
    number = np.arange(n_frames)
    return (number // size * size + size - 1) / fps + gap_s * (number % size)


def at_beacons(n_frames, fps, gap_s, beacon_s=0.1024):
    """Times of arrival over Wi-Fi that saves power: what waits is sent at the next beacon."""
    times = np.ceil((np.arange(n_frames) / fps - 0.02) / beacon_s) * beacon_s + 0.02
    for number in range(1, n_frames):
        times[number] = max(times[number], times[number - 1] + gap_s)
    return times


def in_jitter(n_frames, fps, most_s, seed=0):
    """Times of arrival of frames that are late at random, and stay in their order."""
    late_s = np.random.default_rng(seed).uniform(0.0, most_s, n_frames)
    return np.maximum.accumulate(np.arange(n_frames) / fps + late_s)


def arriving(n_frames, fps, way, gap_s):
    """Times of arrival in bursts of so many, over Wi-Fi that saves power, or late at random."""
    if way == "jitter":
        return in_jitter(n_frames, fps, 4.0 * gap_s)
    if way == "beacons":
        return at_beacons(n_frames, fps, gap_s)
    return in_bursts(n_frames, fps, way, gap_s)


class Watched(NamedTuple):
    """The first frame with an alarm, if any; which frames were left out; whether the images
    counted as bad."""

    first: int | None
    left_out: np.ndarray
    is_blind: bool


def watched(frames, times_s, **options):
    """What an alarm makes of frames at these times."""
    alarm = Alarm(**options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        answers = [alarm.step(*one) for one in zip(frames, times_s.tolist(), strict=True)]
    first = next((number for number, answer in enumerate(answers) if answer.alarm), None)
    is_left_out = [answer is before for before, answer in pairwise(answers)]
    left_out = 1 + np.flatnonzero(is_left_out)
    return Watched(
        first, left_out, any(answer.blind not in ("", "unmeasured") for answer in answers)
    )
