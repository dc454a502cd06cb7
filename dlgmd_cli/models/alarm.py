"""`Alarm`: runs a model, the expansion and an alarm rule on a camera's frames, one by one."""

import math
from collections import deque

import numpy as np

from dlgmd_cli.errors import FrameError, warn
from dlgmd_cli.frame import Flags, Frame, small_wh
from dlgmd_cli.models.base import Grey, create_model
from dlgmd_cli.models.corridor import Motion
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.expansion import Expansion
from dlgmd_cli.models.health import Health
from dlgmd_cli.models.own_rules import own_rule
from dlgmd_cli.models.rules import Rule, too_slow
from dlgmd_cli.models.session import EXPANSION, NEURON, Session
from dlgmd_cli.models.windows import USUAL_FOV_DEG, Camera
from dlgmd_cli.parameters.checks import Spec
from dlgmd_cli.parameters.keys import in_degrees
from dlgmd_cli.parameters.presets import DESCRIBING, Config, ModelName, config_of, parameters_of
from dlgmd_cli.reduction import Reducer, resized
from dlgmd_cli.stream.clock import StreamClock
from dlgmd_cli.stream.continuity import Continuity
from dlgmd_cli.stream.intake import Intake

# Frames have an unexpected rate if the rate over _N_INTERVALS intervals differs by more than this
# factor: 24 to 37.5 frames/s count as 30.
_OTHER_RATE, _N_INTERVALS = 1.25, 30
# A luminance above this is no overshoot of a filter.
_WHITE = 1.5


