"""Reading YAML: the safe loader, with numbers such as 1e-3 as numbers."""

import re
from functools import cache
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import ParameterError

SHOW_HINT = "See 'dlgmd sets show 9' for one that works."


@cache
def _loader() -> Any:
    """The safe loader, for which 1e-3 is a number. PyYAML takes it for text, as YAML 1.1 does."""
    import yaml  # slow, and the help of the commands needs none

    class Loader(yaml.SafeLoader):
        pass

    number = re.compile(r"^[-+]?\d+(\.\d*)?[eE][-+]?\d+$")
    Loader.add_implicit_resolver(  # type: ignore[no-untyped-call]
        "tag:yaml.org,2002:float", number, list("-+0123456789")
    )
    return Loader


def read(path: Path) -> str:
    """The text of a configuration file; raises ParameterError."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ParameterError(str(path), f"cannot be read ({reason})") from None


def parse(name: str, text: str | bytes) -> Any:
    """The document in a text; raises ParameterError."""
    import yaml

    try:
        return yaml.load(text, Loader=_loader())
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark else ""
        raise ParameterError(name, f"is not valid YAML{where}", SHOW_HINT) from None
