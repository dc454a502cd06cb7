"""Parameters of every model: symbols, units, defaults and ranges; presets, files and merging.

Overrides take precedence over a preset or file, a preset or file over the defaults; the result is
frozen. A new model needs a parameter class here, listed in `MODELS`, a module in `models/` that
names the class, and a YAML file in `configs/`. A model of the field needs only a module in
`models/published/`, listed in `PUBLISHED`, and a custom model nothing, see `find_model`.
"""

import math
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.parameters import keys
from dlgmd_cli.parameters.checks import (
    Spec,
    blame,
    did_you_mean,
    in_argument,
    require_known,
    shown,
    similar_path,
)
from dlgmd_cli.parameters.facts import (
    InputFacts,
    Named,
    Value,
    of_another_schema,
    part_of,
    stating,
)
from dlgmd_cli.parameters.keys import DEGREES, KAPPA, PIXELS, common_key, key
from dlgmd_cli.parameters.keys import Parameters as Parameters
from dlgmd_cli.parameters.keys import ParametersT as ParametersT
from dlgmd_cli.parameters.plain_yaml import SHOW_HINT, parse, read

LATENCIES = ("bands", "bands-whole", "bands-2020", "nearest", "interpolated")
GROUPINGS = ("sum", "mean")
# The released formulations also have another lag and divisor of FFI, see `DLGMD`.
FORMULATIONS = ("default", "released-2021", "released-2020", "equations")
MAX_LATENCY_FRAMES = 64.0
# The named configurations; the first is the default.
PRESETS = ("flight", "flight-small")
# Frames up to this width are for `flight-small`.
SMALL_WIDTH_PX = 128
# Frame width (px) and rate (frames/s) that parameters are designed for, if their file states none.
DEFAULT_WIDTH_PX, DEFAULT_MODEL_FPS = 480, 30.0
# The angles of a camera, in degrees.
ANGLES = {
    "fov": Spec(float, 1, 170, unit="degrees"),
    "camera_tilt": Spec(float, -45, 45, unit="degrees"),
}
# The keys of a configuration file that are not parameters.
DESCRIBING = {
    "model": Spec(str),
    "width_px": Spec(int, 1, 8192),
    "model_fps": Spec(float, 1, 1000),
    **ANGLES,
}