class Alarm:
    """A model and the expansion with an alarm: causal, frame by frame, in constant memory.

    Parameters
    ----------
    model : optional
        As for `run`: the number of a set, the name of a preset or a model, a class, parameters, or
        a YAML file. The default is the preset `flight`.
    resize : bool
        Reduce wider frames to `width_px`, as `dlgmd run` does. With False, and for a model in
        degrees, frames keep their size.
    width_px, model_fps : int, float, optional
        Frame width (px) and rate (frames/s) that the parameters are designed for. The default comes
        from the file or from the model's published values: 240 px for `flight`, 480 px for the
        paper's sets, and 30 frames/s. Slower frames cause one warning.
    all_frames : bool
        Process all frames; faster frames than `model_fps` cause one warning. A model in degrees
        always does. With False, only every k-th of faster frames is processed, as by `dlgmd run`,
        once their rate is known (after 1 s, with ``times="capture"`` after 10 intervals); a skipped
        frame gets the answer to the last processed frame.
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
    left_out : str
        What is not computed from the next frame on, to save time: `neuron`, `expansion`, or empty.
        Its numbers are NaN.

    Examples
    --------
    >>> import numpy as np
    >>> alarm = Alarm()
    >>> alarm.step(np.zeros((1080, 1920, 3), np.uint8)).alarm
    False
    """

    def __init__(
        self,
        model: ModelName | None = None,
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
        takes_all = in_degrees(self.params)
        self._width_px = (width_px or config.width_px) if resize and not takes_all else None
        self._model_fps = model_fps or config.model_fps
        self._continuity = Continuity(skips_repeats=repeats == "skip")
        self._intake = Intake(
            self._continuity,
            math.inf if all_frames or takes_all else self._model_fps,
            StreamClock(self._model_fps) if times == "arrival" else None,
        )
        self.model = create_model(self.params)
        self._expansion = expansion or Expansion(camera=_camera(config, fov, camera_tilt))
        self.model.look(self._expansion.camera)
        self._health = Health()
        self._session = Session([self.model], self._expansion, health=self._health)
        (self.rule,) = self._session.rules
        self._to_hide: Flags | None = None
        self._index, self._reducer = -1, Reducer()
        self._last = Detection(rule=self.rule.name)
        # Time of each of the latest frames, and whether it is a duplicate; warnings given so far.
        self._times: deque[tuple[float, bool]] = deque(maxlen=_N_INTERVALS + 1)
        self._n_untimed, self._told = 0, set[str]()

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        self._session.reset()
        self._intake.reset()
        self._times.clear()

    @property
    def spare(self) -> str:
        """What the rule does not use: `neuron` or `expansion`; empty for a rule of both.

        A custom rule may use both, whatever column it names.
        """
        rule = self.rule
        if type(rule).__module__ != Rule.__module__ or rule.uses_level == rule.uses_expansion:
            return ""
        return EXPANSION if rule.uses_level else NEURON

    @property
    def left_out(self) -> str:
        """What is not computed, see the class."""
        return self._session.left_out

    @left_out.setter
    def left_out(self, part: str) -> None:
        self._session.left_out = part

    def heading(
        self,
        right_deg: float = math.nan,
        up_deg: float = math.nan,
        speed_m_s: float = math.nan,
        roll_deg: float = math.nan,
        pitch_deg: float = math.nan,
        yaw_deg: float = math.nan,
    ) -> None:
        """Set the motion of the drone from now on, see `Motion`; call it before `step`.

        Parameters
        ----------
        right_deg, up_deg : float
            Direction of flight, in degrees from the optical axis. The expansion is measured around
            it. If an angle is NaN, or the window would leave the image, it is measured around the
            camera's default direction.
        speed_m_s, roll_deg, pitch_deg, yaw_deg : float
            Speed, and the drone's attitude: positive with the right side down, the nose up, and to
            the right. With them and the direction, `corridor` is measured, which the rule
            `corridor` compares. The attitude alone tells of turns.
        """
        self._expansion.head(Motion((right_deg, up_deg), speed_m_s, roll_deg, pitch_deg, yaw_deg))

    def look(self, camera: Camera) -> None:
        """Take the angles of another camera from now on."""
        self._expansion.look(camera)
        self.model.look(camera)

    def ignore(self, hidden: Flags | None, small: Flags | None = None) -> None:
        """Ignore some cells of all reduced frames from now on, see `Model.ignore`.

        `small` is the mask for the image on which the expansion is measured, see `step`. It is
        derived from `hidden` unless given.
        """
        self.model.ignore(hidden)
        self._expansion.ignore(small)
        self._to_hide = hidden if small is None else None
        self._health.ignore(hidden)
        self._continuity.begin(hidden)

    def step(
        self,
        frame: Grey | Frame,
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
        frame : ndarray, shape (H, W) or (H, W, 3), float32 or uint8, or Frame
            Grey or BGR, as from OpenCV's cameras: luminance in 0..1, or levels of 0..255. A `Frame`
            of an open video is taken as it is, at its own time.
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
        if not isinstance(frame, Frame | np.ndarray):
            raise FrameError("", f"a frame is an array, not {type(frame).__name__}")
        taken = frame if isinstance(frame, Frame) else self._taken(frame, time_s, small)
        if taken is None:
            return self._last
        if taken.small is not None and not taken.is_repeat:
            self._hide_small(taken.small)
        (self._last,) = self._session.step(taken, layers=layers)
        if taken is frame or self._intake.is_settled:
            self._tell_rate(taken)
        return self._last

    def _taken(self, image: Grey, time_s: float | None, small: Grey | None) -> Frame | None:
        """The frame of an image; None if it is skipped. Warns of missing and of late times."""
        self._index += 1
        grey, small = self._reduced(image, small)
        self._tell_white(grey)
        placed = self._intake.place(grey if grey.ndim > 1 else None, time_s)
        if doubts := self._intake.doubts():
            warn(f"frames come {doubts}")
        if time_s is None:
            self._n_untimed += 1
            if self._n_untimed == _N_INTERVALS:
                assumed = f"they count as {self._model_fps:g} a second"
                warn(f"frames have no times, so {assumed}; give step() the times")
        if placed is None:
            return None
        return Frame(
            self._index, placed.time_s, grey, placed.is_repeat, placed.after_gap, small=small
        )

    def _tell_white(self, grey: Grey) -> None:
        """Warn once of numbers far above white, such as levels of 0..255 as float32."""
        if grey.dtype != np.float32 or not grey.size or "white" in self._told:
            return
        if (top := float(grey.max())) > _WHITE:
            self._told.add("white")
            warn(f"frames hold numbers up to {top:g}, where white is 1; divide them by their white")

    def _hide_small(self, small: Grey) -> None:
        """Hide in the image of the expansion the same parts as in the frames."""
        if self._to_hide is not None:
            hidden = resized(np.float32(self._to_hide), small.shape[::-1])
            self._expansion.ignore(hidden > 0.0)
            self._to_hide = None

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

    def _tell_rate(self, frame: Frame) -> None:
        """Warn once of a rate that does not fit the model, and of one too low for the rule."""
        if math.isnan(frame.time_s):
            return
        if frame.after_gap:
            self._times.clear()
        self._times.append((frame.time_s, frame.is_repeat))
        if len(self._times) <= _N_INTERVALS or not self._times[-1][0] > self._times[0][0]:
            return
        times_s, repeats = np.transpose(self._times)
        # Duplicates do not make a camera faster, and a still scene does not make it slower.
        came_fps = _N_INTERVALS / (times_s[-1] - times_s[0])
        new_fps = came_fps * (1.0 - repeats[1:].mean())
        unfit, is_any_fit = "", in_degrees(self.params)
        if not is_any_fit and new_fps > _OTHER_RATE * self._model_fps:
            unfit = f"{new_fps:.3g} a second, but {{}}; leave some out"
        elif not is_any_fit and came_fps < self._model_fps / _OTHER_RATE:
            unfit = f"{came_fps:.3g} a second, but {{}}; an approach looks faster than it is"
        made_for = f"the parameters are made for {self._model_fps:g}"
        lines = {
            "rate": f"frames are processed at {unfit.format(made_for)}" if unfit else "",
            "rule": too_slow(self.rule, times_s[repeats == 0.0]),
        }
        for topic, line in lines.items():
            if line and topic not in self._told:
                self._told.add(topic)
                warn(line)


def _camera(config: Config, fov: float | None, camera_tilt: float | None) -> Camera:
    """The camera of an alarm."""
    angles = {"fov": fov, "camera_tilt": camera_tilt}
    given = {name: angle for name, angle in angles.items() if angle is not None}
    known = {"fov": USUAL_FOV_DEG, "camera_tilt": 0.0, **config.camera, **given}
    return Camera(*(DESCRIBING[name].check(known[name], name) for name in angles))
