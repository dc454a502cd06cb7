"""The base of all parameter classes, also those of custom models: keys with checks."""

import math
import os
import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, fields, make_dataclass, replace
from functools import cache, lru_cache
from importlib import import_module
from keyword import iskeyword
from operator import attrgetter
from typing import Any, ClassVar, NamedTuple, TypeVar

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters.checks import Spec, did_you_mean
from dlgmd_cli.parameters.facts import Json, ModelFacts, Named, RunFacts, Value

# Keys of run.yaml that are not parameters; reading run.yaml as a configuration ignores them.
RECORD_KEYS = RunFacts.__optional_keys__
# Names that the keys of a model may not have.
_RESERVED = RECORD_KEYS.union(
    ModelFacts.__optional_keys__,
    Named.__optional_keys__,
    ("options", "fov", "camera_tilt"),
)

# The package of the models of the field, one module each.
PUBLISHED_MODELS = "dlgmd_cli.models.published"

# The units of the D-LGMD: px and frames of the video, or of the paper's camera. "1 px/frame is
# equivalent to 9 degrees/s in a 120 degrees, 30 frame rate camera", [Zhao2023] Fig. 11.
PIXELS, DEGREES = "pixels", "degrees"
PX_DEG, FRAME_S = 0.3, 1.0 / 30.0

ParametersT = TypeVar("ParametersT", bound="Parameters")

# The parameter classes of the custom models that this process has defined, by their names.
OWN_MODELS: dict[str, type["Parameters"]] = {}


def key(
    default: Value | Mapping[str, Value],
    symbol: str = "–",
    unit: str = "–",
    meaning: str = "",
    low: float = -math.inf,
    high: float = math.inf,
    *,
    choices: Collection[str] = (),
) -> Any:
    """A field of a parameter class.

    Parameters
    ----------
    default : float, int, bool or str, or a mapping of str to such a value
        The default, which determines the kind of the value; or the default by the name of each
        formulation, if the class has the key `formulation`.
    symbol, unit, meaning : str
        For `dlgmd sets show` and figures; "–" or empty for no symbol or no unit.
    low, high : float
        Inclusive bounds of a number.
    choices : collection of str
        The allowed words.
    """
    words = choices, symbol or "–", unit or "–", meaning
    by_formulation = default if isinstance(default, Mapping) else {}
    usual = next(iter(by_formulation.values())) if isinstance(default, Mapping) else default
    spec = Spec(type(usual), low, high, False, *words)
    return field(
        default=None if by_formulation else usual,  # None until the formulation is known
        metadata={"spec": spec, "by_formulation": by_formulation},
    )


KAPPA = "half-saturation constant of mp_abs (mean excitation)"


class KnownRule(NamedTuple):
    """Where the class of a rule is, `module:Class`, and when it raises an alarm, in words."""

    place: str
    words: str = ""


# The alarm rules by name; `models.rules.Rule` adds the rules of other modules, without words.
SPIKES, EXPANSION, CORRIDOR = "spikes", "expansion", "corridor"
RULES = {
    SPIKES: KnownRule("dlgmd_cli.models.rules:Spikes", "n_sp spikes in a row"),
    EXPANSION: KnownRule("dlgmd_cli.models.rules:Ahead", "an expansion of expansion_alarm or more"),
    CORRIDOR: KnownRule(
        "dlgmd_cli.models.rules:Corridor", "points in the drone's way at corridor_alarm or more"
    ),
    "ttc": KnownRule("dlgmd_cli.models.rules:Ttc", "a time to contact of ttc_alarm or less"),
}
_ALARM = Spec(str, choices=RULES)

# The keys of every model; a parameter class without one of these keys gets that key.
_COMMON: dict[str, tuple[Any, ...]] = {
    "t_mp": (0.4, "T_MP", "–", "spiking threshold of the normalised MP", 0, 1),
    "n_sp": (2, "n_sp", "frames", "spikes in a row that raise an alarm", 1, 1000),
    "kappa": (0.01, "κ", "–", KAPPA, 1e-12, 1e9),
    "alarm": ("spikes", "–", "–", f"rule that raises alarms: {', '.join(RULES)}"),
    "ttc_alarm": (1.25, "–", "s", "threshold of the rule ttc, a time to contact", 0.01, 100),
    "expansion_alarm": (0.47, "–", "1/s", "threshold of the rule expansion", 0.01, 10),
    "corridor_alarm": (0.5, "–", "1/s", "threshold of the rule corridor", 0.01, 10),
}


