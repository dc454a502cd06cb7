"""The statements of modules, for tests that read the code."""

import ast
from functools import cache


@cache
def tree(path):
    """The syntax tree of a module."""
    return ast.parse(path.read_text(encoding="utf-8"))


def statements(node):
    """Every statement below a node; not the expressions, which take most of the time."""
    for name in ("body", "orelse", "finalbody", "handlers"):
        for one in getattr(node, name, ()):
            yield one
            yield from statements(one)
