"""Parameters of every model: symbols, units, defaults and ranges; presets, files and merging.

Overrides take precedence over a preset or file, and that over the defaults; the result is frozen.
A new model needs a parameter class here, in the list `MODELS`, a module in `models/` that names the
class, and a YAML file in `configs/`. Models of one's own need none of that, see `find_model`.
"""

import math
from collections.abc import Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters.checks import Spec, blame, nearest, require_known, shown
from dlgmd_cli.parameters.keys import (
    OWN_MODELS,
    RECORD_KEYS,
    common_key,
    implied_key,
    imported_model,
    key,
    recorded_parameters,
)
from dlgmd_cli.parameters.keys import Parameters as Parameters
from dlgmd_cli.parameters.keys import ParametersT as ParametersT
from dlgmd_cli.parameters.plain_yaml import SHOW_HINT, parse, read

ENGINES = ("opencv", "numba")
LATENCIES = ("bands", "nearest", "interpolated")
# What a formulation stands for, unless the keys are given. `released` also has another lag and
# divisor of FFI, see `DLGMD`.
FORMULATIONS: dict[str, dict[str, Any]] = {
    "default": {"latency": "bands", "saturate": True},
    "released": {"latency": "bands", "saturate": True},
    "equations": {"latency": "interpolated", "saturate": False},
}
MAX_LATENCY_FRAMES = 64.0
# The configurations that `--config` takes by name; the first is the default.
PRESETS = ("flight", "flight-early", "road", "flight-small")
# Up to this width, frames are for the last one.
SMALL_WIDTH_PX = 128
# Frame width in px and frame rate that parameters are designed for, unless their file says.
DEFAULT_WIDTH_PX, DEFAULT_MODEL_FPS = 480, 30.0
# The keys of a file that are not parameters.
_DESCRIBING = {
    "model": Spec(str),
    "engine": Spec(str),
    "width_px": Spec(int, 1, 8192),
    "model_fps": Spec(float, 1, 1000),
}


@dataclass(frozen=True)
class DistributedParameters(Parameters, partial=True):
    """Parameters of the presynaptic connections, [Zhao2023] Eqs. (2) to (7); defaults of set 9."""

    formulation, latency = "default", "bands"

    alpha: float = key(-0.1, "α", "frames", "shift of the latency, Eq. (5)", -10, 64)
    beta: float = key(0.5, "β", "1/frames", "saturation of the latency, Eq. (5)", 0, 100)
    lam: float = key(0.7, "λ", "1/px", "spread of the latency, Eq. (5)", 0, 10)
    sigma_e: float = key(1.5, "σ_E", "px", "width of excitation, Eq. (4)", 0.01, 100)
    sigma_i: float = key(5.0, "σ_I", "px", "width of inhibition, Eq. (4)", 0.01, 100)
    r: int = key(6, "r", "px", "radius of the kernels", 1, 32)
    a: float = key(1.5, "a", "–", "strength of inhibition, Eq. (6)", 0, 100)

    def _check_together(self) -> None:
        """The latency must not be negative anywhere, nor longer than `MAX_LATENCY_FRAMES`."""
        centre = self.alpha + 1.0 / (self.beta + 1.0)
        if centre < 0.0:
            raise ParameterError(
                "",
                f"alpha = {self.alpha:g} with beta = {self.beta:g} makes the latency negative "
                f"({centre:.3g} frames at the centre)",
                "Inhibition cannot come before its cause; raise alpha.",
            )
        corner = self.beta + math.exp(-(self.lam**2) * 2 * self.r**2)
        longest = self.alpha + 1.0 / corner if corner > 0.0 else math.inf
        if longest > MAX_LATENCY_FRAMES:
            raise ParameterError(
                "",
                f"alpha = {self.alpha:g}, beta = {self.beta:g}, lam = {self.lam:g} and "
                f"r = {self.r} make the latency longer than {MAX_LATENCY_FRAMES:g} frames",
                "Lower alpha or lam, or raise beta.",
            )


