"""Normalisation of the membrane potential, spikes and alarms, the same for every model."""

import logging
import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError
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
    steady_step,
)
from dlgmd_cli.models.base import Grey, Response
from dlgmd_cli.models.health import Health
from dlgmd_cli.models.step import Stepper
from dlgmd_cli.parameters.checks import shown
from dlgmd_cli.parameters.presets import (
    PRESETS,
    Config,
    Parameters,
    design_of,
    load_config,
    parameters_of,
)

_log = logging.getLogger(__name__)

Potential = TypeVar("Potential", float, Series)

# K of a single cell for a change of one grey level, in luminance². A lower peak is due to rounding;
# for a receding object, the EMD-LGMD's is 6e-7.
LEAST_PEAK = 1.0 / 255.0**2
# An alarm that begins within this time after the end of another belongs to it.
MERGE_S = 0.3
# Tolerance for rounding in differences of times, such as 0.5 - 0.2.
ROUNDING_S = 1e-6
# Where the middle third of the picture ends, in halves of its sides from its centre.
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
        Mean excitation per cell at which the result is 1/2; None for the LGMD's own sigmoid.

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
    """Membrane potential normalised offline, to [0, 1] by the extremes of its own sequence.

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


class SpikeDetector:
    """Spikes and alarms of a normalised membrane potential, frame by frame.

    Parameters
    ----------
    threshold : float
        T_MP, the level at which a spike is raised, [Zhao2023] Eq. (14).
    n_sp : int
        Spikes in a row that raise an alarm, [Zhao2023] Eq. (15).
    """

    def __init__(self, threshold: float, n_sp: int) -> None:
        self._threshold, self._n_sp = threshold, n_sp
        self.reset()

    def reset(self) -> None:
        """Forget all earlier spikes."""
        self._in_a_row = 0

    def step(self, level: float) -> tuple[bool, bool]:
        """Whether this frame is a spike, and whether the alarm is on; NaN is not a spike."""
        spike = bool(level >= self._threshold)
        self._in_a_row = self._in_a_row + 1 if spike else 0
        return spike, self._in_a_row >= self._n_sp


def detect(levels: Series, threshold: float, n_sp: int) -> tuple[Flags, Flags]:
    """Spikes and alarms of a whole sequence; see `SpikeDetector` for single frames.

    Parameters
    ----------
    levels : ndarray, shape (n,)
        Normalised membrane potential; NaN where undefined.
    threshold, n_sp : float, int
        See `SpikeDetector`.

    Returns
    -------
    spikes, alarms : ndarray, shape (n,), bool
        The alarm is on from the n_sp-th to the last spike in a row.
    """
    detector = SpikeDetector(threshold, n_sp)
    flags = np.array([detector.step(level) for level in levels.tolist()], np.bool_)
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
    """The third of the picture that a centroid lies in.

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
        Time to contact that the model estimates in that frame, see `Response`.
    """

    start_frame: int
    start_s: float
    end_frame: int
    end_s: float
    peak_mp_abs: float
    g_x: float = math.nan
    g_y: float = math.nan
    ttc_s: float = math.nan

    @property
    def side(self) -> str:
        """Where in the picture it was raised, see `side_of`."""
        return side_of(self.g_x, self.g_y)

    def to_dict(self) -> dict[str, Any]:
        """The columns of alarms.csv; None where a number is not defined."""
        known = {k: None if math.isnan(v) else v for k, v in self._asdict().items()}
        ttc_s = known.pop("ttc_s")
        return {**known, "side": self.side, "ttc_s": ttc_s}


@dataclass(frozen=True)
class Detection(Response):
    """A model's response to one frame, with its spike and alarm.

    Attributes
    ----------
    mp_abs : float
        Membrane potential normalised by `absolute`; NaN until defined.
    spike : bool
        Whether `mp_abs` reaches the threshold.
    alarm : bool
        Whether the last n_sp frames, this one included, were spikes.
    blind : str or None
        Why the pictures show nothing, see `Health`: `black`, `flat`, `noise` or `frozen`. None if
        they are sound, or not bad for long enough. While it is set, no alarm is no all-clear.
    """

    mp_abs: float = math.nan
    spike: bool = False
    alarm: bool = False
    blind: str | None = None

    @property
    def side(self) -> str:
        """Where in the picture the active cells are, see `side_of`."""
        return side_of(self.g_x, self.g_y)


class Alarm:
    """A model with its alarm: causal, one frame at a time, in constant memory.

    Parameters
    ----------
    params : Parameters or Config, optional
        Parameters of any model, or a file of them, see `load_config`. The default is the preset
        `flight`.
    resize : bool
        Reduce frames that are wider than `width_px` to it, as `dlgmd run` does. With False, frames
        are taken as they come.
    width_px, model_fps : int, float, optional
        Frame width and rate that the parameters are made for. The default is what the file says, or
        what the model's published values are made for: 240 px for `flight`, 480 px for the paper's
        sets, and 30 frames a second. Slower frames are a warning, see `logging`, once.
    all_frames : bool
        Process frames at any rate, and warn once of faster ones too. With False, only every k-th is
        processed if they come faster, by the rule of `dlgmd run`, once 30 intervals tell the rate;
        the others have the answer of the last one that was.
    repeats : {"skip", "keep"}
        Treatment of duplicate frames: `skip` returns the previous response, `keep` passes them to
        the model.
    engine
        See `DLGMD`.
    times : {"arrival", "capture"}
        What the times of frames are. Of `arrival`, a clock recovers those of the capture, see
        `CaptureClock`; a burst of late frames is a warning, once. With `capture`, they are exact.

    Attributes
    ----------
    model : Model
        The model that computes the membrane potential.
    tells_rate : bool
        Whether a frame rate that the model is not made for is a warning; clear it where that is
        told elsewhere.

    Examples
    --------
    >>> import numpy as np
    >>> alarm = Alarm()
    >>> alarm.step(np.zeros((1080, 1920, 3), np.uint8)).alarm
    False
    """

    def __init__(
        self,
        params: Parameters | Config | None = None,
        *,
        resize: bool = True,
        width_px: int | None = None,
        model_fps: float | None = None,
        all_frames: bool = False,
        repeats: str = "skip",
        engine: str = "auto",
        times: str = "arrival",
    ) -> None:
        if repeats not in ("skip", "keep"):
            raise ParameterError("", f"repeats = {shown(repeats)} is not one of skip, keep")
        if times not in ("arrival", "capture"):
            raise ParameterError("", f"times = {shown(times)} is not one of arrival, capture")
        given = load_config(PRESETS[0]) if params is None else params
        if isinstance(given, Config):
            self.params, design = parameters_of(given), (given.width_px, given.model_fps)
        else:
            self.params, design = given, design_of(given)
        self._width_px = (width_px or design[0]) if resize else None
        self._model_fps, self._all_frames = model_fps or design[1], all_frames
        self._taken_s, self._least_s, self._every = math.nan, 0.0, 0
        self._clock = CaptureClock() if times == "arrival" else None
        self._health, self.tells_rate = Health(), True
        self._n_untimed, self._told_uneven = 0, False
        self._times: deque[tuple[float, bool]] = deque(maxlen=_N_INTERVALS + 1)
        self._has_warned = False
        self._stepper = Stepper(self.params, engine=engine)
        self.model = self._stepper.model
        self._spikes = SpikeDetector(self.params.t_mp, self.params.n_sp)
        self._gaps, self._repeats = GapDetector(), RepeatDetector() if repeats == "skip" else None
        self._index, self._last = -1, Detection()

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        self._stepper.reset()
        self._spikes.reset()
        self._gaps.reset()
        self._times.clear()
        self._taken_s, self._least_s, self._every = math.nan, 0.0, 0
        self._health.reset()
        if self._clock is not None:
            self._clock.reset()
        if self._repeats is not None:
            self._repeats.reset()

    def ignore(self, hidden: Flags | None) -> None:
        """Ignore some cells of all frames, as they are reduced, from now on; see `Model.ignore`."""
        self._stepper.ignore(hidden)
        self._health.ignore(hidden)
        if self._repeats is not None:
            self._repeats = RepeatDetector(hidden)

    def step(self, frame: Grey, time_s: float | None = None, *, layers: bool = False) -> Detection:
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

        Raises
        ------
        FrameError
            If the frame is not such an image, or differs in size or type from the previous one.
        MissingExtraError
            If the requested engine needs a package that is not installed.
        """
        frame, time_s = self._reduced(frame), self._captured_s(time_s)
        is_gap = time_s is not None and self._gaps.step(time_s)
        is_repeat = self._repeats is not None and frame.ndim > 1 and self._repeats.step(frame)
        if time_s is not None:
            self._watch_rate(time_s, is_gap=is_gap, is_repeat=is_repeat)
        is_stale = self._clock is not None and self._clock.is_stale
        if is_stale or (not is_gap and not is_repeat and self._is_early(time_s)):
            return self._last
        blind = self._health.step(frame, time_s) if frame.ndim == 2 and frame.size else None
        if is_gap:  # what comes after a gap is new, even if it looks the same
            self._spikes.reset()
        elif is_repeat:
            if blind != self._last.blind:
                self._last = replace(self._last, blind=blind)
            return self._last
        self._index += 1
        self._taken_s = math.nan if time_s is None else time_s
        one = Frame(self._index, math.nan if time_s is None else time_s, frame, after_gap=is_gap)
        response = self._stepper.step(one, layers=layers)
        mp_abs = float(absolute(response.mp, self.model.n_cells, self.params.kappa))
        spike, alarm = self._spikes.step(mp_abs)
        found = Detection(**vars(response), mp_abs=mp_abs, spike=spike, alarm=alarm, blind=blind)
        self._last = found
        return self._last

    def _captured_s(self, time_s: float | None) -> float | None:
        """When a frame was captured; tells once of missing times, and of frames that come late."""
        if time_s is None:
            self._n_untimed += 1
            if self._n_untimed == _N_INTERVALS and self.tells_rate:
                what = "frames have no times, so they count as %g a second; give step() the times"
                _log.warning(what, self._model_fps)
            return None
        if self._clock is None:
            return time_s
        captured_s = self._clock.step(time_s)
        if self._clock.latest_s > UNEVEN_S and not self._told_uneven:
            self._told_uneven = True
            what = "frames come unevenly, up to %.2f s late; the times of their capture are used"
            _log.warning(what, self._clock.latest_s)
        return captured_s

    def _reduced(self, frame: Grey) -> Grey:
        """A frame in grey and of the model's width; the model refuses what is no picture."""
        if frame.dtype not in (np.uint8, np.float32) or not frame.size:
            return frame
        if frame.ndim == 3 and frame.shape[2] == 3:
            frame = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        if frame.ndim != 2 or self._width_px is None or frame.shape[1] <= self._width_px:
            return frame
        height = max(1, round(frame.shape[0] * self._width_px / frame.shape[1]))
        return resized(frame, (self._width_px, height))

    def _is_early(self, time_s: float | None) -> bool:
        """Whether a frame comes sooner after the last one taken than frames should."""
        return time_s is not None and 0.0 <= time_s - self._taken_s < self._least_s

    def _watch_rate(self, time_s: float, *, is_gap: bool, is_repeat: bool) -> None:
        """Find what frames to leave out, or warn once of a rate the model is not made for."""
        if is_gap:
            self._times.clear()
        self._times.append((time_s, is_repeat))
        duration_s = time_s - self._times[0][0]
        if len(self._times) <= _N_INTERVALS or not duration_s > 0.0:
            return
        # Repeats do not make a camera faster, and a still scene does not make it slower.
        n_seen = _N_INTERVALS - sum(repeats for _, repeats in self._times)
        seen_fps, came_fps = n_seen / duration_s, _N_INTERVALS / duration_s
        if not self._all_frames:
            max_fps = RATE_TOLERANCE * self._model_fps
            every = steady_step(seen_fps, max_fps, self._every)
            self._least_s = (every - 0.5) / seen_fps if every > 1 else 0.0
            self._every = every
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