def common_key(name: str, default: Value | None = None) -> Any:
    """A key of every model: `t_mp`, `n_sp`, `kappa`, `alarm` or a rule's threshold."""
    usual, *facts = _COMMON[name]
    choices = RULES if name == "alarm" else ()
    return key(usual if default is None else default, *facts, choices=choices)


class Parameters:
    """Base of the parameter classes: frozen dataclasses of `key` fields, checked when created.

    Only the type of a field without `key` is checked. A class without `t_mp`, `n_sp`, `kappa`,
    `alarm`, `ttc_alarm`, `expansion_alarm` or `corridor_alarm` gets the missing key with the
    default 0.4, 2, 0.01, ``"spikes"``, 1.25, 0.47 or 0.5. With `rest`, T_MP is 0.4 of the way to 1.

    Attributes
    ----------
    model : str
        Name of the model; `package.module:Class` for a custom model.
    preset : str
        Name of a preset for `dlgmd sets show`.
    source : str
        Publication of the values.
    module : str
        The model's module, which is imported only on first use: importing OpenCV is slow.
    model_class : type or None
        The model's class, which sets this attribute when the class is defined.
    t_mp : float
        Spiking threshold of the normalised membrane potential, [Zhao2023] Eq. (14).
    n_sp : int
        Spikes in a row that raise an alarm, [Zhao2023] Eq. (15).
    kappa : float or None
        Half-saturation constant of `mp_abs`; None for a model with its own sigmoid.
    rest : float or None
        The response at rest of a model whose `mp` has a fixed scale already, such as 0.5: its
        `mp_abs` is `mp`, and it has no `kappa`. None for a potential that `mp_abs` normalises.
    alarm : str
        The name of the alarm's rule, one of `RULES` or ``"package.module:Class"``.
    ttc_alarm : float
        Time to contact, in seconds, below which the rule `ttc` raises an alarm.
    expansion_alarm : float
        Expansion rate, in 1/s, above which the rule `expansion` raises an alarm.
    corridor_alarm : float
        Rate in the drone's way, in 1/s, above which the rule `corridor` raises an alarm.
    """

    model: ClassVar[str] = ""
    preset: ClassVar[str] = ""
    source: ClassVar[str] = ""
    module: ClassVar[str] = ""
    model_class: ClassVar[Any] = None
    rest: ClassVar[float | None] = None

    t_mp: float
    n_sp: int
    kappa: float | None
    alarm: str
    ttc_alarm: float
    expansion_alarm: float
    corridor_alarm: float

    def __init_subclass__(cls, *, defaults: Mapping[str, Value] | None = None) -> None:
        """Add the missing common keys; `defaults` replaces the defaults of inherited keys."""
        super().__init_subclass__()
        inherited = getattr(cls, "__dataclass_fields__", {})
        for name, value in (defaults or {}).items():
            setattr(cls, name, field(default=value, metadata=inherited[name].metadata))
            cls.__annotations__[name] = inherited[name].type
        common = {name: usual for name, (usual, *_) in _COMMON.items()}
        renewed = set[str]()
        if "rest" in vars(cls) and (rest := cls.rest) is not None:
            if not (isinstance(rest, (int, float)) and 0.0 <= rest < 1.0):
                raise ParameterError(cls.__name__, f"rest = {rest!r} is not from 0 to below 1")
            cls.kappa = None
            common["t_mp"] = rest + common["t_mp"] * (1.0 - rest)
            if "t_mp" not in vars(cls):
                renewed.add("t_mp")  # an inherited threshold belongs to another rest
        for name, usual in common.items():
            if name in renewed or not hasattr(cls, name):
                setattr(cls, name, common_key(name, usual))
                cls.__annotations__[name] = type(usual)

    def __post_init__(self) -> None:
        named = {"formulation": getattr(self, "formulation", None)}
        for name, value in self.reformulated(named).items():
            if getattr(self, name, value) is None:
                object.__setattr__(self, name, value)
        specs = self.specs()
        for name, value in self.to_dict().items():
            object.__setattr__(self, name, specs[name].check(value, name))
        self._check_together()

    def _check_together(self) -> None:
        """Check values that depend on each other; subclasses override this."""

    def __reduce__(self) -> Any:
        # A worker process then imports the model's module too, not only the module of the
        # parameters, and knows the module of the rule.
        by_name = ":" in self.model or self.module.startswith(PUBLISHED_MODELS)
        kind = f"{self.module}:{self.model_class.__qualname__}" if by_name else type(self)
        return _restored, (kind, self.to_dict(), RULES[self.alarm])

    @classmethod
    def own_of(cls, model_class: type, model: str) -> "type[Parameters]":
        """The parameter class of a custom model, whose name `model` is `package.module:Class`.

        A model of the field has a name of its own, that of its module.

        Returns this class, or a new subclass if this class belongs to another model.

        Raises ParameterError if a key has a reserved name or no default, or the class is not
        frozen.
        """
        kind: Any = cls
        if cls is Parameters or vars(cls).get("model", model) != model:
            facts = {"__module__": model_class.__module__}
            kind = type(f"{model_class.__name__}Parameters", (cls,), facts)
        if "__dataclass_params__" not in vars(kind):
            kind = dataclass(frozen=True)(kind)
        why = "" if kind.__dataclass_params__.frozen else "is not frozen"
        for item in fields(kind):
            if item.name in _RESERVED:
                why = f"has a key {item.name!r}, a name with another meaning in run.yaml"
            elif not isinstance(item.default, bool | int | float | str) and (
                not item.metadata.get("by_formulation")
            ):
                why = f"has no number, word, True or False as the default of {item.name}"
        if why:
            raise ParameterError(model, f"its parameter class {why}")
        kind.model = kind.preset = model
        kind.module, kind.model_class = model_class.__module__, model_class
        OWN_MODELS[model] = kind
        return OWN_MODELS[model]

    @classmethod
    def specs(cls) -> dict[str, Spec]:
        """Key -> `Spec`, in the order of definition."""
        return _specs(cls)  # type: ignore[arg-type]

    @classmethod
    def defaults(cls) -> dict[str, Value]:
        """Key -> default value."""
        return cls().to_dict()

    @classmethod
    def from_mapping(cls: type[ParametersT], values: Mapping[str, Json]) -> ParametersT:
        """Build from key -> value; missing keys keep their defaults.

        Raises ParameterError if a key is unknown, or a value has the wrong type or is out of range.
        """
        for name in values:
            if name not in cls.specs():
                raise cls.unknown(str(name))
        return cls(**values)

    @classmethod
    def reformulated(cls, values: Mapping[str, Value | None]) -> dict[str, Any]:
        """`values` and, if they name a formulation, the keys that the formulation implies."""
        name, implied = values.get("formulation"), dict[str, Value]()
        for item in fields(cls):  # type: ignore[arg-type]
            by_formulation = item.metadata.get("by_formulation", {})
            if isinstance(name, str) and name in by_formulation:
                implied[item.name] = by_formulation[name]
        return {**implied, **values}

    @classmethod
    def unknown(cls, key: str) -> ParameterError:
        """The error for an unknown key; it suggests the most similar one."""
        hint = f"{did_you_mean(key, cls.specs())}See 'dlgmd sets show {cls.preset}'."
        return ParameterError("", f"unknown parameter {key[:100]!r}", hint)

    def to_dict(self) -> dict[str, Value]:
        """Key -> value, in the order of definition; the inverse of `from_mapping`."""
        return {name: getattr(self, name) for name in self.specs()}