@dataclass(frozen=True)
class DlgmdParameters(Parameters):
    """Parameters of the D-LGMD; the defaults are set 9 of [Zhao2023], Tables I and II."""

    model: ClassVar[str] = "dlgmd"
    module: ClassVar[str] = "dlgmd_cli.models.dlgmd"
    preset: ClassVar[str] = "9"
    source: ClassVar[str] = "Zhao et al., IEEE TNNLS 34(5), 2023"

    alpha: float = key(-0.1, "α", "frames", "shift of the latency, Eq. (5)", -10, 64)
    beta: float = key(0.5, "β", "1/frames", "saturation of the latency, Eq. (5)", 0, 100)
    lam: float = key(0.7, "λ", "1/px", "spread of the latency, Eq. (5)", 0, 10)
    sigma_e: float = key(1.5, "σ_E", "px", "width of excitation, Eq. (4)", 0.01, 100)
    sigma_i: float = key(5.0, "σ_I", "px", "width of inhibition, Eq. (4)", 0.01, 100)
    r: int = key(6, "r", "px", "radius of the kernels", 1, 32)
    a: float = key(1.5, "a", "–", "strength of inhibition, Eq. (6)", 0, 100)
    k: float = key(1.0, "k", "–", "gain of the grouping, Eq. (9)", 1e-12, 100)
    ffi_gd: bool = key(True, "FFI-GD", "–", "threshold G by feed-forward inhibition, Eq. (10)")
    t0: float = key(0.5, "T_0", "–", "base of that threshold, Eq. (11)", 0, 100)
    m: float = key(0.4, "m", "–", "mean change at which unlimited T_de = T_0, Eq. (11)", 0.001, 100)
    t_mp: float = common_key("t_mp")
    n_sp: int = common_key("n_sp")
    kappa: float = key(0.0028, "κ", "–", KAPPA, 1e-9, 100)
    formulation: str = key(
        "default",
        meaning="latency, limits and FFI of our default, an authors' code or the paper",
        choices=FORMULATIONS,
    )
    latency: str = key(
        dict(zip(FORMULATIONS, ("bands", "bands", "bands-2020", "interpolated"), strict=True)),
        meaning="how delays that are not whole frames are rounded",
        choices=LATENCIES,
    )
    saturate: bool = key(
        dict(zip(FORMULATIONS, (True, True, True, False), strict=True)),
        meaning="limit G̃ to 1 and T_de to 0.3",
    )
    grouping: str = key(
        dict(zip(FORMULATIONS, ("sum", "sum", "mean", "sum"), strict=True)),
        meaning="k times the sum or the mean of 4x4 cells, Eq. (9)",
        choices=GROUPINGS,
    )
    units: str = key(
        PIXELS,
        meaning="pixels: the video's px and frames; degrees: 0.3 degrees and 1/30 s",
        choices=(PIXELS, DEGREES),
    )

    @property
    def is_released(self) -> bool:
        """Whether FFI is computed as in the authors' codes."""
        return self.formulation.startswith("released")

    @property
    def gain(self) -> float:
        """The factor of S · (ΣS over 4x4 cells) in G, Eqs. (8) and (9)."""
        return self.k / 16.0 if self.grouping == "mean" else self.k

    def _check_together(self) -> None:
        """Refuse a latency that is negative, or longer than `MAX_LATENCY_FRAMES`, anywhere."""
        if self.units == DEGREES and self.is_released:
            why = f"the code of {self.formulation} counts pixels, not degrees"
            raise ParameterError("", why, "Choose formulation=default, or units=pixels.")
        centre = self.alpha + 1.0 / (self.beta + 1.0)
        if centre < 0.0:
            why = f"alpha = {self.alpha:g} with beta = {self.beta:g} makes the latency negative "
            why += f"({centre:.3g} frames at the centre)"
            hint = "Inhibition cannot come before its cause; raise alpha."
            raise ParameterError("", why, hint)
        corner = self.beta + math.exp(-(self.lam**2) * 2 * self.r**2)
        longest = self.alpha + 1.0 / corner if corner > 0.0 else math.inf
        if longest > MAX_LATENCY_FRAMES:
            why = f"alpha = {self.alpha:g}, beta = {self.beta:g}, lam = {self.lam:g} and "
            why += f"r = {self.r} make the latency longer than {MAX_LATENCY_FRAMES:g} frames"
            raise ParameterError("", why, "Lower alpha or lam, or raise beta.")


@dataclass(frozen=True)
class OnOffParameters(
    DlgmdParameters,
    defaults={
        "alpha": 0.0,
        "beta": 0.0,
        "lam": 0.0,
        "sigma_e": 0.35,
        "sigma_i": 2.5,
        "r": 4,
        "kappa": 0.0466,
    },
):
    """Parameters of the D-LGMD with ON and OFF pathways, with the connections of set 3."""

    model: ClassVar[str] = "dlgmd-onoff"
    module: ClassVar[str] = "dlgmd_cli.models.on_off"
    preset: ClassVar[str] = "dlgmd-onoff"
    source: ClassVar[str] = "ON/OFF D-LGMD; set 3 of Zhao et al., IEEE TNNLS 34(5), 2023"


@dataclass(frozen=True)
class LgmdParameters(Parameters):
    """Parameters of the LGMD of [Zhao2018], as published in its authors' released code."""

    model: ClassVar[str] = "lgmd"
    module: ClassVar[str] = "dlgmd_cli.models.lgmd"
    preset: ClassVar[str] = "lgmd"
    source: ClassVar[str] = "LGMD; Zhao et al., 2018, after Yue and Rind, 2006"
    # Normalised by its own sigmoid 1 / (1 + exp(-K / n_cell)), which is 1/2 at rest.
    kappa = None

    p1: float = key(0.0, "p_1", "–", "persistence of change after one frame", -1, 1)
    p2: float = key(0.0, "p_2", "–", "persistence of change after two frames", -1, 1)
    w_i: float = key(0.3, "W_I", "–", "strength of inhibition", 0, 100)
    delta_c: float = key(0.01, "Δ_C", "grey levels", "lowest scale ω of the grouping", 1e-6, 255)
    c_omega: float = key(
        4.0, "C_ω", "–", "divisor of the greatest Ce in the grouping scale ω", 0.001, 1000
    )
    c_de: float = key(0.15, "C_de", "–", "decay coefficient of G", 1e-6, 100)
    t_de: float = key(15.0, "T_de", "grey levels", "threshold of decayed G", 0, 1e6)
    # With 25, the cell would be silent during contact; FFI never exceeds 255.
    t_ffi: float = key(
        255.0, "T_FFI", "grey levels", "feed-forward inhibition that silences the cell", 0, 255
    )
    t_mp: float = common_key("t_mp", 0.99999994)
    n_sp: int = common_key("n_sp")

    def _check_together(self) -> None:
        """Refuse a persistence that does not decay."""
        if self.p2 >= 1.0 - abs(self.p1) or self.p2 <= -1.0:
            why = f"p1 = {self.p1:g} with p2 = {self.p2:g} makes every change grow for ever"
            raise ParameterError("", why, "Bring them nearer to 0.")


