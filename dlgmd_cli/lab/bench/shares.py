"""The onset of an alarm of `dlgmd live` on a computer that leaves it a share of one core."""

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from statistics import median
from typing import NamedTuple

from dlgmd_cli import run

# The period (s) of the duty cycle: the process runs for a share of each period, on one core, and is
# stopped (SIGSTOP) for the rest.
PERIOD_S = 0.1


class Watched(NamedTuple):
    """What a watch of a video answered.

    Attributes
    ----------
    onset_s : float
        When the first alarm came, by the video's clock: the time of its frame and its latency; NaN
        without an alarm.
    answered_fps : float
        Answers per second until then, or until the end.
    left_out : float
        Share of these answers in which something was left out.
    """

    onset_s: float
    answered_fps: float
    left_out: float


def onset_of_run(video: str) -> float:
    """The first onset in seconds that `run` finds; NaN for none."""
    onset_s = run(video).summary["first_alarm_time_s"]
    return math.nan if onset_s is None else float(onset_s)


def watched(video: str, share: float) -> Watched:
    """Watch a video at its own pace with a share of one core, until the first alarm."""
    command = [sys.executable, "-m", "dlgmd_cli", "live", video, "--realtime", "--jsonl"]
    core = min(os.sched_getaffinity(0))
    rows: list[dict[str, float]] = []
    onset_s = math.nan
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: os.sched_setaffinity(0, {core}),
    ) as process:
        assert process.stdout is not None
        first = json.loads(process.stdout.readline() or "{}")
        with limited(process, share):
            for line in process.stdout:
                row = json.loads(line)
                if row["latency_ms"] is not None:
                    rows.append(row)
                if row.get("event") == "begin":
                    onset_s = row["time_s"] + row["latency_ms"] / 1e3
                    break
        process.kill()
    if not rows:
        return Watched(math.nan, math.nan, math.nan)
    seconds = rows[-1]["time_s"] - first["time_s"]
    n_left_out = sum("left_out" in row for row in rows)
    return Watched(onset_s, len(rows) / max(seconds, 1e-6), n_left_out / len(rows))


@contextmanager
def limited(process: subprocess.Popen[bytes], share: float) -> Iterator[None]:
    """A context in which a process runs for a share of the time."""
    is_over = threading.Event()

    def work() -> None:
        while not is_over.is_set():
            process.send_signal(signal.SIGSTOP)
            is_over.wait((1.0 - share) * PERIOD_S)
            process.send_signal(signal.SIGCONT)
            time.sleep(share * PERIOD_S)

    thread = threading.Thread(target=work)
    if share < 1.0:
        thread.start()
    try:
        yield
    finally:
        is_over.set()
        if share < 1.0:
            thread.join()


def medians(video: str, share: float, repeats: int) -> Watched:
    """The medians of several watches; a watch without an alarm counts as an infinite onset."""
    found = [watched(video, share) for _ in range(repeats)]
    onset_s = median(math.inf if math.isnan(one.onset_s) else one.onset_s for one in found)
    rest = [[one[place] for one in found] for place in (1, 2)]
    return Watched(onset_s, *map(median, rest))
