"""The models of a run: from a set, a file or a name to checked parameters and options."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters.checks import blame, require_known
from dlgmd_cli.parameters.presets import (
    DEFAULT_MODEL_FPS,
    DEFAULT_WIDTH_PX,
    ENGINES,
    MODELS,
    PRESETS,
    Config,
    DlgmdParameters,
    Parameters,
    design_of,
    find_model,
    load_config,
    load_model_preset,
    load_preset,
    merge,
)
from dlgmd_cli.results.names import numbered
from dlgmd_cli.video.opening import Openable, processed_size
from dlgmd_cli.video.options import InputOptions
from dlgmd_cli.video.source import Video

DEFAULT_PRESET, DEFAULT_SET, DLGMD = PRESETS[0], "9", DlgmdParameters.model


@dataclass(frozen=True)
class Setup:
    """One model of a run: its parameters and their origin.

    `label` is the name in messages and figures: `set9`, `lgmd`, `flight`, or the stem of a file.
    `engine` is `opencv`, `numba` or `auto`. `named` has entries for the record: ``{"set": 9}`` or
    ``{"preset": "flight"}`` if one was named, and what the command line took from the user's own
    `settings`. `origin` is the file of the parameters, for error messages, and `options` those of
    the run that wrote that file, if it is a `run.yaml`. The parameters are designed for frames
    `width_px` wide, in px, and for `model_fps`: the defaults unless an option is given.
    """

    params: Parameters
    label: str
    engine: str = "auto"
    named: dict[str, Any] = field(default_factory=dict)
    origin: str = ""
    options: InputOptions = field(default_factory=InputOptions)
    width_px: int = DEFAULT_WIDTH_PX
    model_fps: float = DEFAULT_MODEL_FPS

    def size_on(self, video: Video, options: InputOptions) -> tuple[int, int]:
        """Size of the processed frames, (width, height) in px: by option, else the model's own."""
        asked = self.options if options.scale is None and options.size is None else options
        return processed_size(
            *video.source_wh, scale=asked.scale, size_wh=asked.size, width_px=self.width_px
        )

    def settings(self) -> dict[str, Any]:
        """Entries of the model in a record, without the engine and the options."""
        design = {"width_px": self.width_px, "model_fps": self.model_fps}
        return {"model": self.params.model, **design, **self.params.to_dict()}


@dataclass(frozen=True)
class Asked:
    """What a task is asked for: one model or several, and how the input is read."""

    setups: tuple[Setup, ...]
    options: InputOptions

    @property
    def setup(self) -> Setup:
        """The only model, or the first one."""
        return self.setups[0]

    def open(self, source: Openable, formulations: Iterable[str] = ()) -> Video:
        """Open an input for the models; raises what `open_video` raises.

        By default, the frame size is that of the first model and the frame rate that of the
        fastest. If one has the formulation `released`, or is to have it by `formulations`, every
        frame is read, repeats included.
        """
        own = [one.params.to_dict().get("formulation") for one in self.setups]
        model_fps = max(one.model_fps for one in self.setups)
        return self.options.open(
            source,
            width_px=self.setup.width_px,
            model_fps=None if "released" in (*formulations, *own) else model_fps,
        )


# A model by its name, its class, its parameters, or as it was chosen before.
ModelName = str | type | Parameters | Setup


def choose(
    set: str | int | None = None,
    config: str | os.PathLike[str] | None = None,
    model: ModelName | None = None,
    overrides: Mapping[str, Any] | None = None,
    formulation: str | None = None,
    engine: str | None = None,
) -> Setup:
    """The model given by a set, a file or a name, with single parameters overridden.

    `overrides` and `formulation` take precedence over the set or file, and that over the defaults.
    `model` is a name, see `find_model`, the class of a model, or its parameters; a setup is
    returned as it is. Without any name, the preset `flight` is used; `dlgmd` alone means set 9.

    Raises ParameterError if there is no such set, file, model or engine, or a parameter is not
    valid.
    """
    if isinstance(model, Setup):
        return model
    if set is not None and config is not None:
        raise ParameterError("", "--set and --config exclude each other", "Give one of them.")
    is_default = set is None and config is None and model is None
    if isinstance(model, Parameters):
        if set is not None or config is not None:
            raise ParameterError("", "parameters exclude a set and a file", "Give one of them.")
        kind, (width_px, model_fps) = type(model), design_of(model)
        file = Config("", width_px=width_px, model_fps=model_fps, values=model.to_dict())
        label = label_of(kind)
    else:
        given = None if model is None else find_model(model, "Invalid value for '--model'")
        if set is not None and not _takes_sets(given):
            mend = f"Leave out --set or --model {model}."
            raise ParameterError("", "--set works only with the D-LGMD model", mend)
        file, label = _named_config(set, DEFAULT_PRESET if is_default else config, given)
        kind = given or find_model(file.model or DLGMD, file.name, in_file=True)
    chosen = engine or file.engine
    if chosen not in (None, "auto"):
        require_known("engine", str(chosen), ENGINES, file.name if engine is None else "")
    values = dict(overrides or {})
    if formulation is not None:
        if "formulation" not in kind.specs():
            mend = "Add --set 9." if is_default else ""
            raise ParameterError("", "--formulation works only with the D-LGMD model", mend)
        values["formulation"] = formulation
    return Setup(
        merge(kind, file, values),
        label,
        chosen or "auto",
        file.named if set is None else {"set": int(str(set).removeprefix("set"))},
        file.name,
        InputOptions.from_record(file.options, file.name),
        file.width_px,
        file.model_fps,
    )


