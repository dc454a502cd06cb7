"""Parameters of every model: symbols, units, defaults and ranges; presets, files and merging.

Overrides take precedence over a preset or file, and that over the defaults; the result is frozen.
The registry `MODELS` lists the models. A new model needs a parameter class and an entry here, a
module in `models/`, and a YAML file in `configs/`.
"""

import math
import numbers
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, TypeVar

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.plain_yaml import SHOW_HINT, parse, read

ENGINES = ("opencv", "numba")
FORMULATIONS = ("default", "released", "equations")
MAX_LATENCY_FRAMES = 64.0
# The configurations that `--config` takes by name; the first is the default.
PRESETS = ("flight",)
# Frame width in px and frame rate that parameters are designed for, unless their file says.
DEFAULT_WIDTH_PX, DEFAULT_MODEL_FPS = 480, 30.0
# The file's keys for these two, with their upper bounds.
_DESIGN_LIMITS = {"width_px": 8192, "model_fps": 1000.0}
# Keys of run.yaml that are not parameters; they are ignored when the file is read as a config.
RECORD_KEYS = frozenset(
    [
        *("schema", "input", "processed", "frames", "sweep"),
        *("versions", "warnings", "complete", "summary", "wall_s", "collision_frame"),
    ]
)

ParametersT = TypeVar("ParametersT", bound="Parameters")


@dataclass(frozen=True)
class Spec:
    """Meaning and allowed values of one key."""

    symbol: str
    unit: str
    meaning: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()

    @property
    def allowed(self) -> str:
        """The allowed values in words, for tables and help."""
        if self.choices:
            return ", ".join(self.choices)
        if self.low == -math.inf:  # only boolean keys have no range
            return "true, false"
        return f"{self.low:g} to {self.high:g}"


def _key(default: Any, *spec: Any, **choices: Any) -> Any:
    """A field of `Parameters`: its default and its `Spec`."""
    return field(default=default, metadata={"spec": Spec(*spec, **choices)})


def _redefault(kind: "type[Parameters]", key: str, default: Any) -> Any:
    """The field of `kind` with another default."""
    return field(default=default, metadata={"spec": kind.specs()[key]})


def _t_mp(default: float) -> Any:
    """The spiking threshold, a key of every model."""
    return _key(default, "T_MP", "–", "spiking threshold of the normalised MP", 0, 1)


def _n_sp(default: int = 2) -> Any:
    """The number of spikes for an alarm, a key of every model."""
    return _key(default, "n_sp", "frames", "spikes in a row that raise an alarm", 1, 1000)


