"""Times at which frames arrive that were captured evenly."""

import numpy as np


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