@dataclass(frozen=True)
class DlgmdParameters(DistributedParameters):
    """Parameters of the D-LGMD; the defaults are set 9 of [Zhao2023], Tables I and II."""

    model: ClassVar[str] = "dlgmd"
    module: ClassVar[str] = "dlgmd_cli.models.dlgmd"
    preset: ClassVar[str] = "9"
    source: ClassVar[str] = "Zhao et al., IEEE TNNLS 34(5), 2023"

    k: float = key(1.0, "k", "–", "gain of the grouping, Eq. (9)", 1e-12, 100)
    ffi_gd: bool = key(True, "FFI-GD", "–", "threshold G by feed-forward inhibition, Eq. (10)")
    t0: float = key(0.5, "T_0", "–", "base of that threshold, Eq. (11)", 0, 100)
    m: float = key(0.4, "m", "–", "luminance change at which T_de = T_0, Eq. (11)", 0.001, 100)
    t_mp: float = common_key("t_mp")
    n_sp: int = common_key("n_sp")
    kappa: float = key(0.0028, "κ", "–", "mean excitation at which mp_abs is 1/2", 1e-9, 100)
    formulation: str = key(
        *("default", "–", "–", "whose latency, saturation and FFI: ours, the code's, the paper's"),
        choices=tuple(FORMULATIONS),
    )
    latency: str = implied_key(
        *("bands", "–", "–", "how delays that are not whole frames are rounded"), choices=LATENCIES
    )
    saturate: bool = implied_key(True, "–", "–", "limit G to 1 and T_de to 0.3")

    def __post_init__(self) -> None:
        for name, value in reformulated({"formulation": self.formulation}).items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        super().__post_init__()


# As in sets 1 to 3: the latency is one frame everywhere.
_ONE_FRAME_LATENCY = {"alpha": 0.0, "beta": 0.0, "lam": 0.0}


@dataclass(frozen=True)
class ContrastParameters(
    DistributedParameters, defaults=_ONE_FRAME_LATENCY | {"sigma_e": 0.9, "sigma_i": 3.0, "a": 1.7}
):
    """Parameters of the contrast-relative D-LGMD.

    The keys from `w_fps` to `k_0` do nothing by default: the preset `flight` sets them.
    """

    model: ClassVar[str] = "dlgmd-contrast"
    module: ClassVar[str] = "dlgmd_cli.models.contrast"
    preset: ClassVar[str] = "dlgmd-contrast"
    source: ClassVar[str] = "Contrast-relative D-LGMD; this project, after Zhao et al., 2023"

    c_p: float = key(0.2, "c_P", "–", "share of the contrast σ that P must exceed", 0, 100)
    p_min: float = key(0.011, "P_min", "luminance", "lowest threshold of P", 0, 1)
    c_n: float = key(2.5, "c_ν", "–", "multiple of the noise ν that P must exceed", 0, 100)
    c_s: float = key(0.6, "c_S", "–", "share of the contrast σ that S must exceed", 0, 100)
    s_min: float = key(0.008, "S_min", "luminance", "lowest threshold of S", 0, 100)
    w_sigma: float = key(0.2, "w_σ", "–", "weight of the newest frame in σ and ν", 0.001, 1)
    growth: float = key(1.5, "F_max", "–", "growth of change that begins to inhibit", 0.01, 1e6)
    w_m: float = key(0.25, "w_M", "–", "weight of the newest frame in mean change", 0.001, 1)
    sigma_c: float = key(
        0.45, "σ_c", "half sides", "width of the weighting about the centre", 0.05, 100
    )
    w_fps: float = key(
        0.0, "f_w", "1/s", "frame rate at which w_σ and w_M hold; 0 ignores times", 0, 1000
    )
    shift: int = key(0, "d_max", "px", "largest shift of the picture that is undone", 0, 64)
    balance: bool = key(False, "–", "–", "take the two weakest quadrants instead of all")
    deflicker: bool = key(False, "–", "–", "remove bands of mains light, and steps of the exposure")
    c_m: float = key(0.0, "c_m", "–", "multiple of its past mean that K must exceed", 0, 100)
    tau_m: float = key(2.0, "τ_m", "s", "time constant of that mean", 0.01, 1000)
    d_0: float = key(0.0, "D_0", "1/s", "rate of expansion from which K grows; 0: none", 0, 1000)
    tau_d: float = key(0.1, "τ_D", "s", "time constant of that rate", 0.001, 1000)
    k_0: float = key(0.0003, "K_0", "–", "share of cells that expansion counts as active", 0, 1)
    t_mp: float = common_key("t_mp")
    n_sp: int = common_key("n_sp")
    kappa: float = key(0.0138, "κ", "–", "K / n_cell at which mp_abs is 1/2", 1e-9, 100)


