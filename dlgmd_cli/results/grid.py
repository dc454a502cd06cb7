"""The grid of a sweep over two parameters, and the values of parameters as text."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Any

from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.parameters.checks import Spec, in_argument
from dlgmd_cli.parameters.facts import Value
from dlgmd_cli.parameters.presets import Parameters
from dlgmd_cli.results.csv import cell

# An axis as the user gives it, see `Grid.parse`.
AxisText = str | tuple[str, Iterable[Value]]

MAX_VALUES, MAX_POINTS = 1000, 100_000
# TO belongs to a range if a whole number of steps reaches TO within this share of a step.
_SLACK = Decimal("1e-6")
_HINT = "Write KEY=FROM:TO:STEP, such as sigma_e=0.2:2:0.1, or KEY=VALUE,VALUE."


@dataclass(frozen=True)
class Axis:
    """A parameter and its values: at least one, of the parameter's type, numbers in order.

    Values may be outside the parameter's range.
    """

    key: str
    spec: Spec
    values: tuple[Value, ...]

    @classmethod
    def parse(cls, text: str, kind: type[Parameters]) -> "Axis":
        """Parse an axis for parameters of class `kind`; raises ParameterError.

        `text` is ``KEY=FROM:TO:STEP``, with TO included if the steps reach TO, or
        ``KEY=VALUE,VALUE``.
        """
        key, equals, rest = (part.strip() for part in text.partition("="))
        if not equals or not key or not rest:
            raise ParameterError("", f"{text[:60]!r} is not an axis", _HINT)
        if key not in kind.specs():
            raise kind.unknown(key)
        words = _range(rest) if ":" in rest else [word.strip() for word in rest.split(",")]
        if len(words) > MAX_VALUES:
            raise _too_many(len(words))
        spec = kind.specs()[key]
        if ".." in rest:
            raise ParameterError("", f"{text[:60]!r} is not an axis", _HINT)
        values = [spec.parse(word, key, bounded=False) for word in words]
        if len(set(values)) < len(values):
            twice = next(value for value in values if values.count(value) > 1)
            raise ParameterError("", f"{key} = {twice} appears twice", "Give every value once.")
        return cls(key, spec, tuple(values if spec.kind in (bool, str) else sorted(values)))

    @property
    def is_numeric(self) -> bool:
        """Whether the values are numbers."""
        return not isinstance(self.values[0], bool | str)

    def __len__(self) -> int:
        return len(self.values)


@dataclass(frozen=True)
class Grid:
    """All combinations of the values of two parameters; points are numbered row by row along x.

    Raises ParameterError if both are the same parameter, or there are too many points.
    """

    x: Axis
    y: Axis

    def __post_init__(self) -> None:
        if self.x.key == self.y.key:
            why = f"{argument('x')} and {argument('y')} are both {self.x.key}"
            raise ParameterError("", why, "Choose another parameter for one.")
        if len(self) > MAX_POINTS:
            why = f"{len(self.x)} x {len(self.y)} points are more than {MAX_POINTS}"
            raise ParameterError("", why, "Take larger steps.")

    @classmethod
    def parse(
        cls,
        x: AxisText,
        y: AxisText,
        kind: type[Parameters],
        param: Mapping[str, Value],
        formulation: str | None = None,
    ) -> "Grid":
        """The grid of two axes for parameters of class `kind`; raises ParameterError.

        An axis is text, see `Axis.parse`, or a key and its values. `param` and `formulation` must
        not set the parameter of an axis.
        """
        axes = []
        for name, axis in (("x", x), ("y", y)):
            text = axis if isinstance(axis, str) else f"{axis[0]}={','.join(map(str, axis[1]))}"
            with in_argument(name):
                axes.append(Axis.parse(text, kind))
            key = axes[-1].key
            if key in param:
                why = f"{argument('param')} sets {key}, which is an axis"
                raise ParameterError("", why, "Leave it out.")
            if key == "formulation" and formulation is not None:
                why = f"{argument('formulation')} is an axis of the sweep"
                raise ParameterError("", why, "Leave it out.")
        return cls(*axes)

    def __len__(self) -> int:
        return len(self.x) * len(self.y)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows (y) and columns (x)."""
        return len(self.y), len(self.x)

    def values_of(self, key: str) -> tuple[Any, ...]:
        """The values of a parameter; empty if the parameter is not an axis."""
        return next((axis.values for axis in (self.x, self.y) if axis.key == key), ())

    def values(self, point: int) -> tuple[Value, Value]:
        """The values of x and y at a point."""
        row, column = divmod(point, len(self.x))
        return self.x.values[column], self.y.values[row]

    def overrides(self, point: int) -> dict[str, Value]:
        """Key -> value at a point."""
        return dict(zip((self.x.key, self.y.key), self.values(point), strict=True))

    def points(self, params: Parameters) -> tuple[dict[int, Parameters], ParameterError | None]:
        """Point -> parameters for all valid points, and the error of the first invalid point.

        Raises ParameterError if no point is valid.
        """
        points, fault = dict[int, Parameters](), None
        for point in range(len(self)):
            try:
                points[point] = replace(params, **params.reformulated(self.overrides(point)))  # type: ignore[type-var]
            except ParameterError as error:
                fault = fault or error
        if fault and not points:
            raise ParameterError(f"{argument('x')} and {argument('y')}", fault.why, fault.hint)
        return points, fault


def as_text(value: Value) -> str:
    """A parameter's value as a user writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return value
    short = cell(value)
    return short if float(short) == value else repr(value)


def _range(text: str) -> list[str]:
    """The values from FROM to TO; Decimal avoids values such as 0.30000000000000004."""
    try:
        start, end, step = map(Decimal, text.split(":"))
        if not all(number.is_finite() for number in (start, end, step)):
            raise ValueError
        if step <= 0 or end < start:
            why = "its STEP is not above 0" if step <= 0 else "its TO is below its FROM"
            raise ParameterError("", f"{text[:60]!r} has no values: {why}", _HINT)
        n_steps = int(min((end - start) / step + _SLACK, Decimal(10**9)))
        if n_steps >= MAX_VALUES:
            raise _too_many(n_steps + 1)
        return [str(min(start + i * step, end)) for i in range(n_steps + 1)]
    except (ValueError, ArithmeticError):
        raise ParameterError("", f"{text[:60]!r} is not FROM:TO:STEP in numbers", _HINT) from None


def _too_many(count: int) -> ParameterError:
    why = f"{count} values are more than {MAX_VALUES}"
    return ParameterError("", why, "Take larger steps, or a shorter range.")
