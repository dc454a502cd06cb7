"""Normalisation of the membrane potential, spikes and alarms, the same for every model."""

import logging
import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import (
    RATE_TOLERANCE,
    UNEVEN_S,
    CaptureClock,
    Flags,
    Frame,
    GapDetector,
    RepeatDetector,
    Series,
    resized,
    small_wh,
    steady_step,
)
from dlgmd_cli.models.base import Grey, Response, create_model
from dlgmd_cli.models.expansion import Expansion, Measured
from dlgmd_cli.models.health import Health
from dlgmd_cli.models.step import Stepper
from dlgmd_cli.parameters.checks import Spec
from dlgmd_cli.parameters.keys import SPIKES, TTC, Parameters
from dlgmd_cli.parameters.presets import config_of, parameters_of

_log = logging.getLogger(__name__)

Potential = TypeVar("Potential", float, Series)

# K of a single cell for a change of one grey level, in luminance². A lower peak is due to rounding;
# for a receding object, the EMD-LGMD's is 6e-7.
LEAST_PEAK = 1.0 / 255.0**2
# An alarm that begins within this time after the end of another belongs to it.
MERGE_S = 0.3
# Tolerance for rounding in differences of times, such as 0.5 - 0.2.
ROUNDING_S = 1e-6
# The name of the size at which the expansion is measured, among those of a frame.
_SMALL = (0, 0)
# Where the middle third of the image ends, in halves of its sides from its centre.
_THIRD = 1.0 / 3.0
# Frames come at another rate if it differs by more than this factor, over so many intervals: 24 to
# 37.5 a second are as good as 30.
_OTHER_RATE, _N_INTERVALS = 1.25, 30


def absolute(mp: Potential, n_cells: int, kappa: float | None) -> Potential:
    """Membrane potential normalised online, in [0, 1) and comparable between videos.

    Parameters
    ----------
    mp : float or ndarray, shape (n,)
        Raw membrane potential K, not negative; NaN where undefined.
    n_cells : int
        Cells (pixels) that K sums over.
    kappa : float or None
        Half-saturation constant, a mean excitation per cell; None for the LGMD's own sigmoid.

    Returns
    -------
    float or ndarray, shape (n,)
        With κ̂ = K / n_cells: κ̂ / (κ̂ + κ), or 1 / (1 + exp(-κ̂)) in [0.5, 1), [Yue2006];
        NaN where `mp` is.
    """
    excitation = mp / n_cells
    if kappa is None:
        return 1.0 / (1.0 + np.exp(-excitation))
    return excitation / (excitation + kappa)


def sequence(mp: Series) -> Series:
    """Membrane potential by the min–max of its whole sequence, in [0, 1]; offline.

    Parameters
    ----------
    mp : ndarray, shape (n,)
        Raw membrane potential K of the whole sequence; NaN where undefined.

    Returns
    -------
    ndarray, shape (n,)
        (K - min K) / (max K - min K), as in the paper's figures; NaN where `mp` is, and
        everywhere if K never changes or stays below `LEAST_PEAK`.
    """
    low = float(np.fmin.reduce(mp, initial=np.nan))
    high = float(np.fmax.reduce(mp, initial=np.nan))
    if not high > low or high < LEAST_PEAK:
        return np.full_like(mp, np.nan)
    return (mp - low) / (high - low)


