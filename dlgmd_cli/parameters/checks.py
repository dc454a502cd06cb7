"""The allowed values of parameters and options: one check for files, Python and commands."""

import math
import numbers
import os
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import ParameterError, argument

# The units of options; a number with another one is not converted.
_UNITS = "%|°|deg|degrees?|s|secs?|seconds?|fps|hz|px|m|m/s|/s|1/s|frames?"


@dataclass(frozen=True)
class Spec:
    """Kind, meaning and allowed values of a parameter or an option.

    `kind` is float, int, bool or str. `low` and `high` are the inclusive bounds of a number;
    `low_open` excludes `low`. `choices` are the allowed words; a number with choices is either in
    its range or one of the words. `symbol`, `unit` and `meaning` are for tables and help.
    """

    kind: type = float
    low: float = -math.inf
    high: float = math.inf
    low_open: bool = False
    choices: Collection[str] = ()
    symbol: str = "–"
    unit: str = "–"
    meaning: str = ""

    @property
    def allowed(self) -> str:
        """The allowed values in words."""
        words = ("true", "false") if self.kind is bool else self.choices
        if self.kind in (bool, str):
            return ", ".join(words) or "any text"
        if self.low == -math.inf and self.high == math.inf:
            return "any number"
        low = f"{'above ' if self.low_open else ''}{self.low:g}"
        return ", ".join((f"{low} to {self.high:g}", *words))

    def check(self, value: Any, name: str = "", *, bounded: bool = True) -> Any:
        """`value` as a plain Python value of type `kind`; the error begins with `name`.

        Raises
        ------
        ParameterError
            If the value has another type, is not allowed or, if `bounded`, is out of range.
        """
        is_word = self.kind is str and not self.choices
        if isinstance(value, str) and (is_word or value in self.choices):
            return str(value)
        if self.kind is str:
            why: str | None = f"is not one of {self.allowed}" if self.choices else "is not a name"
        elif self.kind is bool:
            why = None if isinstance(value, bool) else "is not true or false"
        elif isinstance(value, bool) or not isinstance(value, numbers.Real):
            why = "is not a number" + "".join(f" or '{word}'" for word in self.choices)
        else:
            why = self._fault(value, bounded)
        if why is None:
            return self.kind(value)
        why = f"{f'{name} = ' if name else ''}{shown(value)} {why}"
        raise ParameterError("", why, self._hint(value, bounded))

    def _hint(self, value: Any, bounded: bool) -> str:
        """The number that a text such as `50%` means, or the range that a number is out of."""
        if self.kind not in (int, float) or isinstance(value, bool):
            return ""
        number = meant_number(value) if isinstance(value, str) else None
        if number is not None and self._fault(number, bounded) is None:
            return f"Write {number:.12g}."
        is_number = isinstance(value, numbers.Real) and self.unit != "–"
        return f"Choose {self.allowed} {self.unit}." if is_number else ""

    def parse(self, text: str, name: str = "", *, bounded: bool = True) -> Any:
        """The value written in `text`; raises ParameterError as `check` does."""
        value: Any = text.strip()
        if self.kind is bool:
            value = {"true": True, "false": False}.get(value.lower(), value)
        elif self.kind is not str and value not in self.choices:
            for kind in (float, int):
                with suppress(ValueError):
                    value = kind(text)
            if self.kind is int and isinstance(value, float) and value.is_integer():
                value = int(value)
        return self.check(value, name, bounded=bounded)

    def _fault(self, value: Any, bounded: bool) -> str | None:
        try:
            number = float(value)
        except OverflowError:  # an int too large for a float
            number = math.inf
        if not math.isfinite(number):
            return "is not a finite number"
        if self.kind is int and not isinstance(value, numbers.Integral):
            return "is not a whole number"
        if not bounded:
            return None
        if self.low_open and number <= self.low:
            return f"is not above {self.low:g}"
        if value < self.low:
            is_positive = number <= 0.0 < self.low and self.kind is float
            return "is not above 0" if is_positive else f"is not at least {self.low:g}"
        return f"is more than {self.high:g}" if value > self.high else None


