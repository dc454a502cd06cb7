"""Docstrings name the arguments that functions and classes have."""

import ast
import inspect
import re
from pathlib import Path

from source import statements, tree

import dlgmd_cli

ROOT = Path(dlgmd_cli.__file__).parent


def documented(docstring):
    """The names in the section of the parameters."""
    section = re.search(r"^Parameters\n-+\n(.*?)(?=^[^\n]+\n-+\n|\Z)", docstring, re.M | re.S)
    lines = section[1].splitlines() if section else []
    names = [line.partition(" : ")[0] for line in lines if line and not line.startswith(" ")]
    return {name.strip("* ") for entry in names for name in entry.split(",")}


def arguments(node):
    """The names of the arguments of a function, or the fields of a class and its __init__."""
    if isinstance(node, ast.ClassDef):
        made = [one for one in node.body if isinstance(one, ast.FunctionDef)]
        fields = [one.target.id for one in node.body if isinstance(one, ast.AnnAssign)]
        return {*fields}.union(*(arguments(one) for one in made if one.name == "__init__"))
    given = node.args
    every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
    return {one.arg for one in every if one is not None}


def test_what_is_documented_is_an_argument():
    for path in ROOT.rglob("*.py"):
        for node in statements(tree(path)):
            docstring = isinstance(node, ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node)
            if docstring and "Parameters\n" in docstring:
                unknown = documented(docstring) - arguments(node)
                assert not unknown, f"{path}: {node.name}: {unknown}"


def test_public_functions_document_their_arguments():
    """Each argument has an entry, or stands in backquotes in another's."""
    for name in dlgmd_cli.__all__:
        function = getattr(dlgmd_cli, name)
        docstring = inspect.getdoc(function)
        if not inspect.isfunction(function) or not documented(docstring):
            continue
        known = documented(docstring) | {*re.findall(r"`(\w+)`", docstring)}
        own = {*function.__code__.co_varnames[: function.__code__.co_argcount]}
        own |= {*function.__kwdefaults__} if function.__kwdefaults__ else set()
        assert own <= known, f"{name}: {own - known}"
