"""A safe subset of YAML for small files: numbers, booleans, names, lists and mappings."""

import re
from functools import lru_cache
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import ParameterError

MAX_CONFIG_BYTES = 100_000
# Nesting depth of lists and mappings; run.yaml has four levels.
MAX_DEPTH = 20
# Keys, values, lists and mappings; the longest record has some thousands.
MAX_EVENTS = 100_000
_PLAIN = "Only plain numbers, true, false and names are read."
SHOW_HINT = "See 'dlgmd sets show 9' for one that works."


def read(path: Path) -> str:
    """The text of a configuration file; raises ParameterError if it is missing or too large."""
    name = str(path)
    try:
        if not path.is_file():
            why = "is not a file" if path.exists() else "there is no such file"
            raise ParameterError(name, why, "Check the path.")
        with path.open("rb") as file:  # files in /proc report a size of 0
            data = file.read(MAX_CONFIG_BYTES + 1)
        size = max(path.stat().st_size, len(data))
        if size > MAX_CONFIG_BYTES:
            why = f"{size / 1e6:.1f} MB is too large for a configuration"
            raise ParameterError(name, why, SHOW_HINT)
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise ParameterError(name, "is not UTF-8 text", SHOW_HINT) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ParameterError(name, f"cannot be read ({reason})") from None


def parse(name: str, text: str | bytes, loader: Any = None) -> Any:
    """The document in `text`; tags and references are refused, no file of ours needs them.

    Unless given, `loader` is one without the surprises of YAML 1.1. Raises ParameterError.
    """
    import yaml

    loader, depth = loader or _loader(), 0
    try:
        for number, event in enumerate(yaml.parse(text, Loader=loader)):
            if number > MAX_EVENTS:
                raise ParameterError(name, "contains too many values", SHOW_HINT)
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:  # parsing time grows with the square of the depth
                raise ParameterError(name, "its values are nested too deeply", SHOW_HINT)
            tag, anchor = getattr(event, "tag", None), getattr(event, "anchor", None)
            if tag is not None or anchor is not None:
                what = f"the tag {tag!r}" if tag is not None else f"the reference {anchor!r}"
                raise ParameterError(name, f"{what[:200]} is not allowed", _PLAIN)
        return yaml.load(text, Loader=loader)
    except yaml.MarkedYAMLError as error:
        where = f" in line {error.problem_mark.line + 1}" if error.problem_mark else ""
        if isinstance(error, yaml.constructor.ConstructorError):  # a repeated or unhashable key
            raise ParameterError(name, f"{str(error.problem)[:200]}{where}", _PLAIN) from None
        raise ParameterError(name, f"is not valid YAML{where}", SHOW_HINT) from None
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError):
        raise ParameterError(name, "is not valid YAML", SHOW_HINT) from None


@lru_cache(maxsize=1)
def _loader() -> Any:
    """A safe loader without YAML 1.1 surprises: 1e-3 is a number, 010 is ten, 1:30 is text."""
    import yaml

    class Loader(yaml.SafeLoader):
        yaml_implicit_resolvers = {  # noqa: RUF012, PyYAML declares it this way
            first: [pair for pair in pairs if pair[0].rpartition(":")[2] in ("bool", "null")]
            for first, pairs in yaml.SafeLoader.yaml_implicit_resolvers.items()
        }

        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            """A dict; a key that appears twice is an error."""
            seen = set()
            for key, _ in node.value:
                if isinstance(key, yaml.ScalarNode) and key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"key {key.value!r} appears twice", key.start_mark
                    )
                seen.add(key.value if isinstance(key, yaml.ScalarNode) else id(key))
            return super().construct_mapping(node, deep)

    whole = r"[-+]?(0|[1-9]\d*|0x[0-9a-fA-F]+)"
    real = r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
    for tag, pattern, first in (("int", whole, "-+0123456789"), ("float", real, "-+.0123456789")):
        Loader.add_implicit_resolver(  # type: ignore[no-untyped-call]
            f"tag:yaml.org,2002:{tag}", re.compile(f"^(?:{pattern})$"), list(first)
        )
    return Loader
