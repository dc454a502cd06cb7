"""Own defaults of options: the file dlgmd.yaml in the working folder or in one above it.

Only the command line reads it. Click takes the defaults from the context (`default_map`), so that
an option that is given takes precedence, and the help shows what holds. A file that is found may be
anybody's: what it may do is limited, and errors do not quote it.
"""

import os
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters.checks import Spec, nearest
from dlgmd_cli.parameters.facts import Value
from dlgmd_cli.video.options import DECLARED

NAME, NONE = "dlgmd.yaml", "none"
# The file if --settings is not given, for scripts.
VARIABLE = "DLGMD_SETTINGS"
# Option -> what it stands for; those of `OwnDefault`.
_OF_INPUT = {name.replace("_", "-"): option for name, option in DECLARED.items() if option.own}
KEYS = {
    **{key: option.own for key, option in _OF_INPUT.items()},
    "format": "formats of figures, such as [png, pdf]",
    "out": "folder for the results",
}
# These may be numbers; they are passed on as texts.
_NUMBERS = [
    key
    for key, option in _OF_INPUT.items()
    if isinstance(option.kind, Spec) and option.kind.kind is float
]
# Paths in the file are relative to its folder.
_PATHS = ("mask", "out")
_HINT = "'dlgmd info --settings' lists what it may say."


class OwnDefault(click.Option):
    """An option whose default the user's own file may set, under the option's name."""

    @property
    def key(self) -> str:
        """The key in the file."""
        return max(self.opts, key=len).removeprefix("--")


def find(given: str | None) -> Path | None:
    """The file of defaults: the one given, that of DLGMD_SETTINGS, or the nearest dlgmd.yaml.

    None if there is none, or ``none`` is given. The one given need not exist. The search ends at
    the home folder. Raises ParameterError if the nearest file belongs to another user.
    """
    given = given or os.environ.get(VARIABLE)
    if given is not None:
        return None if given == NONE else Path(given)
    here, home = Path(os.path.abspath("")), os.path.realpath(_expanded("~"))
    for folder in (here, *here.parents):
        with suppress(OSError):  # a folder that may not be searched
            if (folder / NAME).is_file():
                path = Path(NAME) if folder == here else folder / NAME
                _require_own(path)
                return path
        if str(folder) == home:
            break
    return None


def _require_own(path: Path) -> None:
    """Raise ParameterError if a file, or a link to it, is of another user; OSError passes."""
    if not hasattr(os, "geteuid"):  # Windows
        return
    users = {os.geteuid()}
    if users == {0} and os.environ.get("SUDO_UID", "").isdecimal():  # as Git does
        users.add(int(os.environ["SUDO_UID"]))
    if not {path.lstat().st_uid, path.stat().st_uid} <= users:
        hint = f"If you trust it, add --settings {path}; --settings {NONE} leaves it out."
        raise ParameterError(str(path), "belongs to another user", hint)


def _expanded(path: str) -> str:
    """A path with the home folder for ``~``; unchanged if that is unknown, where Path raises."""
    return os.path.expanduser(path)  # noqa: PTH111


def read(path: Path) -> dict[str, str | list[str]]:
    """The defaults in a file, by option: texts, and a list of texts for `format`.

    Raises ParameterError if it is not plain YAML, or a key or the kind of a value is wrong. The
    error does not quote the file, which may be a link to anything.
    """
    from dlgmd_cli.parameters import plain_yaml

    name = str(path)
    try:
        text = plain_yaml.read(path)
    except ParameterError as error:
        raise ParameterError(name, error.why, _HINT) from None
    try:
        document = plain_yaml.parse(name, text)
    except ParameterError as error:
        where = re.search(r" in line \d+$", error.why)
        why = f"is not plain YAML{where[0] if where else ''}"
        raise ParameterError(name, why, _HINT) from None
    if not isinstance(document, dict | None):
        raise ParameterError(name, "does not consist of 'option: value' lines", _HINT)
    values: dict[str, str | list[str]] = {}
    for key, value in (document or {}).items():
        if key not in KEYS:
            near = nearest(str(key)[:100], KEYS)
            hint = f"Did you mean {near!r}?" if near else f"Choose from {', '.join(KEYS)}."
            raise ParameterError(name, "contains an unknown setting", hint)
        if key in _NUMBERS and type(value) in (int, float):
            value = str(value)
        texts = value if key == "format" and isinstance(value, list) else [value]
        if not texts or not all(isinstance(text, str) and text.strip() for text in texts):
            raise ParameterError(name, f"{key}: this is no text", f"It is the {KEYS[key]}.")
        if key in _PATHS:
            if "://" in value:
                raise ParameterError(name, f"{key}: a URL is not allowed here", f"Give --{key}.")
            value = str(path.parent / _expanded(value))
        values[key] = texts if key == "format" else value
    return values