def choose_all(
    models: Sequence[ModelName | int] | None,
    set: str | int | None = None,
    config: str | os.PathLike[str] | None = None,
    model: ModelName | None = None,
    overrides: Mapping[str, Any] | None = None,
    formulation: str | None = None,
    engine: str | None = None,
) -> list[Setup]:
    """The models of a list, or the one of `choose`; the last three arguments are for all of them.

    A number is a set, and a name that of a set, a preset or a model. Raises ParameterError as
    `choose` does, and if the list comes with `set`, `config` or `model`.
    """
    if models is None:
        return [choose(set, config, model, overrides, formulation, engine)]
    for name, value in {"set": set, "config": config, "model": model}.items():
        if value is not None:
            raise ParameterError("", f"{name} and models exclude each other", "Give one of them.")
    if isinstance(models, str) or not models:
        raise ParameterError("", "models is not a list of models", "Write models=[9, 'lgmd'].")
    found = []
    for one in models:
        named: dict[str, Any] = {"model": one}
        if one in PRESETS:
            named = {"config": one}
        elif isinstance(one, int) or str(one).removeprefix("set").isdecimal():
            named = {"set": one}
        found.append(choose(**named, overrides=overrides, formulation=formulation, engine=engine))
    return found


def with_keys(setups: Sequence[Setup], keys: Iterable[str]) -> list[Setup]:
    """The setups with some of their parameters in their labels, as ``set9 kappa=0.1``."""
    found = []
    for one in setups:
        values = one.params.to_dict()
        words = [f"{key}={_short(values[key])}" for key in keys if key in values]
        found.append(replace(one, label=" ".join([one.label, *words])))
    return found


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def with_folder_labels(setups: Sequence[Setup]) -> list[Setup]:
    """The setups with distinct labels that are valid names of folders."""
    labels = [_as_folder(one.label) for one in setups]
    if len({label.casefold() for label in labels}) < len(labels):
        labels = numbered([label.lower() for label in labels])
    return [replace(one, label=label) for one, label in zip(setups, labels, strict=True)]


def _as_folder(label: str) -> str:
    """A label as a valid name of a folder."""
    name = label.replace("/", "_").replace("\\", "_")
    return name if name.strip(". ") and not name.startswith(".") else f"model{name}"


def label_of(kind: type[Parameters]) -> str:
    """The name of a model in messages and figures: without the module of one's own."""
    return kind.model.rpartition(":")[2]


def _takes_sets(kind: type[Parameters] | None) -> bool:
    """Whether the paper's sets are for this model: the D-LGMD, or one of one's own based on it."""
    is_own = kind is not None and ":" in kind.model
    return kind in (DlgmdParameters, None) or (is_own and issubclass(kind, DlgmdParameters))  # type: ignore[arg-type]


def _named_config(
    set: str | int | None, config: str | os.PathLike[str] | None, kind: type[Parameters] | None
) -> tuple[Config, str]:
    """The configuration that the arguments of `choose` name, and the model's label."""
    if config is not None:
        return load_config(os.fspath(config)), Path(config).stem
    if set is None and kind is not None and kind is not DlgmdParameters:
        is_ours = kind.model in MODELS
        return load_model_preset(kind.model) if is_ours else Config(""), label_of(kind)
    number = str(DEFAULT_SET if set is None else set)
    with blame("Invalid value for '--set'"):
        return load_preset(number), f"set{number.removeprefix('set')}"


def input_options(setup: Setup, given: Mapping[str, Any]) -> InputOptions:
    """The given options, supplemented by those in the file of the setup.

    Raises ParameterError if there is no such option, or options exclude each other or are not
    valid.
    """
    explicit = _known(given)
    recorded = setup.options
    if explicit.keys() & {"scale", "size"}:
        recorded = replace(recorded, scale=None, size=None)
    return replace(recorded, **explicit)


def common_options(setups: Sequence[Setup], given: Mapping[str, Any]) -> InputOptions:
    """The given options; with one setup, supplemented as by `input_options`."""
    return input_options(setups[0], given) if len(setups) == 1 else InputOptions(**_known(given))


def _known(given: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are not None; raises ParameterError if one does not exist."""
    names = [one.name for one in fields(InputOptions) if one.repr]
    for name in given.keys() - {*names}:
        raise ParameterError("", f"there is no option {name!r}", f"Choose from {', '.join(names)}.")
    return {key: value for key, value in given.items() if value is not None}
