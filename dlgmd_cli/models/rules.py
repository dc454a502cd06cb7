"""The alarm rules: the signal that each rule compares, its threshold, and its words."""

import math
from dataclasses import replace
from importlib import import_module
from typing import ClassVar

import numpy as np

from dlgmd_cli.errors import ModelError, ParameterError
from dlgmd_cli.frame import Series
from dlgmd_cli.models.base import blamed, number
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.expansion import LEAST_QUALITY
from dlgmd_cli.models.health import UNMEASURED
from dlgmd_cli.models.normalise import absolute, excitation_at
from dlgmd_cli.parameters.checks import require_known
from dlgmd_cli.parameters.facts import Json
from dlgmd_cli.parameters.keys import FRAME_S, RULES, KnownRule, Parameters, changed, in_degrees

# A place in the image, x and y from -1 (left, top) to 1; NaN where undefined.
ImagePoint = tuple[float, float]

# The unit that follows a number of a column that a rule compares.
_UNITS = {"ttc_s": " s", "expansion": "/s", "corridor": "/s"}
# The lowest frame rate, in frames/s, at which the expansion has been measured against the truth.
MIN_FPS = 7.5
# What holds a signal below the raw rate, see `Ahead.limit`.
GROUND, QUALITY, APPROACH = "ground", "quality", "approach"
# The edge of the image's middle third: distance from the centre, as a share of half a side.
_THIRD = 1.0 / 3.0
# T_MP if the parameters have T_MP = 0 or 1, for which no κ can be computed.
_T_MP = 0.4
# The rate of what stands ahead, and that of points in the way, times the true time to contact:
# medians of rendered collisions.
RATE_TIMES_TIME, IN_WAY_TIMES_TIME = 0.52, 0.85
# The lowest frame rate for a model in degrees, in frames/s; its spikes in a row may be earlier by
# this share of a frame.
_DEGREES_MIN_FPS, _EARLY = 24.0, 0.1
# Digits of a calibrated threshold.
_DIGITS = 4


