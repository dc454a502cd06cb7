"""`Alarm`: runs a model, the expansion and an alarm rule on a camera's frames, one by one."""

import math
from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np

from dlgmd_cli.errors import warn
from dlgmd_cli.frame import (
    RATE_TOLERANCE,
    SETTLED_S,
    CaptureClock,
    Continuity,
    Flags,
    Frame,
    small_wh,
    steady_step,
)
from dlgmd_cli.models.base import Grey, create_model
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.expansion import Expansion
from dlgmd_cli.models.health import Health
from dlgmd_cli.models.own_rules import own_rule
from dlgmd_cli.models.rules import Rule
from dlgmd_cli.models.session import Session
from dlgmd_cli.models.windows import USUAL_FOV_DEG, Camera
from dlgmd_cli.parameters.checks import Spec
from dlgmd_cli.parameters.presets import DESCRIBING, Config, config_of, parameters_of
from dlgmd_cli.reduction import Reducer, resized

# Frames have an unexpected rate if the rate over _N_INTERVALS intervals differs by more than this
# factor: 24 to 37.5 frames/s count as 30.
_OTHER_RATE, _N_INTERVALS = 1.25, 30


class Alarm:
    """A model and the expansion with an alarm: causal, frame by frame, in constant memory.

    Parameters
    ----------
    model : optional
        As for `run`: the number of a set, the name of a preset or a model, a class, parameters, or
        a YAML file. The default is the preset `flight`.
    resize : bool
        Reduce wider frames to `width_px`, as `dlgmd run` does. With False, frames keep their size.
    width_px, model_fps : int, float, optional
        Frame width (px) and rate (frames/s) that the parameters are designed for. The default comes
        from the file or from the model's published values: 240 px for `flight`, 480 px for the
        paper's sets, and 30 frames/s. Slower frames cause one warning.
    all_frames : bool
        Process all frames; faster frames than `model_fps` cause one warning. With False, only every
        k-th of faster frames is processed, as by `dlgmd run`, as soon as 1 s and 30 intervals
        show the rate; a skipped frame gets the answer to the last processed frame.
    repeats : {"keep", "skip"}
        Treatment of a frame that equals the one before: `keep` passes it to the model, as `run`
        does with arrays, `skip` returns the previous response.
    alarm : optional
        The rule, as for `run`: its name, or a class of your own.
    times : {"arrival", "capture"}
        Meaning of the frames' times. From arrival times, a clock estimates the capture times, see
        `CaptureClock`, and a burst of late frames causes one warning. Capture times are exact.
    expansion : Expansion, optional
        The measurement of the expansion; with all corrections unless given.
    fov, camera_tilt : float, optional
        Horizontal field of view of the whole image, and tilt of the camera on the drone (upwards
        positive), in degrees. The default comes from the file, or is 80 and 0.

    Attributes
    ----------
    model : Model
        The model that computes the membrane potential.
    rule : Rule
        The rule of the alarm; its `threshold` may change between frames.
    tells_rate : bool
        Whether a frame rate that the model is not designed for causes a warning; set False if the
        rate is reported elsewhere.

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
        repeats: str = "keep",
        alarm: str | type[Rule] | None = None,
        times: str = "arrival",
        expansion: Expansion | None = None,
        fov: float | None = None,
        camera_tilt: float | None = None,
    ) -> None:
        Spec(str, choices=("skip", "keep")).check(repeats, "repeats")
        Spec(str, choices=("arrival", "capture")).check(times, "times")
        config = config_of(model)
        self.params = parameters_of(config, {} if alarm is None else {"alarm": own_rule(alarm)})
        self._width_px = (width_px or config.width_px) if resize else None
        self._model_fps, self._all_frames = model_fps or config.model_fps, all_frames
        self._began_s = self._taken_s = math.nan
        self._least_s, self._every = 0.0, 0
        self._clock = CaptureClock(self._model_fps) if times == "arrival" else None
        self._health, self.tells_rate = Health(), True
        self._n_untimed, self._told = 0, set[str]()
        self._times: deque[tuple[float, bool]] = deque(maxlen=_N_INTERVALS + 1)
        self._has_warned = False
        self.model = create_model(self.params)
        camera = _camera(config, fov, camera_tilt)
        self._expansion = expansion or Expansion(camera=camera)
        self._session = Session([self.model], self._expansion)
        (self.rule,) = self._session.rules
        self._continuity = Continuity(skips_repeats=repeats == "skip")
        self._to_hide: Flags | None = None
        self._index, self._last, self._reducer = -1, Detection(), Reducer()

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        self._session.reset()
        self._continuity.reset()
        self._health.reset()
        if self._clock is not None:
            self._clock.reset()
        self._times.clear()
        self._began_s = self._taken_s = math.nan
        self._least_s, self._every = 0.0, 0

    def heading(self, right_deg: float = math.nan, up_deg: float = math.nan) -> None:
        """Set the direction of flight from now on, in degrees from the optical axis.

        The expansion is measured around this direction. If an angle is NaN, or the windows would
        leave the image, the expansion is measured around the camera's default direction.
        """
        is_known = math.isfinite(right_deg) and math.isfinite(up_deg)
        self._expansion.head((right_deg, up_deg) if is_known else None)

    def ignore(self, hidden: Flags | None, small: Flags | None = None) -> None:
        """Ignore some cells of all reduced frames from now on, see `Model.ignore`.

        `small` is the mask for the image on which the expansion is measured, see `step`. It is
        derived from `hidden` unless given.
        """
        self.model.ignore(hidden)
        self._expansion.ignore(small)
        self._to_hide = hidden if small is None else None
        self._health.ignore(hidden)
        self._continuity.ignore(hidden)

    def step(
        self,
        frame: Grey,
        time_s: float | None = None,
        *,
        layers: bool = False,
        small: Grey | None = None,
    ) -> Detection:
        """Process the next frame and say whether the alarm is on.

        After a gap in time, in which frames were lost, the model restarts and has no response until
        its history is full again.

        Parameters
        ----------
        frame : ndarray, shape (H, W) or (H, W, 3), float32 or uint8
            Grey or BGR, as from OpenCV's cameras: luminance in 0..1, or levels of 0..255.
        time_s : float, optional
            Time of the frame in seconds, such as the arrival time, see `times`. Without times, the
            model assumes its design rate, gaps go undetected, and one warning is given.
        layers : bool
            Also return copies of P, S and G.
        small : ndarray, (h, w), float32 or uint8, optional
            The same frame in grey at the size of `frame.small_wh`, if already available.

        Returns
        -------
        Detection
            The answer to the frame; for a duplicate or skipped frame, the last answer.

        Raises
        ------
        FrameError
            If the frame is not such an image, or its size or type differs from the previous frame.
        """
        frame, small = self._reduced(frame, small)
        time_s = self._captured_s(time_s)
        is_repeat, is_gap = self._continuity.step(frame if frame.ndim > 1 else None, time_s)
        if time_s is not None:
            self._watch_rate(time_s, is_gap=is_gap, is_repeat=is_repeat)
        is_stale = self._clock is not None and self._clock.is_stale
        is_early = time_s is not None and 0.0 <= time_s - self._taken_s < self._least_s
        if is_stale or (is_early and not is_gap and not is_repeat):
            return self._last
        blind = self._health.step(frame, time_s) if frame.ndim == 2 and frame.size else None
        if not is_repeat:
            self._index += 1
            self._taken_s = math.nan if time_s is None else time_s
            self._hide_small(small)
        taken = Frame(self._index, self._taken_s, frame, is_repeat, is_gap, small=small)
        (answer,) = self._session.step(taken, layers=layers)
        if not is_repeat or blind != self._last.blind:
            self._last = answer if blind is None else replace(answer, blind=blind)
        return self._last

    def _hide_small(self, small: Grey | None) -> None:
        """Hide in the image of the expansion the same parts as in the frames."""
        if small is not None and self._to_hide is not None:
            hidden = resized(np.float32(self._to_hide), small.shape[::-1])
            self._expansion.ignore(hidden > 0.0)
            self._to_hide = None

    def _captured_s(self, time_s: float | None) -> float | None:
        """The capture time (s) of a frame; warns once of missing times and of late frames."""
        if time_s is None:
            self._n_untimed += 1
            if self._n_untimed == _N_INTERVALS and self.tells_rate:
                assumed = f"they count as {self._model_fps:g} a second"
                warn(f"frames have no times, so {assumed}; give step() the times")
            return None
        if self._clock is None:
            return time_s
        captured_s = self._clock.step(time_s)
        doubts = self._clock.doubts()
        if doubts and (kind := doubts.partition(",")[0]) not in self._told:
            self._told.add(kind)
            warn(f"frames come {doubts}")
        return captured_s

    def _reduced(self, frame: Grey, small: Grey | None) -> tuple[Grey, Grey | None]:
        """A frame in grey at the model's width, and in grey at the size for the expansion.

        An invalid image is left to the model, which refuses it.
        """
        if frame.dtype not in (np.uint8, np.float32) or not frame.size:
            return frame, None
        if frame.ndim != 2 and (frame.ndim != 3 or frame.shape[2] != 3):
            return frame, None
        height, width = frame.shape[:2]
        self._reducer.take(frame)
        given, of_small = small, small_wh(width, height)
        if small is None:
            small = self._reducer.at(of_small)
        if self._width_px is None or width <= self._width_px:
            return self._reducer.grey, small
        size_wh = self._width_px, max(1, round(height * self._width_px / width))
        is_small = given is None and size_wh == of_small
        return small if is_small else self._reducer.at(size_wh), small

    def _watch_rate(self, time_s: float, *, is_gap: bool, is_repeat: bool) -> None:
        """Set which frames are skipped, or warn once of a rate that does not fit the model."""
        if math.isnan(self._began_s):
            self._began_s = time_s
        is_settled, is_uneven = time_s - self._began_s >= SETTLED_S, False
        if self._clock is not None:
            is_settled, is_uneven = self._clock.is_settled, self._clock.is_uneven
        if is_gap or (is_uneven and not is_settled):
            self._times.clear()
        self._times.append((time_s, is_repeat))
        duration_s = time_s - self._times[0][0]
        if len(self._times) <= _N_INTERVALS or not duration_s > 0.0 or not is_settled:
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
            rate = f"frames come at {seen_fps if is_fast else came_fps:.3g} a second"
            made_for = f"but the parameters are made for {self._model_fps:g}"
            effect = "leave some out" if is_fast else "an approach looks faster than it is"
            warn(f"{rate}, {made_for}; {effect}")


def _camera(config: Config, fov: float | None, camera_tilt: float | None) -> Camera:
    """The camera of an alarm."""
    angles = {"fov": fov, "camera_tilt": camera_tilt}
    given = {name: angle for name, angle in angles.items() if angle is not None}
    known = {"fov": USUAL_FOV_DEG, "camera_tilt": 0.0, **config.camera, **given}
    return Camera(*(DESCRIBING[name].check(known[name], name) for name in angles))
