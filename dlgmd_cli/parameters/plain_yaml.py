"""Reading YAML: the safe loader, with numbers such as 1e-3 as numbers."""

import re
from functools import cache
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import ParameterError

SHOW_HINT = "See 'dlgmd sets show 9' for one that works."


@cache
def _loader() -> Any:
    """The safe loader that reads 1e-3, text in YAML 1.1, as a number and refuses repeated keys."""
    import yaml  # slow, and the help of the commands does not need it

    class Loader(yaml.SafeLoader):
        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            """A dict; refuses a repeated key, of which YAML would silently take the last value."""
            seen = set()
            for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
                if key.value in seen:
                    why = f"key {key.value!r} appears twice"
                    raise yaml.constructor.ConstructorError(None, None, why, key.start_mark)
                seen.add(key.value)
            return super().construct_mapping(node, deep)

    number = re.compile(r"^[-+]?\d+(\.\d*)?[eE][-+]?\d+$")
    Loader.add_implicit_resolver(  # type: ignore[no-untyped-call]
        "tag:yaml.org,2002:float", number, list("-+0123456789")
    )
    return Loader


def read(path: Path) -> str:
    """The text of a configuration file; raises ParameterError."""
    if not path.is_file():  # reading a pipe could block
        why = "is not a file" if path.exists() else "there is no such file"
        raise ParameterError(str(path), why)
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8"
        raise ParameterError(str(path), f"cannot be read ({reason})") from None


def parse(name: str, text: str | bytes) -> Any:
    """The document in a text; raises ParameterError."""
    import yaml

    try:
        return yaml.load(text, Loader=_loader())
    except (yaml.YAMLError, RecursionError, ValueError, IndexError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark else ""
        why = f"is not valid YAML{where}"
        if isinstance(error, yaml.constructor.ConstructorError):
            why = f"{str(error.problem)[:200]}{where}"
        raise ParameterError(name, why, SHOW_HINT) from None
