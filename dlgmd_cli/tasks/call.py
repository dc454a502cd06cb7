"""Shared by all tasks: requested models, progress, the open input and its messages."""

import logging
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import DlgmdError, ParameterError, argument, counted, warn
from dlgmd_cli.models import stopping
from dlgmd_cli.models.own_rules import own_rule
from dlgmd_cli.models.rules import Rule, rule_of
from dlgmd_cli.parameters import presets
from dlgmd_cli.parameters.checks import in_argument, refuse
from dlgmd_cli.parameters.facts import Record, Value, extended
from dlgmd_cli.parameters.keys import (
    CORRIDOR,
    DEGREES,
    EXPANSION,
    RULES,
    SPIKES,
    changed,
    in_degrees,
)
from dlgmd_cli.parameters.presets import Config, DlgmdParameters, Parameters
from dlgmd_cli.results import store
from dlgmd_cli.results.names import numbered
from dlgmd_cli.tasks.camera import has_motion
from dlgmd_cli.video.base import MAX_SIDE, ImageOptions
from dlgmd_cli.video.input_options import CHECKS, INPUT_ARGUMENTS, InputOptions
from dlgmd_cli.video.opening import (
    ONLY_FOR,
    Openable,
    content_sha256,
    open_input,
    processed_size,
    require_used,
)
from dlgmd_cli.video.source import Video
from dlgmd_cli.video.writer import clips_of, make_clips, spans_of

_log = logging.getLogger(__name__)

DEFAULT_PRESET, DLGMD = presets.PRESETS[0], DlgmdParameters.model

Place = str | os.PathLike[str]
OnFrame = Callable[[int], None]
# Takes a name, a total (None if unknown) and a unit; yields a callback, which takes the number done
# and, optionally, a new name.
Progress = Callable[[str, int | None, str], AbstractContextManager[Callable[..., None]]]


# Name -> type of the options of an input and of the rule, and of a run, as arguments.
RULE_ARGUMENTS: dict[str, Any] = {
    **INPUT_ARGUMENTS,
    "alarm": str | type[Rule] | None,
    "threshold": float | None,
}
RUN_ARGUMENTS: dict[str, Any] = {
    **RULE_ARGUMENTS,
    "speed_m_s": float | None,
    "brake": str | float | None,
}


@dataclass(frozen=True)
class Setup:
    """One model of a run: its parameters, and the configuration that they come from.

    `label` is the name in messages and figures: that of the configuration, or the user's.
    `options` are those of the run that wrote the configuration, if it is a `run.yaml`.
    `model_sha256` is the hash of the file that defines a custom model; empty for other models.
    """

    params: Parameters
    label: str
    config: Config = field(default_factory=partial(Config, ""))
    options: InputOptions = field(default_factory=InputOptions)
    model_sha256: str = ""

    def size_on(self, video: Video, options: InputOptions) -> tuple[int, int]:
        """Size of the processed frames, (width, height) in px: by option, else by the model."""
        chosen = self.options if options.scale is None and options.size is None else options
        return processed_size(
            *video.source_wh,
            scale=chosen.scale,
            size_wh=chosen.size,
            width_px=self.width_px,
        )

    @property
    def width_px(self) -> int:
        """The greatest width of the model's frames, in px; a model in degrees takes any."""
        return MAX_SIDE if in_degrees(self.params) else self.config.width_px

    @property
    def model_fps(self) -> float:
        """The greatest frame rate of the model, in frames/s; a model in degrees takes any."""
        return math.inf if in_degrees(self.params) else self.config.model_fps

    def settings(self) -> Record:
        """Entries of the model in a record, without the options."""
        design: Record = {
            "model": self.params.model,
            "width_px": self.config.width_px,
            "model_fps": self.config.model_fps,
        }
        if self.model_sha256:
            design["model_sha256"] = self.model_sha256
        return extended(design, self.params.to_dict())