def apply(ctx: click.Context, given: str | None) -> None:
    """Set the defaults of the command's options to those of the file, if there is one.

    Raises ParameterError if the file cannot be read, or a value is not one of the option's.
    """
    options = [param for param in ctx.command.params if isinstance(param, OwnDefault)]
    path = find(given) if options else None
    if path is None:
        return
    values, chosen = read(path), {}
    for option in options:
        if option.key in values:
            chosen[str(option.name)] = values[option.key]
            try:
                option.process_value(ctx, values[option.key])
            except click.UsageError:
                why = f"{option.key}: this value cannot be used"
                raise ParameterError(str(path), why, f"It is the {KEYS[option.key]}.") from None
    ctx.default_map, ctx.meta[NAME] = chosen, path


def in_help(ctx: click.Context, param: click.Option, text: str) -> str:
    """The help of an option, with the user's own default instead of ours."""
    chosen = (ctx.default_map or {}).get(str(param.name))
    if not isinstance(param, OwnDefault) or chosen is None:
        return text
    shown = ", ".join(chosen) if isinstance(chosen, list) else chosen
    return re.sub(r"\s*\[default: [^\]]*\]$", "", text) + f"  [{ctx.meta[NAME]}: {shown}]"


def in_force(ctx: click.Context) -> dict[str, Any]:
    """The file and its defaults that are in force, for the record; empty if there are none."""
    outdone, values = _outdone(ctx), ctx.default_map or {}
    chosen = {
        param.key: values[str(param.name)]
        for param in ctx.command.params
        if isinstance(param, OwnDefault)
        and param.key not in outdone
        and _is_own(ctx, str(param.name))
    }
    return {"file": os.path.abspath(ctx.meta[NAME]), **chosen} if chosen else {}


def _is_own(ctx: click.Context, name: str) -> bool:
    """Whether the value of a parameter comes from the file."""
    return ctx.get_parameter_source(name) is ParameterSource.DEFAULT_MAP


def _outdone(ctx: click.Context) -> set[str]:
    """The defaults of how the input is read that something more special outdoes.

    That is --scale, or a file of --config: a run.yaml repeats its run, whatever the defaults are.
    Without an INPUT, there is nothing that they apply to.
    """
    from dlgmd_cli.parameters.presets import load_config

    set_here = {name for name, option in DECLARED.items() if option.own and _is_own(ctx, name)}
    if ctx.params.get("inputs") == () or ctx.params.get("input_path", "") is None:
        return set_here
    outdone = {"size"} if ctx.params.get("scale") is not None else set()
    configs = ctx.params.get("configs") or [ctx.params.get("config")]
    for config in filter(None, configs if set_here else ()):
        file = load_config(config)
        outdone |= set_here if file.is_record else file.options.keys()
        outdone |= {"size"} if "scale" in file.options else set()
    return set_here & outdone


def given(**values: Value) -> dict[str, Any]:
    """The options of the input, without the defaults that are outdone."""
    return {**values, **dict.fromkeys(_outdone(click.get_current_context()))}


def recorded(collect: Callable[..., Any]) -> Callable[..., Any]:
    """`collect` whose models have the defaults that are in force, for their records."""

    def collected(**values: Value) -> Any:
        models, in_file = collect(**values), in_force(click.get_current_context())
        if not in_file:
            return models
        setups = models if isinstance(models, list) else [models]
        marked = [replace(setup, named={**setup.named, "settings": in_file}) for setup in setups]
        return marked if isinstance(models, list) else marked[0]

    return collected