@dataclass(frozen=True)
class EmdLgmdParameters(Parameters):
    """Parameters of the LGMD on elementary motion detectors, after [Bermudez2007]."""

    model: ClassVar[str] = "emd-lgmd"
    module: ClassVar[str] = "dlgmd_cli.models.emd_lgmd"
    preset: ClassVar[str] = "emd-lgmd"
    source: ClassVar[str] = "EMD-LGMD; after Bermudez i Badia, Pyk and Verschure, 2007"

    tau_high: float = key(8.0, "τ_h", "frames", "time constant of the high-pass", 0.01, 1000)
    tau_low: float = key(2.0, "τ_l", "frames", "time constant of the delay", 0.01, 1000)
    delta: float = key(0.02, "δ", "–", "expansion predicted from a frame to the next", 0, 1)
    f_active: float = key(0.05, "F_a", "luminance", "change above which a cell is active", 0, 1)
    c: float = key(2.0, "c", "–", "strength of feed-forward inhibition", 0, 100)
    t_mp: float = common_key("t_mp")
    n_sp: int = common_key("n_sp")
    kappa: float = key(0.0021, "κ", "luminance²", KAPPA, 1e-12, 100)


@dataclass(frozen=True)
class LkDivergenceParameters(Parameters):
    """Parameters of the optical-flow baseline; the threshold is ours, not a published one."""

    model: ClassVar[str] = "lk-divergence"
    module: ClassVar[str] = "dlgmd_cli.models.lk_divergence"
    preset: ClassVar[str] = "9"
    source: ClassVar[str] = "Shi and Tomasi, 1994; Bouguet, 2001"

    t_mp: float = common_key("t_mp", 0.5)
    n_sp: int = common_key("n_sp", 1)
    kappa: float = key(
        1.0, "κ", "1/s", "half-saturation constant of mp_abs (expansion rate)", 1e-9, 1e9
    )


# The models with a file in `configs/` by name, without the baseline above.
_OURS = (DlgmdParameters, OnOffParameters, LgmdParameters, EmdLgmdParameters)
# A model of the field -> its class, in the module of the model's name in `models/published/`.
PUBLISHED = {
    "lgmd-2006": "LGMD2006",
    "plgmd": "PLGMD",
    "mc-lgmd": "McLGMD",
    "sfa-lgmd": "SfaLGMD",
    "lgmd1-lgmd2": "Lgmd1Lgmd2",
    "lgmd2-lgmd1": "Lgmd2Lgmd1",
    "algmd": "ALGMD",
    "emd-lplc2": "EmdLplc2",
}


class _Models(Mapping[str, type[Parameters]]):
    """Model -> parameter class. A published model's module is imported on first use: it is slow."""

    _ours: ClassVar = {kind.model: kind for kind in _OURS}

    def __getitem__(self, name: str) -> type[Parameters]:
        if name in PUBLISHED:
            module = f"{keys.PUBLISHED_MODELS}.{name.replace('-', '_')}"
            return keys.imported_model(f"{module}:{PUBLISHED[name]}").params_class  # type: ignore[no-any-return]
        return self._ours[name]

    def __contains__(self, name: object) -> bool:
        return name in self._ours or name in PUBLISHED

    def __iter__(self) -> Iterator[str]:
        return iter((*self._ours, *PUBLISHED))

    def __len__(self) -> int:
        return len(self._ours) + len(PUBLISHED)


MODELS: Mapping[str, type[Parameters]] = _Models()