@dataclass(frozen=True)
class Request:
    """The request to a task: one or several models, and the options of the input.

    `given` names the options that the user gave, and that not every input uses: `open` refuses
    those without effect. `for_any_of` does so for several inputs.
    """

    setups: tuple[Setup, ...]
    options: InputOptions
    given: frozenset[str] = frozenset()

    @property
    def setup(self) -> Setup:
        """The only model, or the first of several."""
        return self.setups[0]

    def by_spikes(self) -> "Request":
        """The same request with the rule `spikes`, for runs that do not measure the expansion."""
        setups = [
            replace(setup, params=changed(setup.params, alarm=SPIKES)) for setup in self.setups
        ]
        return replace(self, setups=tuple(setups))

    def open(self, source: Openable, formulations: Iterable[str] = ()) -> Video:
        """Open an input for the models; raises the errors of `open_video`.

        By default, the first model determines the frame size, and the fastest model the frame rate.
        If a model has a released formulation, or `formulations` name one, every frame is read,
        duplicates included.
        """
        named = [setup.params.to_dict().get("formulation") for setup in self.setups]
        is_released = any(str(name).startswith("released") for name in (*formulations, *named))
        model_fps = max(setup.model_fps for setup in self.setups)
        video = open_input(
            source,
            self.options,
            width_px=self.setup.width_px,
            model_fps=None if is_released else model_fps,
        )
        with ExitStack() as stack:
            stack.push(video)
            require_used(self.given, [video.unused])
            stack.pop_all()
        return video

    def for_any_of(self, paths: Iterable[str]) -> "Request":
        """The same request for several inputs, at least one of which uses each given option.

        Files that cannot be opened are left out; the options may be meant for those of a URL.
        """
        asked, request = self.given, replace(self, given=frozenset())

        def unused() -> Iterator[Mapping[str, str]]:
            for path in paths:
                if store.is_url(path):
                    yield {}
                with suppress(DlgmdError), request.open(path) as video:
                    yield video.unused

        require_used(asked, unused() if asked else ())
        return request


# A model, by anything that `config_of` accepts, or a setup that was chosen before.
ModelName = presets.ModelName | Setup
# Several models.
ModelNames = list[ModelName] | tuple[ModelName, ...]


def choose(
    model: ModelName | None = None,
    param: Mapping[str, Value] | None = None,
    formulation: str | None = None,
) -> Setup:
    """The model of a name, with single parameters overridden.

    `param` and `formulation` take precedence over the set or file, which takes precedence over the
    defaults. For `model`, see `config_of`; a setup is returned unchanged.

    Raises ParameterError if the set, file or model does not exist, or a parameter is not valid.
    """
    if isinstance(model, Setup):
        return model
    file = presets.config_of(model)
    kind = presets.kind_of(file)
    values = dict(param or {})
    if formulation is not None:
        if "formulation" not in kind.specs():
            raise ParameterError("", f"{argument('formulation')} works only with the D-LGMD model")
        values["formulation"] = formulation
    if values.get("units") == DEGREES and "units" not in kind.specs():
        raise ParameterError("", "only the D-LGMD can be in degrees", "Choose --set or --model.")
    params = presets.parameters_of(file, values)
    unused = [name for name in ("n_sp", "kappa") if name in values]
    if unused and not rule_of(params).uses_level:
        other = f"{argument('alarm', 'spikes')} uses it"
        unusing = f"the rule {params.alarm} does not use it; alarms stay the same ({other})"
        warn(f"{' and '.join(unused)}: {unusing}")
    options = InputOptions.from_record({**file.options, **file.camera}, file.name)
    config = replace(file, kind=None)  # a class of a notebook cannot be sent to a worker process
    return Setup(params, file.label, config, options, _source_sha256(params))


def _source_sha256(params: Parameters) -> str:
    """The SHA-256 of a custom model's source file; empty for built-in models and without a file."""
    module = sys.modules.get(type(params).module)
    file = None if type(params).model in presets.MODELS else getattr(module, "__file__", None)
    return "" if file is None else content_sha256(file)


