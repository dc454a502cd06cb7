"""Rules of one's own: named by their class, and in results that are read."""

from typing import Any

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.rules import Rule
from dlgmd_cli.parameters.keys import RULES, KnownRule, imported_model


class Stored(Rule):
    """A rule of one's own in a result that is read: its code is not imported.

    The result has the signals and alarms that were stored; no new frame is judged.
    """

    scored = "alarms"

    def value(self, row: Detection) -> float:
        """Raises ParameterError."""
        hint = f"Run again with alarm='{self.name}' (--alarm), if you trust that module."
        raise ParameterError("", f"the rule {self.name} is Python code, which no file starts", hint)

    @property
    def text(self) -> str:
        """The name alone."""
        return self.name


def own_rule(rule: Any) -> str:
    """The name of a rule, for parameters: a rule of one's own is imported, and known from then on.

    `rule` is a name, ``package.module:Class``, or a class. Raises ParameterError if the import
    fails, or it is no rule.
    """
    kind = rule
    if isinstance(rule, str):
        if ":" not in rule:
            return rule
        kind = imported_model(rule, what="rule")
    if not isinstance(kind, type) or not issubclass(kind, Rule):
        why = f"{str(rule)[:100]} is not a subclass of dlgmd_cli.Rule"
        is_number = isinstance(rule, int | float)
        hint = f"Write threshold={rule}." if is_number else "The page 'A custom model' has one."
        raise ParameterError("", why, hint)
    if kind.__module__ == Rule.__module__:
        return kind.name
    if "." in kind.__qualname__:
        why = f"the rule {kind.__name__} is defined within a function or class"
        raise ParameterError("", why, "Define it at the top of a module.")
    place = f"{kind.__module__}:{kind.__qualname__}"
    RULES[place] = KnownRule(place)
    return place


def keep_stored(name: Any) -> None:
    """Let `Stored` stand for the rule that a record names, if it is one's own and not known."""
    if isinstance(name, str) and ":" in name:
        RULES.setdefault(name, KnownRule(f"{__name__}:{Stored.__name__}"))