@dataclass(frozen=True)
class OnOffParameters(
    DlgmdParameters,
    defaults=_ONE_FRAME_LATENCY | {"sigma_e": 0.35, "sigma_i": 2.5, "r": 4, "kappa": 0.0466},
):
    """Parameters of the D-LGMD with ON and OFF pathways; the connections are those of set 3."""

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
    # At 25, the cell would be silent during contact; 255 is never exceeded.
    t_ffi: float = key(
        255.0, "T_FFI", "grey levels", "feed-forward inhibition that silences the cell", 0, 255
    )
    t_mp: float = common_key("t_mp", 0.99999994)
    n_sp: int = common_key("n_sp")

    def _check_together(self) -> None:
        """Persistence must decay."""
        if self.p2 >= 1.0 - abs(self.p1) or self.p2 <= -1.0:
            why = f"p1 = {self.p1:g} with p2 = {self.p2:g} makes every change grow for ever"
            mend = "Bring them nearer to 0."
            raise ParameterError("", why, mend)


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
    kappa: float = key(
        0.0021, "κ", "luminance²", "mean excitation at which mp_abs is 1/2", 1e-12, 100
    )


@dataclass(frozen=True)
class FlowDivergenceParameters(Parameters):
    """Parameters of the optical-flow baseline; its threshold is not published but ours."""

    model: ClassVar[str] = "flow-divergence"
    module: ClassVar[str] = "dlgmd_cli.models.flow_divergence"
    preset: ClassVar[str] = "9"
    source: ClassVar[str] = "OpenCV's DIS; Kroeger et al., 2016"

    t_mp: float = common_key("t_mp", 0.5)
    n_sp: int = common_key("n_sp")
    kappa: float = key(2.0, "κ", "1/s", "mean divergence at which mp_abs is 1/2", 1e-9, 1e9)


# Our models by the name for `--model`, which does not offer the baseline above.
MODELS: dict[str, type[Parameters]] = {
    kind.model: kind
    for kind in (
        *(DlgmdParameters, ContrastParameters, OnOffParameters),
        *(LgmdParameters, EmdLgmdParameters),
    )
}


@cache
def installed_models() -> dict[str, str]:
    """Name -> `package.module:Class` of the entry points of the group `dlgmd.models`."""
    from importlib.metadata import entry_points  # slow

    return {one.name: one.value for one in entry_points(group="dlgmd.models")}


def find_model(name: Any, origin: str = "", *, in_file: bool = False) -> type[Parameters]:
    """The parameter class of a model; the one place that decides whether a module is imported.

    Parameters
    ----------
    name : str or type
        One of the `MODELS`, an installed entry point, `package.module:Class`, whose module is
        imported, or the class itself.
    origin : str
        What names the model, for the error.
    in_file : bool
        Whether a file names the model. A file may come from anybody: of models of one's own it can
        name only those that are defined already, and installed entry points.

    Raises
    ------
    ParameterError
        If there is no such model, or the module or the class cannot be used.
    """
    found: Any = name
    if isinstance(name, str):
        if name in MODELS:
            return MODELS[name]
        if ":" not in name:
            require_known("model", name, (*MODELS, *installed_models()), origin)
        elif in_file and name in OWN_MODELS:
            return OWN_MODELS[name]
        elif in_file and name not in installed_models().values():
            raise untrusted(name, origin)
        found = imported_model(name if ":" in name else installed_models()[name], origin)
    kind = getattr(found, "params_class", None)
    if not isinstance(kind, type) or vars(kind).get("model_class") is not found:
        why = f"{str(name)[:100]} is not a subclass of dlgmd_cli.Model"
        raise ParameterError(origin, why, "See 'Your own model' in the documentation.")
    return kind


