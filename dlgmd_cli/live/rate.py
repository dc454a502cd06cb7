"""The rates of frames and of answers, and warnings if a rate does not fit the model."""

import logging
from collections import deque
from collections.abc import Sequence

import numpy as np

from dlgmd_cli.errors import Once, argument
from dlgmd_cli.frame import GAP_INTERVALS, Frame, Series
from dlgmd_cli.models.rules import Rule
from dlgmd_cli.results.result import too_slow
from dlgmd_cli.video.live_source import LiveSource

_log = logging.getLogger(__name__)

# The rate is measured over N_RATE answers. It is unfit if it differs by more than _OTHER_RATE.
N_RATE, _OTHER_RATE = 60, 1.25
# The model is slow if an answer takes more than this share of the time between frames, and the
# processor works for more than this share of the answer's time.
_BUSY = 0.5


class Rate:
    """Warns once if frames come, or are answered, at a rate that the model is not designed for.

    Also warns once if the rate is too low for the alarm's `rule`.
    """

    def __init__(self, source: LiveSource, rule: Rule) -> None:
        self._source, self._rule, self._told = source, rule, Once()
        self._answered: deque[tuple[float, ...]] = deque(maxlen=N_RATE + 1)

    def reset(self) -> None:
        """Start again after a long time without frames."""
        self._answered.clear()

    def step(self, frame: Frame, spent_s: tuple[float, float]) -> None:
        """Count an answered frame, with the time and processor time (s) spent on the answer."""
        source = self._source
        self._answered.append((frame.time_s, frame.is_repeat, source.n_dropped, *spent_s))
        if len(self._answered) <= N_RATE:
            return
        times_s, repeats, dropped, *spent = np.transpose(self._answered)
        warnings = {
            "model": self._unfit(times_s, int(dropped[-1] - dropped[0]), spent),
            "rule": too_slow(self._rule, times_s[repeats == 0.0]),
        }
        for topic, warning in warnings.items():
            if warning and self._told.is_new(topic):
                _log.warning("%s: %s", source.name, warning)

    def _unfit(self, times_s: Series, n_dropped: int, spent: Sequence[Series]) -> str:
        """How the rate differs from the model's rate; empty if it fits."""
        design = self._source.model_fps
        # Without gaps, such as when a file starts again.
        steps_s = np.diff(times_s)
        usual_s = float(steps_s[steps_s <= GAP_INTERVALS * np.median(steps_s)].mean())
        fps = 1.0 / max(usual_s, 1e-6)
        if design / _OTHER_RATE <= fps <= design * _OTHER_RATE:
            return ""
        came = f"frames come at {fps:.3g} a second, but the parameters are made for {design:g}"
        if fps > design:
            return f"{came}; leave some out ({argument('fps')})"
        if fps * (1.0 + n_dropped / N_RATE) < design / _OTHER_RATE:
            return f"{came}; an approach looks faster than it is"
        what = f"too slow here: {fps:.3g} frames a second are answered, and {n_dropped} of"
        return f"{what} {n_dropped + N_RATE} dropped; {self._why(*np.mean(spent, axis=1))}"

    def _why(self, took_s: float, busy_s: float) -> str:
        """The cause of slow answers, from the mean time and processor time (s) per frame."""
        takes = f"the model takes {1e3 * took_s:.3g} ms a frame"
        if took_s * self._source.model_fps < _BUSY:
            return f"{takes}, the rest goes to reading the source, or to other programs"
        if busy_s < _BUSY * took_s:
            return f"{takes}, but other programs hold the processor most of that time"
        return f"{takes}; give it smaller frames ({argument('size')})"