class Rule:
    """An alarm rule: turns a model's response or the measured expansion into alarms.

    Each subclass with a `name` is a rule, which the parameter `alarm` names. Importing the module
    of a rule registers the rule; worker processes that get such parameters import the module. A
    rule that compares one column with one parameter names both in its attributes; any other rule
    also overrides `value` and `tuned`. A rule steps the rows of a video in order, each once, and
    may remember earlier rows until `reset`, as after a gap.

    Parameters
    ----------
    params : Parameters
        The rule's threshold, and `t_mp`: T_MP, the level of a spike, [Zhao2023] Eq. (14).
    by_sequence : bool
        Whether the level is the per-video min–max.

    Attributes
    ----------
    name : str
        The rule's name in parameters, tables, figures, pages and messages.
    column : str
        The number of a `Detection` that gives the signal its unit: `level`, `expansion`, `ttc_s` or
        `corridor`; empty for none of them. Unless `value` is overridden, this number is the signal.
    quantity : str
        The signal in words.
    key : str
        The parameter that holds the threshold; empty for none.
    at_most : bool
        Whether the alarm is on at or below the threshold; else at or above the threshold.
    scored : str
        The series of a `Result` that scores compare with thresholds.
    counts : tuple of int
        The numbers of frames in a row that a calibration tries.
    follows_speed : bool
        Whether the threshold means a time before contact and can follow the drone's speed.
    threshold : float
        The threshold, which may change between frames.
    n_in_a_row : int
        The number of frames in a row that raise an alarm.
    """

    name: str = ""
    column: ClassVar[str] = ""
    quantity: ClassVar[str] = ""
    key: ClassVar[str] = ""
    at_most: ClassVar[bool] = False
    scored: str = "signal"
    counts: ClassVar[tuple[int, ...]] = (1,)
    follows_speed: ClassVar[bool] = False

    def __init_subclass__(cls, *, name: str = "") -> None:
        """Register a subclass that has a name."""
        super().__init_subclass__()
        if name:
            place = f"{cls.__module__}:{cls.__qualname__}"
            cls.name, RULES[name] = name, RULES.get(name, KnownRule(""))._replace(place=place)

    def __init__(self, params: Parameters, *, by_sequence: bool = False) -> None:
        self.params, self.by_sequence = params, by_sequence
        self.name = self.name or params.alarm
        self.threshold = float(getattr(params, self.key)) if self.key else 1.0
        self.n_in_a_row = 1
        self._in_a_row = 0

    @property
    def text(self) -> str:
        """The rule in words."""
        threshold, way = self.with_unit(f"{self.threshold:g}"), "less" if self.at_most else "more"
        return f"{self.name}: {self.quantity or 'a signal'} of {threshold} or {way}"

    @classmethod
    def with_unit(cls, number: str) -> str:
        """A value of the signal with its unit: ``0.64 s``."""
        return f"{number}{_UNITS.get(cls.column, '')}"

    @property
    def line_text(self) -> str:
        """The label of the threshold's line in figures: ``alarm at 0.64 s``."""
        return f"alarm at {self.with_unit(f'{self.threshold:g}')}"

    def peak_text(self, signal: float) -> str:
        """The strongest signal of an alarm in words: ``expansion up to 1.24/s``."""
        way = "down" if self.at_most else "up"
        return f"{self.quantity or 'signal'} {way} to {self.with_unit(f'{signal:.2f}')}"

    @property
    def longest_ttc_s(self) -> float:
        """The longest time to contact that figures show, in seconds."""
        return 3.0 * self.params.ttc_alarm

    def to_dict(self) -> dict[str, Json]:
        """For the scripts of pages: name, column, threshold with its label, and `longest_ttc_s`."""
        return {
            "name": self.name,
            "column": self.panel,
            "threshold": self.threshold,
            "text": self.line_text,
            "longest_ttc_s": self.longest_ttc_s,
        }

    @property
    def panel(self) -> str:
        """The column in whose panel figures and pages show the signal, or `signal`: its own."""
        return self.column if self.column in ("level", "expansion", "ttc_s") else "signal"

    @property
    def uses_level(self) -> bool:
        """Whether the rule may compare the membrane potential."""
        return self.column in ("level", "")

    @property
    def uses_expansion(self) -> bool:
        """Whether the rule may compare the expansion rate or the time to contact."""
        return self.column != "level"

    @classmethod
    def side(cls, cells: ImagePoint, expansion: ImagePoint) -> str:
        """The image region (`side_of`) of the active cells, or of the part that expands."""
        return side_of(*expansion)

    def value(self, row: Detection) -> float:
        """The signal of a frame: what is compared with the threshold; NaN for no alarm."""
        if not self.column:
            raise NotImplementedError("the class has no value()")
        return float(getattr(row, self.column))

    def limit(self, row: Detection, signal: float) -> str:
        """What holds the signal below the raw number, in a word; empty for nothing."""
        return ""

    def blind(self, reason: str, *, alarm: bool) -> str:
        """A reason of `Detection.blind` as it holds for the rule and its alarm."""
        is_all_clear = alarm or not self.uses_expansion
        return "" if reason == UNMEASURED and is_all_clear else reason

    def reset(self) -> None:
        """Forget the earlier frames that `value` remembers; called before the first frame."""

    def restart(self) -> None:
        """Forget all earlier frames; raises ModelError if a rule of one's own fails."""
        self._in_a_row = 0
        with blamed(self.name, "reset()", noun="rule"):
            self.reset()

    def step(self, row: Detection) -> Detection:
        """The row of the next frame with its signal, spike and alarm; NaN is neither.

        Raises ModelError if a rule of one's own fails, or returns no finite number.
        """
        with blamed(self.name, "value()", f", frame {row.frame}", noun="rule"):
            signal = number(self.value(row), "value()")
            if math.isinf(signal):
                raise ModelError("value()", "it returns infinity", "NaN raises no alarm.")
            limit = self.limit(row, signal)
        is_on = signal <= self.threshold if self.at_most else signal >= self.threshold
        self._in_a_row = self._in_a_row + 1 if is_on else 0
        return replace(
            row,
            signal=signal,
            signal_limit=limit,
            spike=bool(row.level >= self.params.t_mp),
            alarm=(is_alarm := self._in_a_row >= self.n_in_a_row),
            blind=self.blind(row.blind, alarm=is_alarm),
            rule=self.name,
            side=self.side((row.g_x, row.g_y), (row.expansion_x, row.expansion_y)),
        )

    def strength_at(self, signal: float) -> float:
        """What scores compare at a signal, larger for nearer to an alarm; see `value_at`."""
        return -signal if self.at_most else signal

    def value_at(self, strength: float) -> float:
        """The signal at a strength; the inverse of `strength_at`."""
        return -strength if self.at_most else strength

    def excitation_at(self, strength: float) -> float:
        """The mean excitation per cell at a strength; NaN if the rule does not compare it."""
        return math.nan

    @staticmethod
    def as_time(value: float) -> float:
        """Convert a signal to its time to contact in seconds, or such a time to its signal."""
        return value

    def threshold_at(self, time_s: float) -> float:
        """The threshold for an alarm `time_s` before contact, if the rule `follows_speed`.

        It is never stricter than the parameter: where the stop is short, alarms that begin later
        would be false less often, but more of them would come too late.
        """
        if not self.follows_speed:
            return self.threshold
        spec, own = self.params.specs()[self.key], float(getattr(self.params, self.key))
        needed = min(max(self.as_time(time_s), spec.low), spec.high)
        return max(needed, own) if self.at_most else min(needed, own)

    def thresholds_at(self, time_s: float) -> dict[str, float]:
        """Parameter -> value of all thresholds for an alarm `time_s` before contact."""
        return {self.key: self.threshold_at(time_s)}

    def follow(self, params: Parameters) -> None:
        """Take the thresholds of these parameters from now on."""
        self.threshold = float(getattr(params, self.key))

    @property
    def calibrated(self) -> str:
        """The parameters that a calibration changes, in words."""
        return self.key

    def chosen(self, strength: float, n_in_a_row: int) -> dict[str, float]:
        """Name -> value of the threshold that a calibration chose."""
        return {self.key: self.value_at(strength)}

    def tuned(self, strength: float, n_in_a_row: int) -> Parameters:
        """The parameters with a new threshold (four digits) and a new number of frames in a row."""
        if not self.key:
            hint = "Name it as the class's key, or override tuned."
            raise ParameterError("", f"the rule {self.name} has no parameter to calibrate", hint)
        return changed(self.params, **{self.key: self._limited(self.key, self.value_at(strength))})

    def _limited(self, key: str, value: float) -> float:
        """A value to four digits, within the limits of a parameter."""
        spec = self.params.specs()[key]
        return min(max(float(f"{value:.{_DIGITS}g}"), spec.low), spec.high)