def untrusted(name: str, origin: str = "") -> ParameterError:
    """The error for a model that only a file names, so that its module is not imported."""
    why = f"its model {name[:100]} is Python code, which no file may start"
    return ParameterError(origin, why, f"If you trust that module, add --model {name[:100]}.")


def stored_parameters(record: Mapping[str, Any]) -> Parameters:
    """The parameters in a record, without importing anything.

    Those of a model of one's own are of its class if that is defined already; else plain values.
    Raises ParameterError if the model is unknown, or a parameter is not valid.
    """
    name = str(record.get("model"))
    kind = MODELS.get(name) or OWN_MODELS.get(name)
    if kind is None and ":" not in name:
        require_known("model", name, MODELS)
    if kind is not None:
        try:
            return kind.from_mapping({key: record[key] for key in kind.specs() if key in record})
        except ParameterError:
            if ":" not in name:
                raise
    return recorded_parameters(record)


def runnable(params: Parameters) -> Parameters:
    """Parameters of which a model can be created, from those of a record; raises ParameterError."""
    if ":" not in params.model or type(params).model_class is not None:
        return params
    return find_model(params.model, in_file=True).from_mapping(params.to_dict())


@dataclass(frozen=True)
class Config:
    """Contents of a configuration file: the model, its parameters, and the options of a run.

    `name` is the file's name in error messages. `values` holds the parameters, not yet checked.
    `named` is the set or preset that the file builds on, as in run.yaml. `width_px` and `model_fps`
    are the frame width and the frame rate that the parameters are designed for. `is_record` tells
    that it is a `run.yaml`.
    """

    name: str
    model: str | None = None
    engine: str | None = None
    width_px: int = DEFAULT_WIDTH_PX
    model_fps: float = DEFAULT_MODEL_FPS
    values: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)
    named: dict[str, Any] = field(default_factory=dict)
    is_record: bool = False


def design_of(params: Any) -> tuple[int, float]:
    """Frame width in px and frame rate that a model's published values are designed for."""
    model = getattr(params, "model", "")
    has_file = model in MODELS and model != DlgmdParameters.model
    file = load_model_preset(model) if has_file else Config("")
    return file.width_px, file.model_fps


def presets_dir() -> Path:
    """The folder of the presets: inside an installed package, beside it in the repository."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "configs"
    return installed if installed.is_dir() else package.parent / "configs"


def preset_names() -> list[str]:
    """The names that `--set` takes, in order."""
    names = (path.stem.removeprefix("set") for path in presets_dir().glob("set*.yaml"))
    return sorted(names, key=lambda name: (len(name), name))


def load_preset(name: str | int) -> Config:
    """The paper's set `name`, 1 to 9 or set1 to set9; raises ParameterError if there is none."""
    names = preset_names()
    number = str(name).removeprefix("set")
    if number not in names:
        why = f"there is no set {str(name)[:40]}"
        mend = f"Choose {names[0]} to {names[-1]}, or give a file with --config."
        if near := nearest(str(name)[:100], PRESETS):
            mend = f"Did you mean --config {near}? {mend}"
        raise ParameterError("", why, mend)
    return _shipped(f"set{number}")


def load_model_preset(model: str) -> Config:
    """The published values of a model other than the D-LGMD."""
    return _shipped(model)