class Parameters:
    """Base of the parameter classes: frozen dataclasses of `_key` fields, checked when created.

    Attributes
    ----------
    model : str
        Name of the model.
    preset : str
        Name of a preset for `dlgmd sets show`.
    source : str
        Publication that the values come from.
    t_mp : float
        Spiking threshold of the normalised membrane potential, [Zhao2023] Eq. (14).
    n_sp : int
        Spikes in a row that raise an alarm, [Zhao2023] Eq. (15).
    kappa : float or None
        Mean excitation at which `mp_abs` is 1/2; None for a model with its own sigmoid.
    """

    model: ClassVar[str] = ""
    preset: ClassVar[str] = ""
    source: ClassVar[str] = ""

    t_mp: float
    n_sp: int
    kappa: float | None

    def __post_init__(self) -> None:
        for key, value in self.to_dict().items():
            object.__setattr__(self, key, self._checked(key, value))
        self._check_together()

    def _check_together(self) -> None:
        """Check values that depend on each other; subclasses override this."""

    @classmethod
    def specs(cls) -> dict[str, Spec]:
        """Key -> `Spec`, in the order of definition."""
        return {f.name: f.metadata["spec"] for f in fields(cls)}  # type: ignore[arg-type]

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """Key -> default value."""
        return {f.name: f.default for f in fields(cls)}  # type: ignore[arg-type]

    @classmethod
    def from_mapping(cls: type[ParametersT], values: Mapping[str, Any]) -> ParametersT:
        """Build from key -> value; missing keys keep their defaults.

        Raises
        ------
        ParameterError
            If a key is unknown, or a value has the wrong type or is out of range.
        """
        for key in values:
            if key not in cls.specs():
                raise cls.unknown(str(key))
        return cls(**values)

    @classmethod
    def unknown(cls, key: str) -> ParameterError:
        """The error for an unknown key; it suggests the most similar one."""
        near = nearest(key[:100], cls.specs())
        hint = f"Did you mean '{near}'? " if near else ""
        return ParameterError(
            "", f"unknown parameter {key[:100]!r}", f"{hint}See 'dlgmd sets show {cls.preset}'."
        )

    def to_dict(self) -> dict[str, Any]:
        """Key -> value, in the order of definition; the inverse of `from_mapping`."""
        return {key: getattr(self, key) for key in self.specs()}

    def _checked(self, key: str, value: Any) -> Any:
        """Return `value` converted to the key's type; raises ParameterError if it is invalid."""
        spec, default = self.specs()[key], self.defaults()[key]
        if isinstance(default, str):
            if not isinstance(value, str) or value not in spec.choices:
                raise _wrong(key, value, f"is not one of {spec.allowed}")
            return str(value)
        if isinstance(default, bool):
            if not isinstance(value, bool):
                raise _wrong(key, value, "is not true or false")
            return value
        if isinstance(value, bool) or not isinstance(value, numbers.Real):
            raise _wrong(key, value, "is not a number")
        try:
            number = float(value)
        except OverflowError:  # an int too large for a float
            number = math.inf
        if not math.isfinite(number):
            raise _wrong(key, value, "is not a finite number")
        if isinstance(default, int) and not isinstance(value, numbers.Integral):
            raise _wrong(key, value, "is not a whole number")
        if number < spec.low:
            is_positive = number <= 0.0 < spec.low and isinstance(default, float)
            bound = "above 0" if is_positive else f"at least {spec.low:g}"
            raise _wrong(key, value, f"is not {bound}")
        if number > spec.high:
            raise _wrong(key, value, f"is more than {spec.high:g}")
        return type(default)(value)


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The word of `known` that is most similar to `word`, or None if none is similar."""

    def similarity(candidate: str) -> float:
        return SequenceMatcher(None, candidate, word.lower()).ratio()

    best = max(known, key=similarity, default="")
    return best if similarity(best) >= 0.6 else None


def shown(value: Any) -> str:
    """A short form of a value for error messages; nested values could be very long."""
    if isinstance(value, str):
        return repr(str(value[:40]))
    if isinstance(value, int) and abs(value) > 10**30:
        return "a huge number"
    if hasattr(value, "__len__"):
        return "a list or mapping"
    return str(value)[:40]


def require_known(what: str, name: str, known: Iterable[str], origin: str = "") -> None:
    """Raise ParameterError if `name` is not one of the `known` names."""
    known = tuple(known)
    if name not in known:
        why, mend = f"there is no {what} {shown(name)}", f"Choose from {', '.join(known)}."
        raise ParameterError(origin, why, mend)


def _wrong(key: str, value: Any, why: str) -> ParameterError:
    """An error that shows the offending value."""
    return ParameterError("", f"{key} = {shown(value)} {why}")


@dataclass(frozen=True)
class DistributedParameters(Parameters):
    """Parameters of the presynaptic connections, [Zhao2023] Eqs. (2) to (7); defaults of set 9."""

    formulation = "default"

    alpha: float = _key(-0.1, "α", "frames", "shift of the latency, Eq. (5)", -10, 64)
    beta: float = _key(0.5, "β", "1/frames", "saturation of the latency, Eq. (5)", 0, 100)
    lam: float = _key(0.7, "λ", "1/px", "spread of the latency, Eq. (5)", 0, 10)
    sigma_e: float = _key(1.5, "σ_E", "px", "width of excitation, Eq. (4)", 0.01, 100)
    sigma_i: float = _key(5.0, "σ_I", "px", "width of inhibition, Eq. (4)", 0.01, 100)
    r: int = _key(6, "r", "px", "radius of the kernels", 1, 32)
    a: float = _key(1.5, "a", "–", "strength of inhibition, Eq. (7)", 0, 100)

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
    preset: ClassVar[str] = "9"
    source: ClassVar[str] = "Zhao et al., IEEE TNNLS 34(5), 2023"

    k: float = _key(1.0, "k", "–", "gain of the grouping, Eq. (9)", 1e-12, 100)
    ffi_gd: bool = _key(True, "FFI-GD", "–", "threshold G by feed-forward inhibition, Eq. (10)")
    t0: float = _key(0.5, "T_0", "–", "base of that threshold, Eq. (11)", 0, 100)
    m: float = _key(0.4, "m", "–", "luminance change at which T_de = T_0, Eq. (11)", 0.001, 100)
    t_mp: float = _t_mp(0.4)
    n_sp: int = _n_sp()
    kappa: float = _key(0.0028, "κ", "–", "mean excitation at which mp_abs is 1/2", 1e-9, 100)
    formulation: str = _key(
        *("default", "–", "–", "how delays that are not whole frames are rounded"),
        choices=FORMULATIONS,
    )


@dataclass(frozen=True)
class _OneFrameLatency(DistributedParameters):
    """Connections with α = β = λ = 0, as in sets 1 to 3: the latency is one frame everywhere."""

    alpha: float = _redefault(DistributedParameters, "alpha", 0.0)
    beta: float = _redefault(DistributedParameters, "beta", 0.0)
    lam: float = _redefault(DistributedParameters, "lam", 0.0)


@dataclass(frozen=True)
class ContrastParameters(_OneFrameLatency):
    """Parameters of the contrast-relative D-LGMD; the defaults are the preset `flight`."""

    model: ClassVar[str] = "dlgmd-contrast"
    preset: ClassVar[str] = "dlgmd-contrast"
    source: ClassVar[str] = "Contrast-relative D-LGMD; this project, after Zhao et al., 2023"

    sigma_e: float = _redefault(DistributedParameters, "sigma_e", 0.9)
    sigma_i: float = _redefault(DistributedParameters, "sigma_i", 3.0)
    a: float = _redefault(DistributedParameters, "a", 1.7)
    c_p: float = _key(0.2, "c_P", "–", "share of the contrast σ that P must exceed", 0, 100)
    p_min: float = _key(0.011, "P_min", "luminance", "lowest threshold of P", 0, 1)
    c_n: float = _key(2.5, "c_ν", "–", "multiple of the noise ν that P must exceed", 0, 100)
    c_s: float = _key(0.6, "c_S", "–", "share of the contrast σ that S must exceed", 0, 100)
    s_min: float = _key(0.008, "S_min", "luminance", "lowest threshold of S", 0, 100)
    w_sigma: float = _key(0.2, "w_σ", "–", "weight of the newest frame in σ and ν", 0.001, 1)
    growth: float = _key(1.5, "F_max", "–", "growth of change that begins to inhibit", 0.01, 1e6)
    w_m: float = _key(0.25, "w_M", "–", "weight of the newest frame in mean change", 0.001, 1)
    sigma_c: float = _key(
        0.45, "σ_c", "half sides", "width of the weighting about the centre", 0.05, 100
    )
    t_mp: float = _t_mp(0.4)
    n_sp: int = _n_sp()
    kappa: float = _key(0.0138, "κ", "–", "share of active cells at which mp_abs is 1/2", 1e-9, 100)


@dataclass(frozen=True)
class OnOffParameters(_OneFrameLatency, DlgmdParameters):
    """Parameters of the D-LGMD with ON and OFF pathways; the connections are those of set 3."""

    model: ClassVar[str] = "dlgmd-onoff"
    preset: ClassVar[str] = "dlgmd-onoff"
    source: ClassVar[str] = "ON/OFF D-LGMD; set 3 of Zhao et al., IEEE TNNLS 34(5), 2023"

    sigma_e: float = _redefault(DistributedParameters, "sigma_e", 0.35)
    sigma_i: float = _redefault(DistributedParameters, "sigma_i", 2.5)
    r: int = _redefault(DistributedParameters, "r", 4)
    kappa: float = _redefault(DlgmdParameters, "kappa", 0.0466)


@dataclass(frozen=True)
class LgmdParameters(Parameters):
    """Parameters of the LGMD of [Zhao2018], as published in its authors' released code."""

    model: ClassVar[str] = "lgmd"
    preset: ClassVar[str] = "lgmd"
    source: ClassVar[str] = "LGMD; Zhao et al., 2018, after Yue and Rind, 2006"
    # Normalised by its own sigmoid 1 / (1 + exp(-K / n_cell)), which is 1/2 at rest.
    kappa = None

    p1: float = _key(0.0, "p_1", "–", "persistence of change after one frame", -1, 1)
    p2: float = _key(0.0, "p_2", "–", "persistence of change after two frames", -1, 1)
    w_i: float = _key(0.3, "W_I", "–", "strength of inhibition", 0, 100)
    delta_c: float = _key(0.01, "Δ_C", "grey levels", "lowest scale ω of the grouping", 1e-6, 255)
    c_omega: float = _key(
        4.0, "C_ω", "–", "divisor of the greatest Ce in the grouping scale ω", 0.001, 1000
    )
    c_de: float = _key(0.15, "C_de", "–", "decay coefficient of G", 1e-6, 100)
    t_de: float = _key(15.0, "T_de", "grey levels", "threshold of decayed G", 0, 1e6)
    # At 25, the cell would be silent during contact; 255 is never exceeded.
    t_ffi: float = _key(
        255.0, "T_FFI", "grey levels", "feed-forward inhibition that silences the cell", 0, 255
    )
    t_mp: float = _t_mp(0.99999994)
    n_sp: int = _n_sp()

    def _check_together(self) -> None:
        """Persistence must decay."""
        if self.p2 >= 1.0 - abs(self.p1) or self.p2 <= -1.0:
            raise ParameterError(
                "",
                f"p1 = {self.p1:g} with p2 = {self.p2:g} makes every change grow for ever",
                "Bring them nearer to 0.",
            )