class Rule:
    """The rule of an alarm, beside a model and the expansion: it turns either into alarms.

    With the rule `spikes`, the alarm is on after `n_sp` spikes in a row, [Zhao2023] Eq. (15). With
    `ttc`, it is on while the time to contact is `ttc_alarm` or less.

    Parameters
    ----------
    params : Parameters
        `alarm` is the rule; `t_mp` is T_MP, the level of a spike, Eq. (14).
    """

    def __init__(self, params: Parameters) -> None:
        self.name, self.t_mp, self.ttc_alarm = params.alarm, params.t_mp, params.ttc_alarm
        self.n_in_a_row = params.n_sp if self.name == SPIKES else 1
        self.reset()

    @property
    def text(self) -> str:
        """The rule in words."""
        if self.name == TTC:
            return f"ttc: time to contact of {self.ttc_alarm:g} s or less"
        return f"spikes: {self.n_in_a_row} in a row, at an MP of {self.t_mp:g} or more"

    def reset(self) -> None:
        """Forget all earlier frames."""
        self._in_a_row = 0

    def step(self, level: float, ttc_s: float) -> tuple[bool, bool]:
        """Whether a frame is a spike, and whether the alarm is on; NaN is neither.

        `level` is the normalised membrane potential, `ttc_s` the time to contact in seconds.
        """
        spike = bool(level >= self.t_mp)
        is_on = spike if self.name == SPIKES else ttc_s <= self.ttc_alarm
        self._in_a_row = self._in_a_row + 1 if is_on else 0
        return spike, self._in_a_row >= self.n_in_a_row

    def detect(self, levels: Series, ttc_s: Series) -> tuple[Flags, Flags]:
        """Spikes and alarms of a whole sequence, shape (n,) each; see `step`."""
        self.reset()
        flags = np.array([*map(self.step, levels.tolist(), ttc_s.tolist())], np.bool_)
        spikes, alarms = flags.reshape(-1, 2).T.copy()
        return spikes, alarms


def spans(alarms: Flags, time_s: Series) -> npt.NDArray[np.intp]:
    """First and last row of every alarm; pauses shorter than `MERGE_S` do not end one.

    Parameters
    ----------
    alarms : ndarray, shape (n,), bool
        Where the alarm is on.
    time_s : ndarray, shape (n,)
        Non-decreasing times of the rows, in seconds.

    Returns
    -------
    ndarray of int, shape (n_alarms, 2)
        Rows where the alarm turns on after it was off for `MERGE_S` at least, and the rows where it
        is on for the last time. The former are causal: they do not depend on later rows.
    """
    on = np.flatnonzero(alarms)
    is_new = np.ones(len(on), np.bool_)
    if len(on):
        pause_s = np.diff(time_s[on])
        is_new[1:] = (np.diff(on) > 1) & (pause_s >= MERGE_S - ROUNDING_S)
    return np.column_stack((on[is_new], on[np.roll(is_new, -1)]))


def side_of(g_x: float, g_y: float) -> str:
    """The third of the image that a centroid lies in.

    Parameters
    ----------
    g_x, g_y : float
        Centroid, from -1 (left, top) to 1; NaN where undefined.

    Returns
    -------
    str
        `left` (g_x below -1/3), `ahead` or `right` (above 1/3), followed by ``high`` (g_y below
        -1/3) or ``low`` (above 1/3) outside the middle third, such as ``left high``; empty if the
        centroid is undefined.
    """
    if math.isnan(g_x) or math.isnan(g_y):
        return ""
    across = "left" if g_x < -_THIRD else "right" if g_x > _THIRD else "ahead"
    return across + (" high" if g_y < -_THIRD else " low" if g_y > _THIRD else "")


def side_by(rule: str, places: Any) -> str:
    """The `side_of` what a rule goes by: the active cells, or the part of the image that expands.

    `places` has their `g_x` and `g_y`, or its `expansion_x` and `expansion_y`.
    """
    if rule == SPIKES:
        return side_of(places.g_x, places.g_y)
    return side_of(places.expansion_x, places.expansion_y)


# The columns of alarms.csv.
ALARM_COLUMNS = (
    *("start_frame", "start_s", "end_frame", "end_s", "peak_mp_abs", "g_x", "g_y", "side", "ttc_s"),
    "rule",
)