def in_degrees(params: Parameters) -> bool:
    """Whether a model's units are degrees and ms: it takes each frame as it comes, at its size."""
    return params.to_dict().get("units") == DEGREES


@cache
def _specs(kind: type[Parameters]) -> dict[str, Spec]:
    """Key -> `Spec`; the `Spec` of a field without `key` checks only the type."""
    specs = {}
    for item in fields(kind):  # type: ignore[arg-type]
        facts = item.metadata or (common_key(item.name).metadata if item.name in _COMMON else {})
        spec = facts.get("spec") or Spec(type(item.default))
        specs[item.name] = replace(spec, kind=float) if item.type in (float, "float") else spec
    return specs


def changed(params: ParametersT, **values: Value) -> ParametersT:
    """`params` with other `values`; raises ParameterError as `Parameters.from_mapping` does."""
    return params.from_mapping({**params.to_dict(), **values})


def _restored(
    kind: str | type[Parameters], values: dict[str, Value], rule: KnownRule
) -> Parameters:
    RULES.setdefault(str(values["alarm"]), rule)
    kind = imported_model(kind).params_class if isinstance(kind, str) else kind
    return kind.from_mapping(values)


def find_modules_here() -> None:
    """Let Python find modules in the working folder, once the command line names a module.

    Earlier, a file there could pass for an optional package that is not installed. The folder comes
    last in the search path: no file there replaces a library.
    """
    here = os.path.abspath("")
    if here not in sys.path:
        sys.path.append(here)