@dataclass(frozen=True)
class EmdLgmdParameters(Parameters):
    """Parameters of the LGMD on elementary motion detectors, after [Bermudez2007]."""

    model: ClassVar[str] = "emd-lgmd"
    preset: ClassVar[str] = "emd-lgmd"
    source: ClassVar[str] = "EMD-LGMD; after Bermudez i Badia, Pyk and Verschure, 2007"

    tau_high: float = _key(8.0, "τ_h", "frames", "time constant of the high-pass", 0.01, 1000)
    tau_low: float = _key(2.0, "τ_l", "frames", "time constant of the delay", 0.01, 1000)
    delta: float = _key(0.02, "δ", "–", "expansion predicted from a frame to the next", 0, 1)
    f_active: float = _key(0.05, "F_a", "luminance", "change above which a cell is active", 0, 1)
    c: float = _key(2.0, "c", "–", "strength of feed-forward inhibition", 0, 100)
    t_mp: float = _t_mp(0.4)
    n_sp: int = _n_sp()
    kappa: float = _key(
        0.0021, "κ", "luminance²", "mean excitation at which mp_abs is 1/2", 1e-12, 100
    )


@dataclass(frozen=True)
class FlowDivergenceParameters(Parameters):
    """Parameters of the optical-flow baseline; its threshold is not published but ours."""

    model: ClassVar[str] = "flow-divergence"
    preset: ClassVar[str] = "9"
    source: ClassVar[str] = "OpenCV's DIS; Kroeger et al., 2016"

    t_mp: float = _t_mp(0.5)
    n_sp: int = _n_sp()
    kappa: float = _key(2.0, "κ", "1/s", "mean divergence at which mp_abs is 1/2", 1e-9, 1e9)