@cache
def installed_models() -> dict[str, str]:
    """Name -> `package.module:Class` of the entry points of the group `dlgmd.models`."""
    from importlib.metadata import entry_points  # slow

    return {entry.name: entry.value for entry in entry_points(group="dlgmd.models")}


def find_model(
    name: str | type | None, origin: str = "", *, in_file: bool = False
) -> type[Parameters]:
    """The parameter class of a model; only this function decides whether a module is imported.

    Parameters
    ----------
    name : str or type
        One of the `MODELS`, an installed entry point, `package.module:Class`, whose module is
        imported, or the class of a model.
    origin : str
        The file or argument that names the model, for the error.
    in_file : bool
        Whether a file names the model. A file may come from anybody and can therefore name only
        custom models that are already defined, or installed entry points.

    Raises
    ------
    ParameterError
        If there is no such model, or the module or the class cannot be used.
    """
    model_class: Any = name
    if isinstance(name, str):
        if name in MODELS:
            return MODELS[name]
        if ":" not in name:
            require_known("model", name, (*MODELS, *installed_models()), origin)
        elif in_file and name in keys.OWN_MODELS:
            return keys.OWN_MODELS[name]
        elif in_file and name not in installed_models().values():
            raise untrusted(name, origin)
        model_class = keys.imported_model(name if ":" in name else installed_models()[name], origin)
    kind = getattr(model_class, "params_class", None)
    if not isinstance(kind, type) or vars(kind).get("model_class") is not model_class:
        why = f"{str(name)[:100]} is not a subclass of dlgmd_cli.Model"
        raise ParameterError(origin, why, "See 'A custom model' in the documentation.")
    return kind


def untrusted(name: str, origin: str = "", what: str = "model") -> ParameterError:
    """The error for a custom model or rule (`what`: "alarm") that only a file names."""
    why = f"its {what} {name[:100]} is Python code, which no file may start"
    return ParameterError(
        origin, why, f"If you trust that module, add {argument(what, name[:100])}."
    )


def stored_parameters(record: Mapping[str, Any]) -> Parameters:
    """The parameters in a record; no module is imported.

    A custom model's parameters have its parameter class if it is already defined, else they are
    plain values. Raises ParameterError if the model is unknown, or a parameter is not valid.
    """
    name = str(record.get("model"))
    kind = MODELS.get(name) or keys.OWN_MODELS.get(name)
    if kind is None and ":" not in name:
        require_known("model", name, MODELS)
    if kind is not None:
        try:
            return kind.from_mapping({key: record[key] for key in kind.specs() if key in record})
        except ParameterError:
            if ":" not in name:
                raise
    return keys.recorded_parameters(record)


def runnable(params: Parameters) -> Parameters:
    """The parameters of a record in the class that creates the model; raises ParameterError."""
    if params.model in MODELS or type(params).model_class is not None:
        return params
    return find_model(params.model, in_file=True).from_mapping(params.to_dict())


@dataclass(frozen=True)
class Config:
    """Contents of a configuration file: the model, its parameters, and the options of a run.

    `name` is the file's name in error messages. `values` holds the parameters, not yet checked.
    `named` is the set or preset that the file builds on, as in run.yaml. `width_px` and `model_fps`
    are the frame width and the frame rate that the parameters are designed for. `camera` has what
    it says of the camera, `fov` and `camera_tilt`. `recorded` is the input in a run.yaml.
    `kind` is the class of the parameters where it is known already; `model` names it else.
    """

    name: str
    model: str | None = None
    width_px: int = DEFAULT_WIDTH_PX
    model_fps: float = DEFAULT_MODEL_FPS
    values: dict[str, Value] = field(default_factory=dict)
    options: dict[str, Value] = field(default_factory=dict)
    named: Named = field(default_factory=Named)
    camera: dict[str, float] = field(default_factory=dict)
    recorded: InputFacts = field(default_factory=InputFacts)
    kind: type[Parameters] | None = None

    @property
    def label(self) -> str:
        """The name in messages and figures: `set9`, `lgmd`, `flight`, or the stem of a file."""
        return Path(self.name).stem or str(self.model).rpartition(":")[2]


# A model, by anything that `config_of` accepts.
ModelName = int | str | os.PathLike[str] | type | Parameters | Config