class AlarmSpan(NamedTuple):
    """An alarm: when, how strong, and from where; a row of alarms.csv.

    Attributes
    ----------
    start_frame, start_s : int, float
        The frame that raises the alarm, and its time in seconds.
    end_frame, end_s : int, float
        The last frame at which the alarm is on.
    peak_mp_abs : float
        Greatest normalised membrane potential of the frames at which it is on.
    g_x, g_y : float
        Centroid of the active cells in the frame that raises the alarm, NaN if there are none.
    ttc_s : float
        Time to contact in that frame, in seconds; NaN where nothing expands.
    rule : str
        The rule that raises the alarm, see `Rule`.
    expansion_x, expansion_y : float
        Centre of the part of the image that expands in that frame, see `Measured`.
    """

    start_frame: int
    start_s: float
    end_frame: int
    end_s: float
    peak_mp_abs: float
    g_x: float = math.nan
    g_y: float = math.nan
    ttc_s: float = math.nan
    rule: str = SPIKES
    expansion_x: float = math.nan
    expansion_y: float = math.nan

    @property
    def side(self) -> str:
        """Where in the image it was raised, by what raised it, see `side_of`."""
        return side_by(self.rule, self)

    def to_dict(self) -> dict[str, Any]:
        """The columns of alarms.csv; None where a number is not defined."""
        values = {name: getattr(self, name) for name in ALARM_COLUMNS}
        return {k: None if v != v else v for k, v in values.items()}


@dataclass(frozen=True)
class Detection(Response):
    """A model's response to one frame, the expansion beside it, and what the rule makes of both.

    Attributes
    ----------
    expansion, ttc_s, expansion_x, expansion_y, ttc_share : float
        Expansion rate in 1/s, time to contact in seconds, where, and how good, see `Measured`.
    mp_abs : float
        Membrane potential normalised by `absolute`; NaN until defined.
    spike : bool
        Whether `mp_abs` reaches the threshold.
    alarm : bool
        Whether the alarm is on, see `Rule`.
    rule : str
        The rule of the alarm: `spikes` or `ttc`.
    blind : str or None
        Why the images show nothing, see `Health`: `black`, `flat`, `noise` or `frozen`. None if
        they are sound, or not bad for long enough. While it is set, no alarm is no all-clear.
    """

    expansion: float = math.nan
    ttc_s: float = math.nan
    expansion_x: float = math.nan
    expansion_y: float = math.nan
    ttc_share: float = math.nan
    mp_abs: float = math.nan
    spike: bool = False
    alarm: bool = False
    rule: str = SPIKES
    blind: str | None = None

    @property
    def side(self) -> str:
        """Where in the image what the rule goes by is, see `side_by`."""
        return side_by(self.rule, self)