class ModelEntry(NamedTuple):
    """A model: the class of its parameters, and the module and class that compute it."""

    parameters: type[Parameters]
    module: str
    attribute: str


# By the name for `--model`. The modules are imported on first use: importing OpenCV is slow.
MODELS: dict[str, ModelEntry] = {
    "dlgmd": ModelEntry(DlgmdParameters, "dlgmd_cli.models.dlgmd", "DLGMD"),
    "dlgmd-contrast": ModelEntry(ContrastParameters, "dlgmd_cli.models.contrast", "ContrastDLGMD"),
    "dlgmd-onoff": ModelEntry(OnOffParameters, "dlgmd_cli.models.on_off", "OnOffDLGMD"),
    "lgmd": ModelEntry(LgmdParameters, "dlgmd_cli.models.lgmd", "LGMD"),
    "emd-lgmd": ModelEntry(EmdLgmdParameters, "dlgmd_cli.models.emd_lgmd", "EmdLGMD"),
}

# Baselines for comparison; `--model` does not offer them.
BASELINES: dict[str, ModelEntry] = {
    "flow-divergence": ModelEntry(
        FlowDivergenceParameters, "dlgmd_cli.models.flow_divergence", "FlowDivergence"
    ),
}


@dataclass(frozen=True)
class Config:
    """Contents of a configuration file: the model, its parameters, and the options of a run.

    `name` is the file's name in error messages. `values` holds the parameters, not yet checked.
    `named` is the set or preset that the file builds on, as in run.yaml. `width_px` and `model_fps`
    are the frame width and the frame rate that the parameters are designed for.
    """

    name: str
    model: str | None = None
    engine: str | None = None
    width_px: int = DEFAULT_WIDTH_PX
    model_fps: float = DEFAULT_MODEL_FPS
    values: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)
    named: dict[str, Any] = field(default_factory=dict)


