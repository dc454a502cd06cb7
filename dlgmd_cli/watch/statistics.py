"""Numbers of a session of `dlgmd live`: answers, alarms, latencies."""

import logging
import math
import time
from collections import deque
from itertools import islice

import numpy as np

from dlgmd_cli.watch.load import RATE, in_words
from dlgmd_cli.watch.watch import BEGIN, Answer

_log = logging.getLogger(__name__)

# Number of latencies for percentiles: one hour, or recently ten seconds, at 30 frames/s.
_N_LATENCIES = 108_000
_N_LATELY = 300


class Statistics:
    """Numbers of a session, in constant memory.

    Attributes
    ----------
    n_frames, n_alarms : int
        Numbers of answers to frames, and of alarms.
    newest : Answer or None
        The last answer; None before the first.
    busy : str
        What a busy computer leaves out, in words; empty for nothing.
    protects : bool
        Whether enough frames are answered.
    """

    def __init__(self) -> None:
        self.n_frames = self.n_alarms = 0
        self.newest: Answer | None = None
        self.busy, self.protects = "", True
        self._latencies_ms: deque[float] = deque(maxlen=_N_LATENCIES)
        self._lately: deque[float] = deque(maxlen=60)

    def put(self, answer: Answer) -> None:
        """Count an answer or an event."""
        self.newest = answer
        if answer.event == RATE:
            self.busy = in_words(answer.report)
            self.protects = bool(answer.report["protects"])
        if not answer.is_of_frame:
            return
        self.n_frames += 1
        self.n_alarms += answer.event == BEGIN
        if answer.event:
            _log.debug("%s", answer.to_json())
        self._latencies_ms.append(answer.latency_ms)
        self._lately.append(time.monotonic())

    @property
    def fps(self) -> float:
        """Answers per second, over the last 60 answers; NaN before there are two."""
        if len(self._lately) < 2:
            return math.nan
        # Until now, so that the rate falls if the source stalls.
        return (len(self._lately) - 1) / max(time.monotonic() - self._lately[0], 1e-6)

    def latency_ms(self, *, lately: bool = False) -> tuple[float, float]:
        """Median and 99th percentile over the last hour, or over 10 s; NaN without frames."""
        values = list(islice(reversed(self._latencies_ms), _N_LATELY if lately else None))
        if not values:
            return math.nan, math.nan
        median, high = np.percentile(values, (50, 99))
        return float(median), float(high)