class Alarm:
    """A model and the expansion with an alarm: causal, frame by frame, in constant memory.

    Parameters
    ----------
    model : optional
        What `run` takes: the number of a set, the name of a preset or a model, a class, parameters,
        or a YAML file. The default is the preset `flight`.
    resize : bool
        Reduce frames that are wider than `width_px` to it, as `dlgmd run` does. With False, frames
        are taken as they come.
    width_px, model_fps : int, float, optional
        Frame width and rate that the parameters are made for. The default is what the file says, or
        what the model's published values are made for: 240 px for `flight`, 480 px for the paper's
        sets, and 30 frames a second. Slower frames are a warning, see `logging`, once.
    all_frames : bool
        Process frames at any rate, and warn once of faster ones too. With False, only every k-th is
        processed if they come faster, by the rule of `dlgmd run`, once 30 intervals show the rate;
        the others have the answer of the last one that was.
    repeats : {"skip", "keep"}
        Treatment of duplicate frames: `skip` returns the previous response, `keep` passes them to
        the model.
    engine
        See `DLGMD`.
    times : {"arrival", "capture"}
        What the times of frames are. Of `arrival`, a clock recovers those of the capture, see
        `CaptureClock`; a burst of late frames is a warning, once. With `capture`, they are exact.
    expansion : Expansion, optional
        How the expansion is measured; with all corrections unless given.

    Attributes
    ----------
    model : Model
        The model that computes the membrane potential.
    rule : Rule
        The rule of the alarm; its `ttc_alarm` may change between frames.
    tells_rate : bool
        Whether a frame rate that the model is not made for is a warning; clear it where that is
        reported elsewhere.

    Examples
    --------
    >>> import numpy as np
    >>> alarm = Alarm()
    >>> alarm.step(np.zeros((1080, 1920, 3), np.uint8)).alarm
    False
    """

    def __init__(
        self,
        model: Any = None,
        *,
        resize: bool = True,
        width_px: int | None = None,
        model_fps: float | None = None,
        all_frames: bool = False,
        repeats: str = "skip",
        engine: str = "auto",
        times: str = "arrival",
        expansion: Expansion | None = None,
    ) -> None:
        Spec(str, choices=("skip", "keep")).check(repeats, "repeats")
        Spec(str, choices=("arrival", "capture")).check(times, "times")
        config = config_of(model)
        self.params = parameters_of(config)
        self._width_px = (width_px or config.width_px) if resize else None
        self._model_fps, self._all_frames = model_fps or config.model_fps, all_frames
        self._taken_s, self._least_s, self._every = math.nan, 0.0, 0
        self._clock = CaptureClock() if times == "arrival" else None
        self._health, self.tells_rate = Health(), True
        self._n_untimed, self._has_warned_of_delays = 0, False
        self._times: deque[tuple[float, bool]] = deque(maxlen=_N_INTERVALS + 1)
        self._has_warned = False
        self.model = create_model(self.params, engine=engine)
        self._stepper, self.rule = Stepper(self.model), Rule(self.params)
        self._expansion = Stepper(expansion or Expansion(), _SMALL)
        self._to_hide: Flags | None = None
        self._gaps, self._repeats = GapDetector(), RepeatDetector() if repeats == "skip" else None
        self._index, self._last = -1, Detection()

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        parts: Any = (self._stepper, self._expansion, self.rule, self._gaps, self._health)
        for part in (*parts, self._clock, self._repeats):
            if part is not None:
                part.reset()
        self._times.clear()
        self._taken_s, self._least_s, self._every = math.nan, 0.0, 0

    def ignore(self, hidden: Flags | None, small: Flags | None = None) -> None:
        """Ignore some cells of all frames, as they are reduced, from now on; see `Model.ignore`.

        `small` is the same for the image that the expansion is measured on, see `step`; it follows
        from `hidden` unless given.
        """
        self._stepper.ignore(hidden)
        self._expansion.ignore(small)
        self._to_hide = hidden if small is None else None
        self._health.ignore(hidden)
        if self._repeats is not None:
            self._repeats = RepeatDetector(hidden)

    def step(
        self,
        frame: Grey,
        time_s: float | None = None,
        *,
        layers: bool = False,
        small: Grey | None = None,
    ) -> Detection:
        """Process the next frame and say whether the alarm is on.

        After a gap in time, in which frames were lost, the model restarts: it has no response until
        its history is full again.

        Parameters
        ----------
        frame : ndarray, shape (H, W) or (H, W, 3), float32 or uint8
            Grey or BGR, as OpenCV's cameras give it: 0..1, or levels of 0..255.
        time_s : float, optional
            Time of the frame, such as that of its arrival, see `times`. Without it, the model takes
            its own rate for granted, and gaps go unnoticed; that is a warning, once.
        layers : bool
            Also return copies of P, S and G.
        small : ndarray, (h, w), float32 or uint8, optional
            The same frame in grey as `frame.small_wh` says, if it is reduced already.

        Raises
        ------
        FrameError
            If the frame is not such an image, or differs in size or type from the previous one.
        MissingExtraError
            If the requested engine needs a package that is not installed.
        """
        frame, small = self._reduced(frame, small)
        time_s = self._captured_s(time_s)
        is_gap = time_s is not None and self._gaps.step(time_s)
        is_repeat = self._repeats is not None and frame.ndim > 1 and self._repeats.step(frame)
        if time_s is not None:
            self._watch_rate(time_s, is_gap=is_gap, is_repeat=is_repeat)
        is_stale = self._clock is not None and self._clock.is_stale
        is_early = time_s is not None and 0.0 <= time_s - self._taken_s < self._least_s
        if is_stale or (not is_gap and not is_repeat and is_early):
            return self._last
        blind = self._health.step(frame, time_s) if frame.ndim == 2 and frame.size else None
        if is_gap:  # what comes after a gap is new, even if it looks the same
            self.rule.reset()
        elif is_repeat:
            if blind != self._last.blind:
                self._last = replace(self._last, blind=blind)
            return self._last
        self._index += 1
        self._taken_s = math.nan if time_s is None else time_s
        if small is not None and self._to_hide is not None:
            shown = resized(np.float32(self._to_hide), small.shape[::-1])
            self._expansion.ignore(shown > 0.0)
            self._to_hide = None
        others = {} if small is None else {_SMALL: small}
        numbered = Frame(self._index, self._taken_s, frame, after_gap=is_gap, others=others)
        response: Response = self._stepper.step(numbered, layers=layers)
        measured: Measured = Measured() if small is None else self._expansion.step(numbered)
        mp_abs = float(absolute(response.mp, self.model.n_cells, self.params.kappa))
        spike, alarm = self.rule.step(mp_abs, measured.ttc_s)
        facts = {**vars(response), **measured._asdict(), "rule": self.rule.name}
        self._last = Detection(**facts, mp_abs=mp_abs, spike=spike, alarm=alarm, blind=blind)
        return self._last

    def _captured_s(self, time_s: float | None) -> float | None:
        """When a frame was captured; warns once of missing times, and of late frames."""
        if time_s is None:
            self._n_untimed += 1
            if self._n_untimed == _N_INTERVALS and self.tells_rate:
                what = "frames have no times, so they count as %g a second; give step() the times"
                _log.warning(what, self._model_fps)
            return None
        if self._clock is None:
            return time_s
        captured_s = self._clock.step(time_s)
        if self._clock.latest_s > UNEVEN_S and not self._has_warned_of_delays:
            self._has_warned_of_delays = True
            what = "frames come unevenly, up to %.2f s late; the times of their capture are used"
            _log.warning(what, self._clock.latest_s)
        return captured_s

    def _reduced(self, frame: Grey, small: Grey | None) -> tuple[Grey, Grey | None]:
        """A frame in grey and of the model's width, and as the expansion needs it.

        The model refuses what is no image.
        """
        if frame.dtype not in (np.uint8, np.float32) or not frame.size:
            return frame, None
        if frame.ndim == 3 and frame.shape[2] == 3:
            frame = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        if frame.ndim != 2:
            return frame, None
        height, width = frame.shape
        if small is None:
            small = resized(frame, small_wh(width, height))
        if self._width_px is None or width <= self._width_px:
            return frame, small
        size_wh = self._width_px, max(1, round(height * self._width_px / width))
        return resized(frame, size_wh), small

    def _watch_rate(self, time_s: float, *, is_gap: bool, is_repeat: bool) -> None:
        """Find what frames to leave out, or warn once of a rate the model is not made for."""
        if is_gap:
            self._times.clear()
        self._times.append((time_s, is_repeat))
        duration_s = time_s - self._times[0][0]
        if len(self._times) <= _N_INTERVALS or not duration_s > 0.0:
            return
        # Duplicates do not make a camera faster, and a still scene does not make it slower.
        n_seen = _N_INTERVALS - sum(repeats for _, repeats in self._times)
        seen_fps, came_fps = n_seen / duration_s, _N_INTERVALS / duration_s
        if not self._all_frames:
            self._every = steady_step(seen_fps, RATE_TOLERANCE * self._model_fps, self._every)
            self._least_s = (self._every - 0.5) / seen_fps if self._every > 1 else 0.0
        is_fast = self._all_frames and seen_fps > _OTHER_RATE * self._model_fps
        is_slow = came_fps < self._model_fps / _OTHER_RATE
        if (is_fast or is_slow) and self.tells_rate and not self._has_warned:
            self._has_warned = True
            _log.warning(
                "frames come at %.3g a second, but the parameters are made for %g; %s",
                seen_fps if is_fast else came_fps,
                self._model_fps,
                "leave some out" if is_fast else "an approach looks faster than it is",
            )
