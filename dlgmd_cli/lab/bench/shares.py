"""The onset of an alarm of `dlgmd live` on a computer that leaves it a share of one core."""

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median
from typing import NamedTuple

from dlgmd_cli import run
from dlgmd_cli.results.outcome import Outcome, Shown

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


@dataclass(eq=False)
class Onsets(Outcome):
    """Onsets of the first alarm; `rows` has the percent of a core -> medians of the watches."""

    TABLES = ("onsets.csv",)

    run_s: float
    rows: dict[int, Watched]

    def cells(self) -> dict[str, tuple[list[str], list[list[float | str | None]]]]:
        """The rows as `onsets.csv` has them."""
        header = ["percent", "run_onset_s", "onset_s", "answered_fps", "left_out"]
        table: list[list[float | str | None]] = [
            [percent, self.run_s, *one] for percent, one in self.rows.items()
        ]
        return {"onsets.csv": (header, table)}

    def shown(self) -> Iterator[Shown]:
        """The table, and the path of its file if there is one."""
        lines = [
            (f"{percent}", *(f"{number:.2f}" for number in (self.run_s, *one)))
            for percent, one in self.rows.items()
        ]
        yield ("% of a core", "run s", "live s", "answered/s", "left out"), lines
        yield from self.paths


def onsets(
    video: str,
    percents: Iterable[int],
    repeats: int,
    on_pass: Callable[[int], object] = lambda n_done: None,
) -> Onsets:
    """Watch a video with shares of one core; a watch without an alarm has an infinite onset."""
    rows: dict[int, Watched] = {}
    n_done = 0
    for percent in percents:
        found = []
        for _ in range(repeats):
            found.append(watched(video, percent / 100.0))
            on_pass(n_done := n_done + 1)
        onset_s = median(math.inf if math.isnan(one.onset_s) else one.onset_s for one in found)
        rates, shares = ([one[place] for one in found] for place in (1, 2))
        rows[percent] = Watched(onset_s, median(rates), median(shares))
    return Onsets(onset_of_run(video), rows)


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
        process.stdout.readline()  # it has begun
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
    n_left_out = sum("left_out" in row for row in rows)
    # Times count from the first frame.
    return Watched(onset_s, len(rows) / max(rows[-1]["time_s"], 1e-6), n_left_out / len(rows))


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