class Spikes(Rule, name="spikes"):
    """An alarm after `n_sp` spikes in a row, [Zhao2023] Eq. (15).

    The level saturates. Scores therefore compare the mean excitation, which determines the level.
    They compare the level of a model whose potential has a fixed scale already.
    """

    column, key, quantity, scored = "level", "t_mp", "normalised MP", "excitation"
    counts = (1, 2, 3, 4)
    calibrated = "kappa (LGMD: t_mp) and n_sp"

    def __init__(self, params: Parameters, *, by_sequence: bool = False) -> None:
        super().__init__(params, by_sequence=by_sequence)
        self.n_in_a_row = params.n_sp
        self._compares_level = by_sequence or params.rest is not None
        # With degrees and ms, spikes last for the time of `n_sp` frames of the paper's camera.
        self._lasting_s = 0.0
        if in_degrees(params):
            self.n_in_a_row, self._compares_level, self.scored = 1, True, "signal"
            self._lasting_s = (params.n_sp - 1 - _EARLY) * FRAME_S
        self.reset()

    def reset(self) -> None:
        """Forget the levels of the last frames."""
        self._levels: list[tuple[float, float]] = []

    def value(self, row: Detection) -> float:
        """The level; for a model in degrees, the least one in the time of `n_sp` frames."""
        if self._lasting_s <= 0.0:
            return row.level
        self._levels.append((row.time_s, row.level))
        while len(self._levels) > 1 and row.time_s - self._levels[1][0] >= self._lasting_s:
            del self._levels[0]
        is_known = row.time_s - self._levels[0][0] >= self._lasting_s
        return min(level for _, level in self._levels) if is_known else math.nan

    @property
    def text(self) -> str:
        """The rule in words."""
        lasting = f"{self.n_in_a_row} in a row"
        if in_degrees(self.params):
            lasting = f"for {1e3 * (self.params.n_sp - 1) * FRAME_S:.0f} ms"
        level = f"a {self.quantity}" if self._is_normalised else "an MP"
        return f"spikes: {lasting}, at {level} of {self.threshold:g} or more"

    @property
    def _is_normalised(self) -> bool:
        """Whether the level is a normalised MP: one of a fixed scale is not."""
        return self.by_sequence or self.params.rest is None

    @classmethod
    def side(cls, cells: ImagePoint, expansion: ImagePoint) -> str:
        """The `side_of` the active cells."""
        return side_of(*cells)

    @property
    def line_text(self) -> str:
        """The label of the threshold's line in figures, which is also that of spikes."""
        return f"threshold {self.threshold:g}"

    def peak_text(self, signal: float) -> str:
        """The highest level of an alarm in words."""
        return f"{self.quantity if self._is_normalised else 'MP'} up to {signal:.2f}"

    def strength_at(self, signal: float) -> float:
        """The mean excitation at a level."""
        return signal if self._compares_level else excitation_at(signal, self.params.kappa)

    def value_at(self, strength: float) -> float:
        """The level at a mean excitation."""
        if self._compares_level or math.isinf(strength):
            return strength
        return float(absolute(strength, 1, self.params.kappa))

    def excitation_at(self, strength: float) -> float:
        """The strength itself."""
        return strength

    def chosen(self, strength: float, n_in_a_row: int) -> dict[str, float]:
        """The number of spikes, and the mean excitation at the threshold."""
        return {"n_sp": n_in_a_row, "excitation": strength}

    def tuned(self, strength: float, n_in_a_row: int) -> Parameters:
        """The parameters with a new `n_sp` and a new κ (four digits), or T_MP if there is no κ."""
        params = self.params
        if in_degrees(params):
            raise ParameterError("", "a model in degrees cannot be tuned", "Choose units=pixels.")
        if params.kappa is None:
            spec = params.specs()["t_mp"]
            t_mp = min(max(self.value_at(strength), spec.low), spec.high)
            return changed(params, t_mp=t_mp, n_sp=n_in_a_row)
        t_mp = params.t_mp if 0.0 < params.t_mp < 1.0 else _T_MP
        kappa = self._limited("kappa", strength / excitation_at(t_mp, 1.0))
        return changed(params, kappa=kappa, t_mp=t_mp, n_sp=n_in_a_row)


