"""Parameters and the values that they are to take: the axes of a sweep, and their grid."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal, localcontext
from typing import Any

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters import Parameters, Spec

MAX_VALUES, MAX_POINTS = 1000, 100_000
# A range ends at TO if a whole number of steps leads there but for this share of one.
_SLACK = Decimal("1e-6")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,3})?", re.ASCII)
_MAX_DIGITS = 40
_HINT = "Write KEY=FROM:TO:STEP, such as sigma_e=0.2:2:0.1, or KEY=VALUE,VALUE."


@dataclass(frozen=True)
class Axis:
    """A parameter and its values, in the parameter's own type.

    Attributes
    ----------
    key : str
        The parameter.
    spec : Spec
        What it means.
    values : tuple
        Different ones, at least one; numbers are in order. They may lie out of the key's range.
    """

    key: str
    spec: Spec
    values: tuple[Any, ...]

    @classmethod
    def parse(cls, text: str, kind: type[Parameters]) -> "Axis":
        """The axis that `text` describes, for a model that takes parameters of `kind`.

        Parameters
        ----------
        text : str
            ``KEY=FROM:TO:STEP``, TO included where the steps lead there, or ``KEY=VALUE,VALUE``.
        kind : type of Parameters
            The parameters of the model.

        Raises
        ------
        ParameterError
            If it does not describe one.

        Examples
        --------
        >>> from dlgmd_cli.parameters import DlgmdParameters
        >>> Axis.parse("sigma_e=0.2:0.5:0.1", DlgmdParameters).values
        (0.2, 0.3, 0.4, 0.5)
        """
        key, words = expand(text)
        specs = kind.specs()
        if key not in specs:
            raise kind.unknown(key)
        default = kind.defaults()[key]
        values = [_typed(key, word, default, specs[key]) for word in words]
        if len(set(values)) < len(values):
            twice = next(value for value in values if values.count(value) > 1)
            raise ParameterError("", f"{key} = {twice} stands twice", "Give every value once.")
        is_number = not isinstance(default, bool | str)
        return cls(key, specs[key], tuple(sorted(values) if is_number else values))

    @property
    def is_numeric(self) -> bool:
        """Whether its values have an order and distances."""
        return not isinstance(self.values[0], bool | str)

    def __len__(self) -> int:
        return len(self.values)


@dataclass(frozen=True)
class Grid:
    """Every value of one parameter with every value of another.

    Its points are numbered along x, row after row of y.

    Raises
    ------
    ParameterError
        If both axes are the same parameter, or there are too many points.
    """

    x: Axis
    y: Axis

    def __post_init__(self) -> None:
        if self.x.key == self.y.key:
            raise ParameterError(
                "", f"--x and --y are both {self.x.key}", "Choose another parameter for one."
            )
        if len(self) > MAX_POINTS:
            raise ParameterError(
                "",
                f"{len(self.x)} x {len(self.y)} points are more than {MAX_POINTS}",
                "Take larger steps.",
            )

    def __len__(self) -> int:
        return len(self.x) * len(self.y)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns, those of y and of x."""
        return len(self.y), len(self.x)

    def values(self, point: int) -> tuple[Any, Any]:
        """The values of x and y at a point."""
        row, column = divmod(point, len(self.x))
        return self.x.values[column], self.y.values[row]

    def overrides(self, point: int) -> dict[str, Any]:
        """Key -> value at a point."""
        return dict(zip((self.x.key, self.y.key), self.values(point), strict=True))


def expand(text: str) -> tuple[str, tuple[str, ...]]:
    """`KEY=FROM:TO:STEP` or `KEY=VALUE,VALUE` -> key and values as text, not yet checked.

    Raises
    ------
    ParameterError
        If it is neither of them, or there are too many values.
    """
    key, equals, rest = (part.strip() for part in text.partition("="))
    if not equals or not key or not rest:
        raise ParameterError("", f"{text[:60]!r} is no axis", _HINT)
    words = _range(rest) if ":" in rest else [word.strip() for word in rest.split(",")]
    if not all(words):
        raise ParameterError("", f"{text[:60]!r} has an empty value", _HINT)
    if len(words) > MAX_VALUES:
        raise _too_many(len(words))
    return key, tuple(words)


def _range(text: str) -> list[str]:
    """The values from FROM to TO; decimal arithmetic keeps 0.3 from being 0.30000000000000004."""
    parts = [part.strip() for part in text.split(":")]
    if len(parts) != 3 or not all(map(_is_number, parts)):
        raise ParameterError("", f"{text[:60]!r} is not FROM:TO:STEP in numbers", _HINT)
    with localcontext() as context:
        context.prec = 2 * _MAX_DIGITS
        start, end, step = map(Decimal, parts)
        if step <= 0 or end < start:
            why = "its STEP is not above 0" if step <= 0 else "its TO is below its FROM"
            raise ParameterError("", f"{text[:60]!r} holds no value, {why}", _HINT)
        n_steps = int(min((end - start) / step + _SLACK, Decimal(10**9)))
        if n_steps >= MAX_VALUES:
            raise _too_many(n_steps + 1)
        return [_plain(min(start + i * step, end)) for i in range(n_steps + 1)]


def _is_number(text: str) -> bool:
    return len(text) <= _MAX_DIGITS and _NUMBER.fullmatch(text) is not None


def _plain(number: Decimal) -> str:
    return str(int(number)) if number == number.to_integral_value() else str(number)


def _too_many(count: int) -> ParameterError:
    return ParameterError(
        "", f"{count} values are more than {MAX_VALUES}", "Take larger steps, or a shorter range."
    )


def _typed(key: str, word: str, default: Any, spec: Spec) -> Any:
    """One value in the key's own type."""
    if isinstance(default, bool | str):
        choices: Iterable[str] = spec.choices or ("true", "false")
        if word not in choices:
            raise ParameterError(
                "", f"{key} = {word[:40]!r} is not one of {spec.allowed}", f"Write {key}=A,B."
            )
        return word if spec.choices else word == "true"
    if not _is_number(word):
        raise ParameterError("", f"{key} = {word[:40]!r} is not a number", _HINT)
    number = Decimal(word)
    if not isinstance(default, int):
        return float(number)
    if number != number.to_integral_value() or abs(number) > 10**9:
        raise ParameterError("", f"{key} = {word} is not a whole number", "Write r=2:8:1.")
    return int(number)