def choose_all(
    model: ModelName | ModelNames | None,
    param: Mapping[str, Value] | None = None,
    formulation: str | None = None,
    *,
    knows_motion: bool = False,
) -> list[Setup]:
    """The setups of one model or a list of models; the other arguments apply to all.

    In a list, each parameter applies to the models with its key; a key of no model is an error.
    `knows_motion` says that the rule `corridor` takes the place of the rule `expansion`.
    """
    models = model if isinstance(model, list | tuple) else [model]
    if not models:
        raise ParameterError("", "the list of models is empty", "Write [9, 'lgmd'], for example.")
    if len(models) == 1 or not param:
        setups = [choose(name, param, formulation) for name in models]
        return requiring_rules(by_motion(setups) if knows_motion else setups, param)
    unchanged = [choose(name).params for name in models]
    for key in param:
        if not any(key in params.to_dict() for params in unchanged):
            raise unchanged[0].unknown(key)
    setups = []
    for name, params in zip(models, unchanged, strict=True):
        known = {key: value for key, value in param.items() if key in params.to_dict()}
        setups.append(choose(name, known, formulation))
    return requiring_rules(by_motion(setups) if knows_motion else setups, param)


def by_motion(setups: Iterable[Setup]) -> list[Setup]:
    """The same models with the rule `corridor` in the place of `expansion`."""
    return [
        replace(setup, params=changed(setup.params, alarm=CORRIDOR))
        if setup.params.alarm == EXPANSION
        else setup
        for setup in setups
    ]


def requiring_rules(setups: list[Setup], param: Mapping[str, Value] | None) -> list[Setup]:
    """The setups; raises ParameterError if `param` sets the threshold of a rule that none has."""
    rules = {setup.params.alarm for setup in setups}
    if all(RULES[name].words for name in rules):  # a rule of one's own may read any parameter
        others = {f"{name}_alarm" for name in RULES} - {f"{name}_alarm" for name in rules}
        if CORRIDOR in rules:  # where the motion is unknown, it compares as the rule expansion
            others.discard(f"{EXPANSION}_alarm")
        unused = {key: value for key, value in (param or {}).items() if key in others}
        refuse(unused, f"has no effect with the rule {' or '.join(sorted(rules))}")
    return setups


def at_threshold(
    setup: Setup,
    threshold: float | None = None,
    speed_m_s: float | str | None = None,
    brake: str | float | None = None,
) -> Setup:
    """The model with another threshold of its rule, or with the one for a stop from a speed.

    Raises ParameterError if the rule has no such threshold, if both are given, or if there is a
    brake without a speed.
    """
    params = setup.params
    if speed_m_s is None:
        need = argument("speed_m_s")
        refuse({"brake": brake}, f"works only with {need}", f"Add {need}.")
    if speed_m_s is not None:
        stopping.require_followed(params, threshold)
        speed = stopping.followed_speed(speed_m_s)
        params = stopping.following(params, stopping.brake_of(brake), speed)
    elif threshold is not None:
        rule = rule_of(params)
        if not rule.key:
            why = f"the rule {rule.name} has no threshold that is a parameter"
            raise ParameterError("", why, f"Leave out {argument('threshold')}.")
        with in_argument("threshold"):
            params = changed(params, **{rule.key: threshold})
    return replace(setup, params=params)


def taken_threshold(options: dict[str, Any]) -> dict[str, Any]:
    """The arguments of `at_threshold`, which are taken out of the options of a task."""
    return {name: options.pop(name, None) for name in ("threshold", "speed_m_s", "brake")}


def with_rule(param: Mapping[str, Value] | None, alarm: Any) -> dict[str, Value]:
    """The parameters with the rule `alarm`, unless None: a name, a class, or MODULE:CLASS."""
    if param is not None and not isinstance(param, Mapping):
        raise ParameterError("", "param is not a mapping", "Write param={'r': 4}.")
    if alarm is None:
        return dict(param or {})
    with in_argument("alarm"):
        return {**(param or {}), "alarm": own_rule(alarm)}