def imported_model(spec: str, origin: str = "", what: str = "model") -> Any:
    """The class of the name `package.module:Class`; raises ParameterError if the import fails."""
    module, _, name = spec.partition(":")
    try:
        return attrgetter(name)(import_module(module))
    except (Exception, SystemExit) as error:  # whatever the module raises
        fault = f"{type(error).__name__}: {str(error)[:200]}"
        why = f"the {what} {spec[:100]} cannot be imported ({fault})"
        hint = "Write package.module:Class, of a module in this folder or an installed package."
        if module.endswith(".py"):
            hint = f"Write {module.removesuffix('.py').replace('/', '.')}:{name}."
        raise ParameterError(origin, " ".join(why.split()), hint) from error


def recorded_parameters(record: Mapping[str, Any]) -> Parameters:
    """The parameters in a record as unchecked plain values, without any code of the model.

    Raises ParameterError if the record has no `t_mp` or `n_sp`, or an unknown alarm rule.
    """
    values = {
        name: value
        for name, value in record.items()
        if isinstance(value, bool | int | float | str) and _is_plain_key(name)
    }
    for name in ("t_mp", "n_sp"):
        if type(values.get(name)) not in (int, float):
            raise ParameterError("", f"it states no {name}")
    _ALARM.check(values.get("alarm", SPIKES), "alarm")
    items = tuple((name, type(value), value) for name, value in values.items())
    return _recorded_class(str(record["model"]), items)()


def _is_plain_key(name: str) -> bool:
    """Whether a key of a record can be a parameter: no reserved name, no attribute of the class."""
    is_name = name.isidentifier() and not iskeyword(name) and not name.startswith("_")
    return is_name and name not in _RESERVED and not hasattr(Parameters, name)


# Cached so that equal parameters have the same class and compare equal.
@lru_cache(maxsize=1000)
def _recorded_class(model: str, items: tuple[tuple[str, type, Value], ...]) -> type[Parameters]:
    """The class of recorded parameters with these names, types and values."""
    names: dict[str, Any] = {"model": model, "preset": model, "__reduce__": _reduced}
    if not any(name == "kappa" for name, _, _ in items):
        names["kappa"] = None
    recorded: type[Parameters] = make_dataclass(
        "RecordedParameters",
        [(name, kind, key(value)) for name, kind, value in items],
        bases=(Parameters,),
        frozen=True,
        namespace=names,
    )
    return recorded


def _reduced(
    params: Parameters,
) -> tuple[Callable[..., Parameters], tuple[dict[str, Value], KnownRule]]:
    """Pickles recorded parameters as a record, since unpickling must not import the model."""
    record = {"model": params.model, **params.to_dict()}
    return _restored_record, (record, RULES[params.alarm])


def _restored_record(record: dict[str, Value], rule: KnownRule) -> Parameters:
    RULES.setdefault(str(record["alarm"]), rule)
    return recorded_parameters(record)