def config_of(model: ModelName | None = None) -> Config:
    """The configuration of a model, however the model is named.

    Parameters
    ----------
    model : optional
        A set's number (``9``, ``"set9"``), the name of a preset or a model (``"flight"``,
        ``"lgmd"``, ``"package.module:Class"``; ``"dlgmd"`` is set 9), the class of a model, its
        parameters, the path of a YAML file, or a configuration. The default is `flight`.

    Raises
    ------
    ParameterError
        If there is no such set, preset, model or file, or the file cannot be read.
    """
    if isinstance(model, Config):
        return model
    if isinstance(model, Parameters):
        has_file = model.model in {kind.model for kind in _OURS[1:]}
        file = load_model_preset(model.model) if has_file else Config("")
        return replace(file, name="", model=model.model, values=model.to_dict(), kind=type(model))
    name = PRESETS[0] if model is None else str(model)
    option = "model" if isinstance(model, type) else kind_of_name(name)[0]
    if option == "set":
        return load_preset(name)
    if option == "model" and name in {kind.model for kind in _OURS}:
        is_dlgmd = name == DlgmdParameters.model
        return load_preset(DlgmdParameters.preset) if is_dlgmd else load_model_preset(name)
    if option == "model":
        found = find_model(model if isinstance(model, type) else name)
        return Config("", found.model, kind=found)
    if option == "config" or isinstance(model, os.PathLike) or Path(name).exists():
        return load_config(name)  # raises if the file is missing, or not a file
    known = (*PRESETS, *MODELS, *installed_models())
    choices = f"Choose 1 to 9, {', '.join(known)}, a custom model as MODULE:CLASS, or a YAML file."
    hint = f"{did_you_mean(name, known)}{choices}"
    raise ParameterError("", f"there is no set, preset, model or file {name[:80]!r}", hint)


def kind_of_name(name: str) -> tuple[str, str]:
    """The option that takes a name (`set`, `config` or `model`), and the kind of the name in words.

    Both are empty for an unknown name. A file is a name that exists, or ends in .yaml or .yml.
    """
    if name.removeprefix("set").isdecimal():
        return "set", "a set"
    if name in PRESETS:
        return "set", "a preset"
    if name.lower().endswith((".yaml", ".yml")):
        return "config", "a file"
    if name in MODELS or ":" in name or name in installed_models():
        return "model", "a model"
    return ("config", "a file") if Path(name).is_file() else ("", "")


def presets_dir() -> Path:
    """The folder of the presets: inside the installed package, or beside it in the repository."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "configs"
    return installed if installed.is_dir() else package.parent / "configs"


def preset_names() -> list[str]:
    """The names of the paper's sets, in order."""
    names = (path.stem.removeprefix("set") for path in presets_dir().glob("set*.yaml"))
    return sorted(names, key=lambda name: (len(name), name))


def load_preset(name: str | int) -> Config:
    """The paper's set `name`, 1 to 9 or set1 to set9, or a preset; raises ParameterError."""
    if name in PRESETS:
        return replace(load_model_preset(str(name)), named={"preset": str(name)})
    require_preset(str(name))
    number = str(name).removeprefix("set")
    return replace(load_model_preset(f"set{number}"), named={"set": int(number)})


def require_preset(name: str) -> None:
    """Raise ParameterError unless there is a set or a preset of this name."""
    names = preset_names()
    if name not in PRESETS and name.removeprefix("set") not in names:
        choices = f"Choose {names[0]} to {names[-1]}, {' or '.join(PRESETS)}."
        hint = f"{did_you_mean(name, PRESETS)}{choices}"
        raise ParameterError("", f"there is no set {name[:40]}", hint)


def load_model_preset(stem: str) -> Config:
    """The published values of a model, or another file of `presets_dir`."""
    return load_config(presets_dir() / f"{stem}.yaml")


@stating({name: spec.kind for name, spec in DlgmdParameters.specs().items()})
def load_set(name: str | int, **overrides: Value) -> DlgmdParameters:
    """The paper's parameter set `name`, 1 to 9, with single keys overridden.

    Raises
    ------
    ParameterError
        If there is no such set, or an override is not valid.

    Examples
    --------
    >>> load_set(9, r=4).sigma_e
    1.5
    """
    return DlgmdParameters.from_mapping({**load_preset(name).values, **overrides})