def with_keys(setups: Sequence[Setup], keys: Iterable[str]) -> list[Setup]:
    """The setups with some of their parameters in their labels, as ``set9 kappa=0.1``."""
    labelled = []
    for setup in setups:
        values = setup.params.to_dict()
        changed = {key: values[key] for key in keys if key in values}
        words = (f"{k}={v:g}" if isinstance(v, float) else f"{k}={v}" for k, v in changed.items())
        labelled.append(replace(setup, label=" ".join([setup.label, *words])))
    return labelled


def with_folder_labels(setups: Sequence[Setup]) -> list[Setup]:
    """The setups with distinct labels that are valid names of folders."""
    labels = [_as_folder(setup.label) for setup in setups]
    if len({label.casefold() for label in labels}) < len(labels):
        labels = numbered([label.lower() for label in labels])
    return [replace(setup, label=label) for setup, label in zip(setups, labels, strict=True)]


def _as_folder(label: str) -> str:
    """A label as a valid name of a folder."""
    name = label.replace("/", "_").replace("\\", "_")
    return name if name.strip(". ") and not name.startswith(".") else f"model{name}"


def options_for(setup: Setup | None, given: Mapping[str, Any]) -> InputOptions:
    """The given options that are not None, supplemented by the options in a setup's file.

    Raises ParameterError if an option does not exist or is not valid, or options exclude each
    other.
    """
    for name in given.keys() - CHECKS.keys():
        hints = {"set": "Name the set second: run('flight.mp4', 9)."}
        hints |= dict.fromkeys(DlgmdParameters.specs(), f"Write param={{{name!r}: VALUE}}.")
        hint = hints.get(name, f"Choose from {', '.join(CHECKS)}.")
        raise ParameterError("", f"there is no option {name!r}", hint)
    explicit = {key: value for key, value in given.items() if value is not None}
    recorded = InputOptions() if setup is None else setup.options
    if explicit.keys() & {"scale", "size"}:
        recorded = replace(recorded, scale=None, size=None)
    return replace(recorded, **explicit)


def silent(*_: int | str) -> None:
    """The default callback."""


def no_progress(*_: str | int | None) -> AbstractContextManager[Callable[..., None]]:
    """The default `Progress`."""
    return nullcontext(silent)


def fold(
    model: ModelName | ModelNames | None,
    formulation: str | None,
    param: Mapping[str, Value] | None,
    options: Mapping[str, Any],
    video: Openable | None = None,
    *,
    repeats_record: bool = True,
    knows_motion: bool = False,
) -> Request:
    """The request from the arguments of a task; raises ParameterError, see `choose_all`.

    If the task `knows_motion`, or a table of headings has it, and no rule is given, the rules are
    those of `by_motion`. For images in memory, `fps` is their rate unless `input_fps` is given. If
    the task `repeats_record`, a single model from a run.yaml brings the options of that run.
    """
    given = dict(options)
    at = taken_threshold(given)
    is_in_memory = video is not None and not isinstance(video, str | os.PathLike)
    if is_in_memory and given.get("input_fps") is None:
        given["input_fps"] = given.pop("fps", None)
    param, heading = with_rule(param, given.pop("alarm", None)), given.get("heading")
    knows_motion |= heading is not None and has_motion(os.fspath(heading))
    knows_motion &= "alarm" not in (param or {})
    setups = choose_all(model, param, formulation, knows_motion=knows_motion)
    setups = [at_threshold(setup, **at) for setup in setups]
    rules = {setup.params.alarm: rule_of(setup.params) for setup in setups}
    for name, rule in rules.items() if given.get("normalise") else ():
        if not rule.uses_level:
            warn(f"{argument('normalise')} changes no alarm of the rule {name}, only spikes")
    for name in ("fov", "camera_tilt"):  # the video has one camera for all models
        if given.get(name) is None:
            given[name] = getattr(setups[0].options, name)
    repeated = setups[0] if repeats_record and len(setups) == 1 else None
    return Request(tuple(setups), options_for(repeated, given), conditional(given))


