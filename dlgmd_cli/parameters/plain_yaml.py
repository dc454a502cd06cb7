"""Reading YAML: the safe loader, with numbers such as 1e-3 as numbers."""

import re
from pathlib import Path
from typing import Any

import yaml

from dlgmd_cli.errors import ParameterError

SHOW_HINT = "See 'dlgmd sets show 9' for one that works."


class _Loader(yaml.SafeLoader):
    """PyYAML takes 1e-3 for text, since YAML 1.1 does."""


_Loader.add_implicit_resolver(  # type: ignore[no-untyped-call]
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?\d+(\.\d*)?[eE][-+]?\d+$"), list("-+0123456789")
)


def read(path: Path) -> str:
    """The text of a configuration file; raises ParameterError."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ParameterError(str(path), f"cannot be read ({reason})") from None


def parse(name: str, text: str | bytes) -> Any:
    """The document in a text; raises ParameterError."""
    try:
        return yaml.load(text, Loader=_Loader)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark else ""
        raise ParameterError(name, f"is not valid YAML{where}", SHOW_HINT) from None
