"""`Result`: the response of a model to a video, and all quantities derived from the response."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter
from pathlib import PurePath
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import argument, counted
from dlgmd_cli.frame import Flags as Flags
from dlgmd_cli.frame import Series as Series
from dlgmd_cli.frame import runs_of
from dlgmd_cli.models import detection, normalise
from dlgmd_cli.models.base import Response
from dlgmd_cli.models.columns import ALARMS
from dlgmd_cli.models.rules import Rule, rule_of, too_slow
from dlgmd_cli.parameters.facts import InputFacts, Json, Record, Summary, defined, for_json, stating
from dlgmd_cli.parameters.presets import DlgmdParameters, Parameters, load_set
from dlgmd_cli.results import annotations, csv, store
from dlgmd_cli.results.annotations import PLOT_ARGUMENTS
from dlgmd_cli.results.files import DRAWN
from dlgmd_cli.results.judging import judged
from dlgmd_cli.results.names import frames_text, part_text, recorded_name
from dlgmd_cli.results.outcome import Outcome, Shown, as_html, drawn_by
from dlgmd_cli.results.record import record_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Distinguishability averages this many frames on either side of a peak or a false positive.
_NEAR_FRAMES = 5
INFINITE_DISTINGUISHABILITY = (
    "inf: the membrane potential is 0 within 5 frames of the false positive."
)
# The first frame at which all of the paper's sets are valid; sharpness starts at this frame.
FIRST_COMMON_ROW = 3
_HEADER = "# Written by dlgmd. 'dlgmd run INPUT --config' with this file repeats the run.\n"
# Maximum number of alarms that a terminal lists.
_MAX_LISTED = 5
# The shortest time (s) above the threshold without an alarm that a terminal tells.
_HELD_S = 0.2


@dataclass(eq=False, repr=False)
class Result(Outcome):
    """The response of a model to a video.

    Every column of the tables is an attribute, an array of shape (n,) with one entry per processed
    frame, such as ``time_s``, ``mp``, ``expansion`` or ``signal``; `csv.COLUMNS` declares them, and
    "Files and columns" lists them with their units. Numbers are NaN where undefined.

    Attributes
    ----------
    rows : ndarray, shape (n,), of type `csv.row_type`
        The rows; a model's own columns are last.
    params : Parameters
        Parameters of the model.
    record : dict
        Contents of `run.yaml` without the summary and the versions.

    Notes
    -----
    If the record has a `collision_frame`, the peak, `sharpness` and `distinguishability` use only
    the frames up to this frame: later frames show the recoil. `mp_seq` is scaled over all frames.
    """

    RECORD = store.RUN
    FIGURES = dict.fromkeys(annotations.KINDS, "traces.plot")
    WRITTEN = DRAWN

    rows: csv.Rows
    params: Parameters
    record: Record

    @classmethod
    def of(cls, rows: csv.Rows, params: Parameters, record: Record) -> "Result":
        """The result of a whole video; if the record says so, its spikes follow `mp_seq`."""
        result = cls(rows, params, record)
        if not result.by_sequence:
            return result
        rows = rows.copy()
        rows["level"] = result.mp_seq
        return replace(result, rows=judged(rows, result.rule))

    def __getattr__(self, name: str) -> Any:
        """A column of the rows, shape (n,)."""
        if name.startswith("__") or name not in (self.rows.dtype.names or ()):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return self.rows[name]

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *(self.rows.dtype.names or ())})

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        onsets = self.time_s[self.alarm_onsets]
        path = str(self.record.get("input", {}).get("path", ""))
        alarms = f"{len(onsets)} alarms, the first" if len(onsets) > 1 else "alarm"
        says = f"{alarms} at {onsets[0]:.2f} s" if len(onsets) else "no alarm"
        what = f"{PurePath(path).name or self.name}: {counted(len(self), 'frame')}"
        warned = f", {counted(len(self.warnings), 'warning')}" if self.warnings else ""
        return f"<Result {what}, {self.label}, {says}{warned}>"

    def _repr_html_(self) -> str:
        """The summary and the main figure: what a notebook shows of a result by itself."""
        return as_html(self.shown(), self.plot())

    @property
    def name(self) -> str:
        """Name of the input."""
        return recorded_name(self.record.get("input", {}))

    @property
    def label(self) -> str:
        """Name of the model: its label in a comparison, else its set, preset, or own name."""
        record, model = self.record, self.params.model.rpartition(":")[2]
        named = f"set{record['set']}" if "set" in record else record.get("preset")
        return str(record.get("label") or named or model)

    @property
    def warnings(self) -> list[str]:
        """Warnings about the result, one line each."""
        return self.record.setdefault("warnings", [])

    @property
    def by_sequence(self) -> bool:
        """Whether spikes follow `mp_seq` instead of `mp_abs`."""
        return bool(self.record.get("options", {}).get("normalise") == "sequence")

    @property
    def n_cells(self) -> int:
        """Number of cells that K sums over: the pixels of a frame that no mask hides."""
        processed = self.record["processed"]
        return int(processed.get("cells", processed["width"] * processed["height"]))

    @property
    def n_valid(self) -> int:
        """Number of frames with a defined membrane potential."""
        return int(np.count_nonzero(~np.isnan(self.mp)))

    @property
    def collision_frame(self) -> int | None:
        """Frame of the camera's collision, None if unknown."""
        frame = self.record.get("collision_frame")
        return frame if isinstance(frame, int) else None

    @property
    def title(self) -> str:
        """The result's name in figures: its input and its model."""
        return f"{self.name} · {self.label}"

    @property
    def contact_s(self) -> float | None:
        """Time of the camera's collision in seconds, None if unknown.

        The time is that of `collision_frame`, else from the ground truth of a rendered clip.
        """
        if self.collision_frame is not None:
            return float(np.interp(self.collision_frame, self.frame, self.time_s))
        known = self.record.get("input", {}).get("contact_s")
        return None if known is None else float(known)

    def times_of(self, frames: Iterable[int]) -> list[float]:
        """The times, in seconds, of the frames that lie within the result."""
        first, last = self.frame[[0, -1]]
        within = [frame for frame in frames if first <= frame <= last]
        return [float(time_s) for time_s in np.interp(within, self.frame, self.time_s)]

    def until(self, collision_frame: int | None) -> "Result":
        """The result with `collision_frame` set; unchanged for None."""
        if collision_frame is None:
            return self
        record: Record = {
            **self.record,
            "warnings": [*self.warnings],
            "collision_frame": collision_frame,
        }
        return replace(self, record=record)

    @cached_property
    def _mp_before(self) -> Series:
        """Raw membrane potential up to the collision, NaN after it."""
        if self.collision_frame is None:
            return self.mp
        return np.where(self.frame <= self.collision_frame, self.mp, np.nan)

    @cached_property
    def mp_seq(self) -> Series:
        """Membrane potential scaled by its min–max over the whole video, in [0, 1]; offline."""
        return normalise.sequence(self.mp)

    @property
    def excitation(self) -> Series:
        """What determines the level: mean excitation per cell, `mp_seq`, or an `mp` with a rest."""
        if self.by_sequence:
            return self.mp_seq
        return self.mp / self.n_cells if self.params.rest is None else self.mp

    @property
    def threshold(self) -> float:
        """Level at which a spike is raised, T_MP of [Zhao2023] Eq. (14)."""
        return self.rule.params.t_mp

    @cached_property
    def rule(self) -> Rule:
        """The rule of the alarm, with the threshold of the normalisation."""
        params = normalise.params_at_scale(self.params, by_sequence=self.by_sequence)
        return rule_of(params, by_sequence=self.by_sequence)

    @property
    def strength(self) -> Series:
        """What scores compare with thresholds: larger means nearer to an alarm; NaN if undefined.

        It is the rule's signal, for `ttc` its negative, and for `spikes`, whose signal saturates,
        the mean excitation. Of a rule that was read but is not known, it is 1 in alarms, else 0.
        """
        values: Series = np.asarray(getattr(self, self.rule.scored), np.float64)
        return -values if self.rule.at_most else values

    @property
    def is_repeat(self) -> Flags:
        """Whether a row is a copy: a duplicate frame after the warm-up."""
        return self.rows["repeat"]

    @property
    def spikes(self) -> Flags:
        """Where the level reaches the threshold, [Zhao2023] Eq. (14)."""
        return self.rows["spike"]

    @property
    def new_spikes(self) -> Flags:
        """The spikes without copies on duplicate frames: the spikes that are counted and shown."""
        return self.spikes & ~self.is_repeat

    @property
    def alarms(self) -> Flags:
        """Where the alarm is on by its rule, see `Rule`."""
        return self.rows["alarm"]

    @cached_property
    def alarm_spans(self) -> npt.NDArray[np.intp]:
        """First and last row of every alarm, (n, 2); a pause below 0.3 s ends no alarm."""
        return detection.spans(self.alarms, self.time_s)

    @property
    def alarm_onsets(self) -> npt.NDArray[np.intp]:
        """Rows at which an alarm is raised: the first rows of `alarm_spans`."""
        return self.alarm_spans[:, 0]

    @property
    def alarmed(self) -> Flags:
        """Where an alarm lasts, including pauses below 0.3 s, as figures show alarms."""
        turns = np.zeros(len(self) + 1, np.int64)
        turns[self.alarm_spans[:, 0]], turns[self.alarm_spans[:, 1] + 1] = 1, -1
        return turns[:-1].cumsum() > 0

    @property
    def alarm_list(self) -> list[detection.AlarmSpan]:
        """The alarms with times, strength and place; the rows of alarms.csv."""
        return [
            self._alarm(self.rows[first : last + 1].view(np.recarray))
            for first, last in self.alarm_spans.tolist()
        ]

    def _alarm(self, rows: Any) -> detection.AlarmSpan:
        """The alarm over some rows, of which the first raises it."""
        first, rule = rows[0], self.rule
        side = rule.side((first.g_x, first.g_y), (first.expansion_x, first.expansion_y))
        alarm = detection.AlarmSpan.at(first, rule.name, side)
        for row in rows[rows.alarm][1:]:
            alarm = alarm.until(row, at_most=rule.at_most)
        return alarm

    @property
    def held(self) -> list[tuple[int, int, str]]:
        """Stretches of 0.2 s or more beyond the threshold by the raw number, but without an alarm.

        First and last row of each, and the word that most of its rows have in `signal_limit`.
        """
        if not self.rule.column:
            return []
        raw: Series = getattr(self, self.rule.column)
        flags = (raw >= self.rule.threshold) & (self.signal_limit != "") & ~self.alarmed
        found = []
        for first, after in runs_of(flags).tolist():
            if self.time_s[after - 1] - self.time_s[first] >= _HELD_S - detection.ROUNDING_S:
                words = Counter(self.signal_limit[first:after].tolist())
                found.append((first, after - 1, words.most_common(1)[0][0]))
        return found

    @property
    def blind_spans(self) -> list[tuple[int, int, str]]:
        """First and last row of each stretch in which `blind` has a reason, and the reason."""
        return [
            (first, after - 1, reason)
            for reason in dict.fromkeys(self.blind[self.blind != ""].tolist())
            for first, after in runs_of(self.blind == reason).tolist()
        ]

    @property
    def blind_share(self) -> float:
        """Share of the time in which `blind` has a reason."""
        steps_s = np.diff(self.time_s)
        blind_s = float(steps_s[self.blind[:-1] != ""].sum())
        return blind_s / float(steps_s.sum()) if blind_s else 0.0

    @cached_property
    def summary(self) -> Summary:
        """The main numbers of the result; None where undefined.

        `rule` (the alarm rule, see `Rule`), `mp_max`, `mp_max_frame`, `mp_max_time_s` (the peak of
        the raw membrane potential), `spikes` (number of spiking frames without duplicates),
        `first_spike_time_s`, `alarms` (those less than 0.3 s apart are one), `first_alarm_frame`,
        `first_alarm_time_s`, `first_alarm_side` (such as ``left high``, see `side_of`),
        `first_alarm_ttc_s` (estimated time to contact), `blind_share` and the `attenuations`.
        """
        peak, alarms = self._peak_row, self.alarm_list
        spiking = np.flatnonzero(self.new_spikes)
        return {
            "rule": self.rule.name,
            "mp_max": None if peak is None else float(self.mp[peak]),
            "mp_max_frame": None if peak is None else int(self.frame[peak]),
            "mp_max_time_s": None if peak is None else float(self.time_s[peak]),
            "spikes": int(spiking.size),
            "first_spike_time_s": float(self.time_s[spiking[0]]) if spiking.size else None,
            "alarms": len(alarms),
            "first_alarm_frame": alarms[0].start_frame if alarms else None,
            "first_alarm_time_s": alarms[0].start_s if alarms else None,
            "first_alarm_side": (alarms[0].side or None) if alarms else None,
            "first_alarm_ttc_s": defined(alarms[0].ttc_s) if alarms else None,
            "blind_share": self.blind_share,
            **self.attenuations,
        }

    @property
    def attenuations(self) -> Summary:
        """Statistics of the attenuation over new frames with a defined value; None without any.

        `mean_attenuation_db` is over the frames with a finite value; `attenuation_frames` is the
        number of these frames and differs between models. `median_attenuation_db` is over all of
        the frames, and `pooled_attenuation_db` is 10 lg(ΣΣS/ΣΣP), over all cells and frames.
        """
        rows = self.rows[~self.is_repeat & ~np.isnan(self.attenuation_db)]
        in_db = rows["attenuation_db"]
        passing = in_db[np.isfinite(in_db)]
        pooled = Response(math.fsum(rows["p_sum"]), math.fsum(rows["s_sum"])).attenuation_db
        return {
            "mean_attenuation_db": math.fsum(passing) / passing.size if passing.size else None,
            "attenuation_frames": int(passing.size),
            "median_attenuation_db": float(median(in_db.tolist())) if in_db.size else None,
            "pooled_attenuation_db": defined(pooled),
        }

    @property
    def sharpness(self) -> float:
        """Breadth of the response: the mean of K/max K over the valid frames. Lower is sharper.

        The mean starts at the fourth frame, which is valid in all of the paper's sets, so that all
        models are compared on the same frames. NaN if no frame is valid, or if the membrane
        potential is due to rounding, see `normalise.LEAST_PEAK`.
        """
        common = self._mp_before[~self.is_repeat][FIRST_COMMON_ROW:]
        valid = common[~np.isnan(common)]
        peak = float(valid.max()) if valid.size else 0.0
        return float((valid / peak).mean()) if peak >= normalise.LEAST_PEAK else math.nan

    def distinguishability(self, false_positive_frame: int) -> float:
        """Distinguishability DA: the mean K near the peak over the mean K near a false positive.

        Each mean is over the valid, new frames at most 5 frame numbers away. Infinite if only the
        mean near the false positive is 0; NaN if the peak is due to rounding, or if one of the
        means has no frames.
        """
        if self._peak_row is None or self.mp[self._peak_row] < normalise.LEAST_PEAK:
            return math.nan
        response = self._mean_near(int(self.frame[self._peak_row]))
        mistake = self._mean_near(false_positive_frame)
        if mistake == 0.0:
            return math.inf if response > 0.0 else math.nan
        return response / mistake

    def _lapses(self) -> list[str]:
        """Lines about a potential that is infinite, or undefined after it was defined."""
        infinite = np.flatnonzero(np.isinf(self.mp))
        if infinite.size:
            where = f"in {counted(infinite.size, 'frame')}, from frame {self.frame[infinite[0]]} on"
            return [f"the membrane potential is infinite {where}: a sum is too large"]
        is_nan = np.isnan(self.mp)
        ends = np.flatnonzero(is_nan[1:] & ~is_nan[:-1] & ~self.gap[1:])
        if not ends.size:
            return []
        return [f"the membrane potential is undefined (NaN) at frame {self.frame[ends[0] + 1]}"]

    def doubts(self) -> list[str]:
        """Warnings about an implausible result, one line each."""
        lines = self._lapses()
        if not lines and self.n_valid and not np.isfinite(self.level).any():
            lines.append(
                "the membrane potential never changes by more than rounding, so it cannot be "
                "scaled by its per-video min–max; there are no spikes"
            )
        if not self.by_sequence and self._has_foreign_kappa():
            lines.append(
                f"kappa {self.params.kappa:g} was calibrated for "
                f"{argument('formulation', 'default')}; with other latencies or limits mp_abs and "
                f"alarms mean little. Use {argument('normalise', 'sequence')}, or a kappa from "
                "'dlgmd calibrate'"
            )
        if ":" in self.rule.name and self.n_valid and np.isnan(self.signal).all():
            lines.append(f"{self.rule.name}, value(): it returns NaN in all frames")
        if slow := too_slow(self.rule, self.time_s[~self.is_repeat]):
            lines.append(slow)
        return lines

    def _has_foreign_kappa(self) -> bool:
        """Whether κ is the set's value although latency or limits differ from the set's."""
        if type(self.params) is not DlgmdParameters or "set" not in self.record:
            return False
        params, usual = self.params, load_set(self.record["set"])
        scale = attrgetter("latency", "saturate", "grouping")
        return params.kappa == usual.kappa and scale(params) != scale(usual)

    def columns(self, names: Iterable[str]) -> csv.Table:
        """Some columns of the CSVs, one row per frame: a structured array, shape (n,)."""
        stored = self.rows.dtype.names or ()
        return csv.table_from(
            {
                name: self.rows[name]
                if name in stored
                else np.broadcast_to(getattr(self, name), len(self))
                for name in names
            }
        )

    @property
    def complete(self) -> bool:
        """Whether the whole input was used: no part was left out, damaged, or not reached."""
        return bool(self.record.get("complete", True))

    @property
    def interrupted(self) -> bool:
        """Whether the user stopped the run before the end."""
        return bool(self.record.get("interrupted", False))

    @property
    def table(self) -> csv.Table:
        """All columns of the CSVs, one row per frame: a structured array, shape (n,)."""
        return self.columns([*csv.COMPARISON[1:], *self.own_columns])

    @property
    def own_columns(self) -> tuple[str, ...]:
        """The names of the model's own columns, see `Model.columns`."""
        return (self.rows.dtype.names or ())[len(csv.row_type().names or ()) :]

    def record_text(self) -> str:
        """The text of run.yaml."""
        record: Record = {**self.record, "summary": self.summary}
        return record_text(record, _HEADER)

    def identity(self) -> InputFacts:
        """The identity of the input, from the record."""
        return self.record.get("input", {})

    @stating(PLOT_ARGUMENTS)
    def plot(self, kind: str | None = "mp", **options: Any) -> "Figure":
        """A figure: `mp`, `attenuation`, `spikes`, `ttc`, `overview`, or a column by its name.

        `options` are as in `dlgmd_cli.plot`: ``ax``, ``mark``, ``collision_frame`` and others.
        Raises ParameterError if there is no such figure.
        """
        if kind in self.own_columns:
            return self.figure(kind, **options)
        return super().plot(kind, **options)

    @stating(PLOT_ARGUMENTS)
    def figure(self, kind: str, **options: Any) -> "Figure":
        """Draw a kind of figure, or a column."""
        return drawn_by("traces.plot")(kind, {self.title: self}, **options)

    def facts(self) -> dict[str, Json]:
        """The JSON object of the result."""
        return {
            "result": str(self.paths[0]) if self.paths else None,
            "complete": self.complete,
            "warnings": self.warnings,
            "frames": self.record["processed"]["frames"],
            **for_json(self.summary),
            "alarm_list": [alarm.to_dict() for alarm in self.alarm_list],
        }

    def shown(self) -> Iterator[Shown]:
        """The items that a terminal shows: the summary, and the paths of the files."""
        summary, processed = self.summary, self.record["processed"]
        peak = spikes = attenuation = "none"
        if summary["mp_max"] == 0.0:
            peak = f"0: {self._silence()}"
        elif summary["mp_max"] is not None:
            peak = "{mp_max:.6g} at frame {mp_max_frame}, {mp_max_time_s:.3f} s".format(**summary)
        if summary["spikes"]:
            spikes = "{spikes}, the first at {first_spike_time_s:.3f} s".format(**summary)
        if summary["median_attenuation_db"] is not None:
            attenuation = f"{summary['median_attenuation_db']:.2f} dB"
        model = self.params.model
        frames = "{} at {width}x{height}".format(frames_text(self.record), **processed)
        frames += "" if self.complete else part_text(self.time_s.tolist())
        rows = [
            ("model", self.label if self.label == model else f"{self.label} ({model})"),
            ("alarm rule", self.rule.text),
            ("alarms", f"{summary['alarms'] or 'none'}"),
            *(("", line) for line in listed(self.alarm_list, self.rule)),
            *self.silences.items(),
            ("frames", frames),
            *self._camera(),
            ("peak MP", peak),
            ("spikes", spikes),
            ("median attenuation", attenuation),
        ]
        yield ("", ""), rows
        yield from self.paths

    @property
    def silences(self) -> dict[str, str]:
        """Where an alarm may be missing: `no alarm`, what held it back; `blind`, and why."""
        return dict((*self._held_back(), *self._blindness()))

    def _held_back(self) -> Iterator[tuple[str, str]]:
        """The row of the longest stretch in `held`, if any."""
        held = self.held
        if held:
            first, last, limit = max(held, key=lambda one: one[1] - one[0])
            raw = getattr(self, self.rule.column)[first : last + 1].max()
            when = f"{self.time_s[first]:.3f} to {self.time_s[last]:.3f} s"
            more = f" (and {len(held) - 1} more)" if len(held) > 1 else ""
            yield "no alarm", f"{when}, {self.rule.peak_text(raw)}, held back by {limit}{more}"

    def _blindness(self) -> Iterator[tuple[str, str]]:
        """The row of the blind time, with its longest stretch, if any."""
        if spans := self.blind_spans:
            first, last, _ = max(spans, key=lambda one: self.time_s[one[1]] - self.time_s[one[0]])
            reasons = ", ".join(dict.fromkeys(reason for *_, reason in spans))
            when = f"longest from {self.time_s[first]:.3f} to {self.time_s[last]:.3f} s"
            yield "blind", f"{reasons}: {100 * self.blind_share:.1f} % of the time, {when}"

    def _camera(self) -> Iterator[tuple[str, str]]:
        """The row of the camera's angles, which says what is assumed; none without a camera."""
        camera, given = self.record.get("camera"), self.record.get("options", {})
        if camera:
            fov, tilt = ("" if key in given else " assumed" for key in ("fov", "camera_tilt"))
            text = f"fov {camera['fov']:g}°{fov}, camera tilt {camera['camera_tilt']:g}°{tilt}"
            yield "camera", text

    def _silence(self) -> str:
        """Why the membrane potential is 0 throughout."""
        width, made_for = self.record["processed"]["width"], self.record.get("width_px", 0)
        if not (self.p_sum > 0.0).any():
            return "no frame differs from the one before"
        if width < made_for / 4:
            return f"frames {width} px wide are too small for a neuron made for {made_for:g} px"
        return "everything was suppressed"

    def kept(self) -> str:
        """The sentence that says what exists after an interruption."""
        part = f"the {counted(len(self), 'frame')} processed before the interruption"
        return f"{self.paths[0]} holds {part if self.interrupted else 'the whole result'}"

    @cached_property
    def _peak_row(self) -> int | None:
        """Row of the largest membrane potential up to the collision; None if undefined."""
        before = self._mp_before
        return None if np.isnan(before).all() else int(np.nanargmax(before))

    def _mean_near(self, frame: int) -> float:
        """Mean K over the valid, new frames near `frame`; NaN if there are no such frames."""
        near = self._mp_before[(np.abs(self.frame - frame) <= _NEAR_FRAMES) & ~self.is_repeat]
        valid = near[~np.isnan(near)]
        return float(valid.mean()) if valid.size else math.nan


def listed(alarms: list[detection.AlarmSpan], rule: Rule) -> list[str]:
    """The first alarms, one line each, and a line with the number of further alarms."""
    lines = []
    for alarm in alarms[:_MAX_LISTED]:
        ahead = "" if math.isnan(alarm.ttc_s) else f", estimated contact in {alarm.ttc_s:.2f} s"
        lines.append(
            f"{alarm.start_s:.3f} to {alarm.end_s:.3f} s, "
            f"frames {alarm.start_frame} to {alarm.end_frame}"
            f"{', ' if alarm.side else ''}{alarm.side}{ahead}, {rule.peak_text(alarm.peak_signal)}"
        )
    n_more = len(alarms) - len(lines)
    return [*lines, f"and {n_more} more in {ALARMS}"] if n_more else lines
