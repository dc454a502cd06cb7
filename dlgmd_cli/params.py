"""The parameters of the model: every key with its symbol, unit, default and allowed range."""

import math
import numbers
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from difflib import SequenceMatcher, get_close_matches
from typing import Any, ClassVar, TypeVar

from dlgmd_cli.errors import ParameterError

FORMULATIONS = ("default", "released", "equations")
MAX_LATENCY_FRAMES = 64.0

ParametersT = TypeVar("ParametersT", bound="Parameters")


@dataclass(frozen=True)
class Spec:
    """What one key means and which values it takes."""

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
        if self.low == -math.inf:  # the one kind of key without a range
            return "true, false"
        return f"{self.low:g} to {self.high:g}"


def _key(default: Any, symbol: str, unit: str, meaning: str, **limits: Any) -> Any:
    return field(default=default, metadata={"spec": Spec(symbol, unit, meaning, **limits)})


class Parameters:
    """A frozen set of named, checked values; subclasses are dataclasses of `_key` fields.

    Every model's membrane potential is read out alike, by these three.
    """

    model: ClassVar[str] = ""

    t_mp: float
    n_sp: int
    kappa: float

    def __post_init__(self) -> None:
        for key, value in self.to_dict().items():
            object.__setattr__(self, key, self._checked(key, value))
        self._check_together()

    def _check_together(self) -> None:
        """Check what depends on several keys; nothing unless a subclass says so."""

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
        """Build from key -> value; a key left out keeps its default.

        Raises
        ------
        ParameterError
            If a key is unknown, or a value has the wrong type or is out of range.
        """
        known = cls.specs()
        for key in values:
            if key not in known:
                near = nearest(str(key)[:100], known)
                hint = f"Did you mean '{near}'? " if near else ""
                raise ParameterError(
                    "", f"unknown parameter {str(key)[:100]!r}", f"{hint}See 'dlgmd sets show 9'."
                )
        return cls(**values)

    def to_dict(self) -> dict[str, Any]:
        """Key -> value, in the order of definition; `from_mapping` takes it back."""
        return {key: getattr(self, key) for key in self.specs()}

    def _checked(self, key: str, value: Any) -> Any:
        """Return `value` in the key's own type, or say what is wrong with it."""
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
        number = _finite_or_none(value)
        if number is None:
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


@dataclass(frozen=True)
class DlgmdParameters(Parameters):
    """Parameters of the D-LGMD; the defaults are set 9 of [Zhao2023], Tables I and II."""

    model: ClassVar[str] = "dlgmd"

    alpha: float = _key(-0.1, "α", "frames", "shift of the latency, Eq. (5)", low=-10, high=64)
    beta: float = _key(0.5, "β", "1/frames", "saturation of the latency, Eq. (5)", low=0, high=100)
    lam: float = _key(0.7, "λ", "1/px", "spread of the latency, Eq. (5)", low=0, high=10)
    sigma_e: float = _key(1.5, "σ_E", "px", "width of excitation, Eq. (4)", low=0.01, high=100)
    sigma_i: float = _key(5.0, "σ_I", "px", "width of inhibition, Eq. (4)", low=0.01, high=100)
    r: int = _key(6, "r", "px", "radius of the kernels", low=1, high=32)
    a: float = _key(1.5, "a", "–", "strength of inhibition, Eq. (7)", low=0, high=100)
    k: float = _key(1.0, "k", "–", "gain of the grouping, Eq. (9)", low=1e-12, high=100)
    ffi_gd: bool = _key(True, "FFI-GD", "–", "threshold G by feed-forward inhibition, Eq. (10)")
    t0: float = _key(0.5, "T_0", "–", "base of that threshold, Eq. (11)", low=0, high=100)
    m: float = _key(
        0.4, "m", "–", "luminance change that T_0 is for, Eq. (11)", low=0.001, high=100
    )
    t_mp: float = _key(0.4, "T_MP", "–", "spiking threshold of the normalised MP", low=0, high=1)
    n_sp: int = _key(2, "n_sp", "frames", "spikes in a row that make a collision", low=1, high=1000)
    kappa: float = _key(
        0.0035, "κ", "–", "mean excitation at which mp_abs is 1/2", low=1e-9, high=100
    )
    formulation: str = _key(
        "default", "–", "–", "how latency meets whole frames", choices=FORMULATIONS
    )

    def _check_together(self) -> None:
        """Latency must be causal everywhere, and history short enough to keep."""
        nearest = self.alpha + 1.0 / (self.beta + 1.0)
        if nearest < 0.0:
            raise ParameterError(
                "",
                f"alpha = {self.alpha:g} with beta = {self.beta:g} makes the latency negative "
                f"({nearest:.3g} frames at the centre)",
                "Inhibition cannot come before its cause; raise alpha.",
            )
        if self.alpha > MAX_LATENCY_FRAMES - 1.0 / (self.beta + 1.0):
            raise ParameterError(
                "",
                f"alpha = {self.alpha:g} makes the latency longer than {MAX_LATENCY_FRAMES:g} "
                "frames everywhere",
                "Lower alpha.",
            )
        reach = self.beta + math.exp(-(self.lam**2) * 2 * self.r**2)
        if reach <= 0.0 or self.alpha + 1.0 / reach > MAX_LATENCY_FRAMES:
            raise ParameterError(
                "",
                f"beta = {self.beta:g} with lam = {self.lam:g} and r = {self.r} makes the latency "
                f"longer than {MAX_LATENCY_FRAMES:g} frames",
                "Raise beta or lower lam.",
            )


# The models that `--model` takes, with the parameters of each.
PARAMETERS: dict[str, type[Parameters]] = {kind.model: kind for kind in (DlgmdParameters,)}


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The word of `known` that is most like `word`, the first of equals, or None."""
    known = list(known)
    word = word.lower()
    close = get_close_matches(word, known, n=len(known))
    return max(
        close, key=lambda k: (SequenceMatcher(None, k, word).ratio(), -known.index(k)), default=None
    )


def _finite_or_none(value: Any) -> float | None:
    try:
        number = float(value)
    except OverflowError:  # an int too large for a float
        return None
    return number if math.isfinite(number) else None


def _wrong(key: str, value: Any, why: str) -> ParameterError:
    """An error that shows the value, briefly: a nested value could print without end."""
    if isinstance(value, str):
        shown = repr(str(value[:40]))
    elif isinstance(value, int) and abs(value) > 10**30:
        shown = "a huge number"
    elif hasattr(value, "__len__"):
        shown = "a list or mapping"
    else:
        shown = str(value)[:40]
    return ParameterError("", f"{key} = {shown} {why}")