def conditional(given: Mapping[str, Any]) -> frozenset[str]:
    """The given options that not every input uses."""
    return frozenset(name for name in ONLY_FOR if given.get(name) is not None)


def require_measured(setups: Iterable[Setup], options: Mapping[str, Any]) -> None:
    """Raise ParameterError for options of the camera where no rule needs the expansion.

    For tasks that measure the expansion for rules alone.
    """
    setups = [*setups]
    degrees = any(in_degrees(setup.params) for setup in setups)
    if not degrees and not any(rule_of(setup.params).uses_expansion for setup in setups):
        of_camera = {name: options.get(name) for name in ("fov", "camera_tilt", "heading")}
        refuse(of_camera, "has no effect: no rule here uses the expansion")


def require_one_each(labels: Sequence[str], n: int, noun: str, hint: str = "") -> None:
    """Raise ParameterError unless there are `n` labels, or none."""
    if labels and len(labels) != n:
        why = f"{argument('label')} is given {counted(len(labels), 'time')}, for {counted(n, noun)}"
        raise ParameterError("", why, hint)


@contextmanager
def opened(
    video: Openable,
    request: Request,
    record: str,
    out: str | os.PathLike[str] | None,
    *,
    overwrite: bool,
) -> Iterator[tuple[Video, store.ClaimedFolder | None]]:
    """The open input, and the claimed folder of its result below `out`; None without `out`.

    Raises the errors of `Request.open` and `store.claimed`.
    """
    with request.open(video) as source:
        if out is None:
            yield source, None
            return
        folder, identity = store.result_folder(Path(out), source.info.name), source.info.identity
        with store.claimed(folder, record, identity, overwrite=overwrite) as claim:
            yield source, claim


@contextmanager
def clips_written(
    source: str,
    name: str,
    onsets_s: Sequence[float],
    folder: Path,
    of_images: ImageOptions | None = None,
) -> Iterator[list[Path]]:
    """Write a clip of each alarm into a folder, in place of the earlier ones; see `make_clips`.

    Clips are made before the context, and put in place after it. Raises SourceError if the source
    cannot be decoded, OutputError if the folder cannot be written; earlier clips then stay.
    """
    spans = spans_of(name, onsets_s)
    earlier = [path.name for path in clips_of(folder, name)]
    with ExitStack() as stack:
        if spans or earlier:
            # Without a lock: a batch writes clips of several videos at once.
            claimed = store.claimed(folder, named_by="clips", locks=False)
            stage = stack.enter_context(stack.enter_context(claimed).staged(stale=earlier))
            make_clips(source, spans, stage, of_images)
        yield [folder / clip for clip in spans]


def watched(
    video: Video, request: Request, progress: Progress
) -> AbstractContextManager[Callable[..., None]]:
    """The progress over the frames of an input."""
    return progress(video.info.name, request.options.n_expected(video.info), "frame")


def warn_of_input(video: Video, request: Request, warnings: Sequence[str]) -> None:
    """Log the warnings about an input, and which of its frames were processed."""
    for warning in warnings:
        warn(f"{video.info.given}: {warning}")
    if request.options.fps in (None, "all") and (sampling := video.sampling()):
        _log.info("Note: %s: %s.", video.info.given, sampling)
    info, stated = video.info, "" if video.info.fps_stated is None else "in place of its own"
    if request.options.times:
        how = f"{argument('times')} {request.options.times} is the clock"
        _log.info("Note: %s: %s, %.4g frames/s, %s.", info.given, how, info.fps, stated or "given")
    elif request.options.input_fps and info.fps_stated not in (None, info.fps):
        rates = info.fps_stated, argument("input_fps", f"{info.fps:g}")
        _log.info("Note: %s: it states %.4g frames/s; %s holds.", info.given, *rates)