def meant_number(text: str) -> float | None:
    """The number of a text with a decimal comma, a percent sign or a unit; or None."""
    match = re.fullmatch(rf"\s*([-+−]?\d*[.,]?\d+)\s*({_UNITS})?\s*", text, re.IGNORECASE)
    if match is None or re.fullmatch(r"\d+,\d{3}", match[1]):  # 1,000 may be 1 or 1000
        return None
    number = float(match[1].replace(",", ".").replace("−", "-"))
    return number / 100.0 if match[2] == "%" else number


@contextmanager
def blame(what: str) -> Iterator[None]:
    """Name `what` as the thing at fault in every ParameterError inside the context."""
    try:
        yield
    except ParameterError as error:
        raise ParameterError(what, error.why, error.hint) from None


@contextmanager
def in_argument(name: str) -> Iterator[None]:
    """Name an argument in every ParameterError inside the context that names nothing at fault."""
    try:
        yield
    except ParameterError as error:
        if error.what or error.argument:
            raise
        raise ParameterError("", error.why, error.hint, name) from error.__cause__


def nearest(word: str, known: Iterable[str], least: float = 0.6) -> str | None:
    """The word of `known` that is most similar to `word`, or None if none is similar enough."""

    def similarity(candidate: str) -> float:
        return SequenceMatcher(None, candidate.lower(), word.lower()).ratio()

    best = max(known, key=similarity, default="")
    return best if similarity(best) >= least else None


def listed(text: str) -> list[str]:
    """`9, 3-5` -> ["9", "3", "4", "5"]."""
    names: list[str] = []
    for part in map(str.strip, text.split(",")):
        ends = re.fullmatch(r"(\d{1,6})-(\d{1,6})", part, re.ASCII)
        numbers = range(int(ends[1]), int(ends[2]) + 1) if ends else ()
        names += map(str, numbers) if numbers else [part]
    return names


def similar_path(missing: str | os.PathLike[str]) -> str:
    """A question that names a file like the missing one, or a camera; empty if none is similar."""
    if str(missing).isdecimal():
        return f"Did you mean 'dlgmd live {missing}'?"
    similar = _similar(Path(missing))
    return f"Did you mean '{similar}'?" if similar else ""


def _similar(path: Path) -> Path | None:
    """The path itself, or the one that differs by case, suffix or a typo; None without any."""
    if path.exists():
        return path
    parent = _similar(path.parent)
    if parent is None or not parent.is_dir():
        return None
    names = sorted(one.name for one in parent.iterdir())
    same_stem = [name for name in names if Path(name).stem.lower() == path.stem.lower()]
    near = nearest(path.name, same_stem or names, 0.0 if same_stem else 0.8)
    return parent / near if near else None


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """A question that names the most similar of the `known` words; empty if none is similar."""
    near = nearest(word[:100], known)
    return f"Did you mean {near!r}? " if near else ""


def shown(value: Any) -> str:
    """A short form of a value for error messages, since nested values can be very long."""
    if isinstance(value, str):
        return repr(str(value[:40]))
    if isinstance(value, int) and abs(value) > 10**30:
        return "a huge number"
    if hasattr(value, "__len__"):
        return "a list or mapping"
    return str(value)[:40]


def refuse(given: Mapping[str, Any], why: str, hint: str = "Leave it out.") -> None:
    """Raise ParameterError if one of these arguments is given; the text is its name and `why`."""
    for name, value in given.items():
        if value is not None and value is not False and value not in ((), [], ""):
            raise ParameterError("", f"{argument(name)} {why}", hint)


def require_known(what: str, name: str, known: Iterable[str], origin: str = "") -> None:
    """Raise ParameterError if `name` is not one of the `known` names."""
    known = tuple(known)
    if name not in known:
        hint = f"{did_you_mean(name, known)}Choose from {', '.join(known)}."
        raise ParameterError(origin, f"there is no {what} {shown(name)}", hint)
