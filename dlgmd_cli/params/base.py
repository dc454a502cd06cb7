"""What parameters of any model are: keys with a symbol, unit, default and allowed range."""

import math
import numbers
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from difflib import SequenceMatcher, get_close_matches
from typing import Any, ClassVar, TypeVar

from dlgmd_cli.errors import ParameterError

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


def key(default: Any, symbol: str, unit: str, meaning: str, **limits: Any) -> Any:
    """A field of `Parameters`: its default and its `Spec`."""
    return field(default=default, metadata={"spec": Spec(symbol, unit, meaning, **limits)})


def t_mp_key(default: float) -> Any:
    """The threshold that every model has."""
    return key(default, "T_MP", "–", "spiking threshold of the normalised MP", low=0, high=1)


def n_sp_key() -> Any:
    """The count that every model has."""
    return key(2, "n_sp", "frames", "spikes in a row that make a collision", low=1, high=1000)


class Parameters:
    """A frozen set of named, checked values; subclasses are dataclasses of `key` fields.

    Every model's membrane potential is read out by these three.

    Attributes
    ----------
    model : str
        Name of the model.
    preset : str
        What `dlgmd sets show` prints them by.
    source : str
        Where their values are from.
    t_mp : float
        Spiking threshold of the normalised membrane potential.
    n_sp : int
        Spikes in a row that make a collision.
    kappa : float or None
        Mean excitation at which `mp_abs` is 1/2; None where the model has a sigmoid of its own.
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
                    "",
                    f"unknown parameter {str(key)[:100]!r}",
                    f"{hint}See 'dlgmd sets show {cls.preset}'.",
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
    """An error that shows the value."""
    return ParameterError("", f"{key} = {shown(value)} {why}")


def shown(value: Any) -> str:
    """A value as errors show it, briefly: a nested one could print without end."""
    if isinstance(value, str):
        return repr(str(value[:40]))
    if isinstance(value, int) and abs(value) > 10**30:
        return "a huge number"
    if hasattr(value, "__len__"):
        return "a list or mapping"
    return str(value)[:40]