def presets_dir() -> Path:
    """The folder of the presets: inside an installed package, beside it in the repository."""
    package = Path(__file__).resolve().parent
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
        raise ParameterError(
            "", f"there is no set {str(name)[:40]}", f"Choose {names[0]} to {names[-1]}."
        )
    return load_config(presets_dir() / f"set{number}.yaml")


def load_model_preset(model: str) -> Config:
    """The published values of a model other than the D-LGMD."""
    return load_config(presets_dir() / f"{model}.yaml")


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
        return replace(load_config(presets_dir() / f"{name}.yaml"), named={"preset": name})
    document = parse(name, read(path))
    if document is None:
        raise ParameterError(name, "is empty", "Give at least one 'key: value'.")
    if not isinstance(document, dict):
        kinds: dict[type, str] = {list: "a list", str: "plain text"}
        kind = kinds.get(type(document), "one value")
        raise ParameterError(name, f"contains {kind}, not 'key: value' lines", SHOW_HINT)
    for key in document:
        if not isinstance(key, str):
            raise ParameterError(name, f"unknown parameter {shown(key)!r}", SHOW_HINT)
    own = {key: document.pop(key, None) for key in ("model", "engine", "options")}
    for key, value in own.items():
        right, what = (dict, "a mapping") if key == "options" else (str, "a name")
        if not isinstance(value, right | None):
            raise ParameterError(name, f"{key} is not {what}", SHOW_HINT)
    design = {
        key: _design(name, key, document.pop(key)) for key in _DESIGN_LIMITS if key in document
    }
    values = {key: value for key, value in document.items() if key not in RECORD_KEYS}
    own["options"] = own["options"] or {}
    named = {key: values.pop(key) for key in ("set", "preset") if key in values}
    base = Config(name)
    if named and "schema" not in document:  # a run.yaml already holds every value
        base = _named(name, named)
        own["model"] = own["model"] or base.model
    design = {key: getattr(base, key) for key in _DESIGN_LIMITS} | design
    return Config(name, **own, **design, values={**base.values, **values}, named=named)


def parameters_of(config: Config, **overrides: Any) -> Parameters:
    """The parameters of a configuration, with single keys overridden; raises ParameterError."""
    name = config.model or DlgmdParameters.model
    require_known("model", name, MODELS, config.name)
    return merge(MODELS[name].parameters, config, overrides)


def _named(name: str, named: dict[str, Any]) -> Config:
    """The set or preset that the file `name` builds on."""
    if len(named) > 1:
        raise ParameterError(name, "set and preset exclude each other", "Give one of them.")
    (key,) = named
    text = shown(named[key]).strip("'")
    if key == "preset":
        if text not in PRESETS:
            known = ", ".join(PRESETS)
            raise ParameterError(name, f"there is no preset {text}", f"Choose from {known}.")
        return load_config(text)
    try:
        return load_preset(text)
    except ParameterError as error:
        raise ParameterError(name, error.why, error.mend) from None


def _design(name: str, key: str, value: Any) -> Any:
    """A checked width in px or rate in frames per second."""
    is_whole, high = key == "width_px", _DESIGN_LIMITS[key]
    kind = numbers.Integral if is_whole else numbers.Real
    if isinstance(value, bool) or not isinstance(value, kind) or not 1 <= value <= high:  # type: ignore[operator]
        what = "a whole number" if is_whole else "a number"
        raise ParameterError(name, f"{key} = {shown(value)} is not {what} from 1 to {high:g}")
    return value if is_whole else float(value)  # type: ignore[arg-type]


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


def merge(
    kind: type[ParametersT], config: Config | None, overrides: Mapping[str, Any]
) -> ParametersT:
    """Merge defaults, `config` and `overrides`; a ParameterError names the one at fault."""
    values = config.values if config else {}
    try:
        return kind.from_mapping({**values, **overrides})
    except ParameterError as error:
        if config:
            try:
                kind.from_mapping(values)
            except ParameterError as fault:
                raise ParameterError(config.name, fault.why, fault.mend) from None
        raise ParameterError(_PARAM, error.why, error.mend) from None