def load_config(path: str | Path) -> Config:
    """Read a YAML file of parameters, such as a `run.yaml`.

    The name of a shipped preset, `flight`, stands for its file; to read your own file of that name,
    give its absolute path. The key `set` or `preset` in a file loads the values of that set or
    preset, and the file's other keys override them.

    Raises
    ------
    ParameterError
        If the file cannot be read, is not plain YAML, or is not a mapping.
    """
    name = str(path)
    path = Path(name)
    if name in PRESETS:
        return load_preset(name)
    if not path.exists():
        why = "there is no such file or preset"
        raise ParameterError(name, why, did_you_mean(name, PRESETS).strip() or similar_path(path))
    document = parse(name, read(path))
    if document is None:
        raise ParameterError(name, "is empty", "Give at least one 'key: value'.")
    if not isinstance(document, dict):
        kinds: dict[type, str] = {list: "a list", str: "plain text"}
        kind = kinds.get(type(document), "one value")
        raise ParameterError(name, f"contains {kind}, not 'key: value' lines", SHOW_HINT)
    for word in document:
        if not isinstance(word, str):
            raise ParameterError(name, f"unknown parameter {shown(word)!r}", SHOW_HINT)
    options = document.pop("options", None) or {}
    if not isinstance(options, dict):
        raise ParameterError(name, "options is not a mapping", SHOW_HINT)
    # A run.yaml already holds every value.
    is_record = "schema" in document
    if refusal := of_another_schema(document):
        raise ParameterError(name, *refusal)
    for word, value in document.items():
        # In Python, None means the default; in a file, None means a damaged or unfinished line.
        is_empty = value is None or (word == "model" and value == "")
        if is_empty and not is_record and word not in keys.RECORD_KEYS:
            why = f"{word[:40]} has no value"
            raise ParameterError(name, why, "Give it one, or delete the line for the default.")
    document |= {key: options[key] for key in ANGLES if key in options}
    described = {key: document.pop(key, None) for key in DESCRIBING}
    with blame(name):
        described = {
            k: DESCRIBING[k].check(value, k) for k, value in described.items() if value is not None
        }
    values = {key: value for key, value in document.items() if key not in keys.RECORD_KEYS}
    named = part_of(values, Named)
    for word in named:
        del values[word]
    base = _named(name, named) if named and not is_record else Config(name)
    described |= {"options": options, "named": named}
    recorded = document.get("input")
    described["recorded"] = recorded if is_record and isinstance(recorded, dict) else {}
    described["camera"] = {key: described.pop(key) for key in ANGLES if key in described}
    return replace(base, name=name, values={**base.values, **values}, **described)


def parameters_of(config: Config, overrides: Mapping[str, Value] | None = None) -> Parameters:
    """Merge defaults, `config` and `overrides`; a ParameterError names the source of the fault."""
    kind = kind_of(config)
    changes = kind.reformulated(overrides or {})
    values = {**config.values, **changes}
    rule = values.get("alarm")
    if isinstance(rule, str) and ":" in rule and rule not in keys.RULES:
        raise untrusted(rule, config.name, "alarm")
    try:
        return kind.from_mapping(values)
    except ParameterError as error:
        with blame(config.name):
            kind.from_mapping(config.values)
        raise ParameterError("", error.why, error.hint, "param") from None


def kind_of(config: Config) -> type[Parameters]:
    """The class of the parameters of a configuration; raises ParameterError."""
    name = config.model or DlgmdParameters.model
    return config.kind or find_model(name, config.name, in_file=True)


def _named(name: str, named: Named) -> Config:
    """The set or preset that the file `name` builds on."""
    if len(named) > 1:
        raise ParameterError(name, "set and preset exclude each other", "Give one of them.")
    ((key, value),) = named.items()
    text = shown(value).strip("'")
    if key == "preset":
        require_known("preset", text, PRESETS, name)
    with blame(name):
        return load_preset(text)


def parse_overrides(pairs: Iterable[str]) -> dict[str, Any]:
    """`KEY=VALUE` strings, each value read as YAML; raises ParameterError."""
    values: dict[str, Value] = {}
    for pair in (one for text in pairs for one in re.split(r",(?=\w+=)", text)):
        key, equals, text = pair.partition("=")
        if not equals or not key.strip():
            why = f"{pair[:60]!r} is not KEY=VALUE"
            raise ParameterError("", why, "Write r=4.", "param")
        with in_argument("param"):
            values[key.strip()] = parse("", text) if len(text) < 1000 else text
    return values