class Ttc(Rule, name="ttc"):
    """An alarm while the time to contact is `ttc_alarm` or less."""

    column, key, quantity = "ttc_s", "ttc_alarm", "time to contact"
    at_most = follows_speed = True


class Ahead(Rule, name="expansion"):
    """An alarm while what stands ahead expands at `expansion_alarm` or more.

    The rate of what stands ahead is the lesser of the expansion and that of what stands upright,
    which leaves out level ground. Below `LEAST_QUALITY`, the rate counts in proportion to the
    quality. An object that approaches a camera at rest has the same threshold.
    """

    column, key, quantity = "expansion", "expansion_alarm", "expansion"
    follows_speed = True

    def value(self, row: Detection) -> float:
        """The larger of the rate ahead and `approach`."""
        ahead = self._rate_ahead(row) * min(row.expansion_quality / LEAST_QUALITY, 1.0)
        return float(np.fmax(ahead, row.approach))

    def limit(self, row: Detection, signal: float) -> str:
        """What holds the signal below the expansion: the cause that takes more, if several do."""
        if not signal < row.expansion:
            return ""
        if row.approach >= signal > 0.0:
            return APPROACH
        share, quality = self._rate_ahead(row) / row.expansion, row.expansion_quality
        return GROUND if share < quality / LEAST_QUALITY else QUALITY

    @staticmethod
    def _rate_ahead(row: Detection) -> float:
        """The lesser of the two rates, see the class."""
        return min(row.expansion, row.expansion_upright)

    @staticmethod
    def as_time(value: float) -> float:
        """`RATE_TIMES_TIME` / value; infinite for an image that does not expand."""
        return math.inf if value <= 0.0 else RATE_TIMES_TIME / value