def _shipped(stem: str) -> Config:
    """A preset of this package; each file is parsed once."""
    return deepcopy(_parsed(stem))


@cache
def _parsed(stem: str) -> Config:
    """The configuration in a file of this package."""
    return load_config(presets_dir() / f"{stem}.yaml")


def load_set(name: str | int, **overrides: Any) -> DlgmdParameters:
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
    name, path = str(path), Path(path)
    if name in PRESETS:
        return replace(_shipped(name), named={"preset": name})
    if not path.exists() and (near := nearest(name[:100], PRESETS)):
        raise ParameterError(name, "there is no such file or preset", f"Did you mean {near!r}?")
    document = parse(name, read(path))
    if document is None:
        raise ParameterError(name, "is empty", "Give at least one 'key: value'.")
    if not isinstance(document, dict):
        kinds: dict[type, str] = {list: "a list", str: "plain text"}
        kind = kinds.get(type(document), "one value")
        raise ParameterError(name, f"contains {kind}, not 'key: value' lines", SHOW_HINT)
    for one in document:
        if not isinstance(one, str):
            raise ParameterError(name, f"unknown parameter {shown(one)!r}", SHOW_HINT)
    options = document.pop("options", None) or {}
    if not isinstance(options, dict):
        raise ParameterError(name, "options is not a mapping", SHOW_HINT)
    own = {key: document.pop(key, None) for key in _DESCRIBING}
    with blame(name):
        own = {k: _DESCRIBING[k].check(value, k) for k, value in own.items() if value is not None}
    values = {key: value for key, value in document.items() if key not in RECORD_KEYS}
    named = {key: values.pop(key) for key in ("set", "preset") if key in values}
    # A run.yaml already holds every value.
    is_record = "schema" in document
    base = _named(name, named) if named and not is_record else Config(name)
    own |= {"options": options, "named": named, "is_record": is_record}
    return replace(base, name=name, values={**base.values, **values}, **own)


def parameters_of(config: Config, **overrides: Any) -> Parameters:
    """The parameters of a configuration, with single keys overridden; raises ParameterError."""
    kind = find_model(config.model or DlgmdParameters.model, config.name, in_file=True)
    return merge(kind, config, overrides)


def _named(name: str, named: dict[str, Any]) -> Config:
    """The set or preset that the file `name` builds on."""
    if len(named) > 1:
        raise ParameterError(name, "set and preset exclude each other", "Give one of them.")
    ((key, value),) = named.items()
    text = shown(value).strip("'")
    if key == "preset":
        require_known("preset", text, PRESETS, name)
        return load_config(text)
    with blame(name):
        return load_preset(text)


_PARAM = "Invalid value for '--param'"


def parse_overrides(pairs: Iterable[str]) -> dict[str, Any]:
    """`KEY=VALUE` strings, each value read as YAML; raises ParameterError."""
    values: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key.strip():
            raise ParameterError(_PARAM, f"{pair[:60]!r} is not KEY=VALUE", "Write r=4.")
        values[key.strip()] = parse(_PARAM, text) if len(text) < 1000 else text
    return values


def reformulated(values: Mapping[str, Any]) -> dict[str, Any]:
    """`values`, and what their formulation stands for, if they name one.

    For changes of parameters that already have a latency and a saturation.
    """
    name = values.get("formulation")
    stands_for = FORMULATIONS.get(name, {}) if isinstance(name, str) else {}
    return {**values, **{key: value for key, value in stands_for.items() if key not in values}}


def merge(
    kind: type[ParametersT], config: Config | None, overrides: Mapping[str, Any]
) -> ParametersT:
    """Merge defaults, `config` and `overrides`; a ParameterError names the one at fault."""
    values = config.values if config else {}
    try:
        return kind.from_mapping({**values, **reformulated(overrides)})
    except ParameterError as error:
        with blame(config.name if config else ""):
            kind.from_mapping(values)
        raise ParameterError(_PARAM, error.why, error.mend) from None