class Corridor(Ahead, name="corridor"):
    """An alarm while points in the drone's way approach at `corridor_alarm` or more.

    At frames at which the drone's motion is unknown, or the drone is slow, the signal is that of
    the rule `expansion`, in proportion to the two thresholds.
    """

    column, key, quantity = "corridor", "corridor_alarm", "rate in the way"

    def __init__(self, params: Parameters, *, by_sequence: bool = False) -> None:
        super().__init__(params, by_sequence=by_sequence)
        self._ahead = Ahead(params)

    def value(self, row: Detection) -> float:
        """The rate in the way, else that of the rule `expansion`."""
        if not math.isnan(row.corridor):
            return row.corridor
        return super().value(row) * self.threshold / self._ahead.threshold

    def thresholds_at(self, time_s: float) -> dict[str, float]:
        """That of the rule `expansion`, too."""
        return super().thresholds_at(time_s) | self._ahead.thresholds_at(time_s)

    def follow(self, params: Parameters) -> None:
        """Take the thresholds of both rules."""
        super().follow(params)
        self._ahead.follow(params)

    def limit(self, row: Detection, signal: float) -> str:
        """What holds the signal of the rule `expansion`, where it is the signal."""
        if not math.isnan(row.corridor):
            return ""
        return super().limit(row, super().value(row))

    @staticmethod
    def as_time(value: float) -> float:
        """`IN_WAY_TIMES_TIME` / value; infinite if nothing is in the way."""
        return math.inf if value <= 0.0 else IN_WAY_TIMES_TIME / value


def rule_named(name: str) -> type[Rule]:
    """The rule called `name`; raises ParameterError if there is none."""
    require_known("rule", name, RULES)
    module, _, kind = RULES[name].place.partition(":")
    rule: type[Rule] = getattr(import_module(module), kind)
    return rule


def rule_of(params: Parameters, *, by_sequence: bool = False) -> Rule:
    """The rule that `params` names, before the first frame.

    Raises ParameterError if there is no such rule, and ModelError if a rule of one's own fails.
    """
    with blamed(params.alarm, "__init__()", noun="rule"):
        rule = rule_named(params.alarm)(params, by_sequence=by_sequence)
    rule.restart()
    return rule


def too_slow(rule: Rule, time_s: Series) -> str:
    """A warning if new frames come too slowly for a rule, else empty.

    `time_s` are the times of the new frames in seconds, shape (n,).
    """
    # A median without NumPy's `median`, which would import masked arrays.
    intervals_s = np.sort(np.diff(time_s))
    rate_fps = 1.0 / intervals_s[intervals_s.size // 2] if intervals_s.size else math.inf
    if in_degrees(rule.params) and rate_fps < _DEGREES_MIN_FPS - 0.1:
        needs = f"a model in degrees needs {_DEGREES_MIN_FPS:g} frames/s"
        return f"{rate_fps:.3g} frames/s: {needs}, and may miss an approach"
    if not rule.uses_expansion or rate_fps >= MIN_FPS - 0.1:
        return ""
    return (
        f"{rate_fps:.3g} frames/s: expansion rates are unreliable below {MIN_FPS:g} frames/s, and "
        f"an alarm may be late by a frame, {1.0 / rate_fps:.2g} s"
    )


def side_of(g_x: float, g_y: float) -> str:
    """The image region that a centroid lies in.

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
