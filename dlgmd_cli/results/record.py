"""run.yaml: everything that it takes to repeat a run, and what came of it."""

import platform
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from dlgmd_cli import __version__
from dlgmd_cli.results.folder import RECORD_NAME

_HEADER = "# Written by dlgmd. 'dlgmd run INPUT --config' with this file repeats the run.\n"


# What else a number depends on, by the decoder or engine that made it.
_PACKAGES = {"pyav": "av", "numba": "numba"}


def versions(*used_beside: str) -> dict[str, str]:
    """Versions of what the numbers depend on, given the decoder and the engine."""
    used = {
        "dlgmd": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }
    for package in (_PACKAGES[name] for name in used_beside if name in _PACKAGES):
        used[package] = import_module(package).__version__
    return used


def write_record(folder: Path, record: dict[str, Any]) -> None:
    """Write `record` and the versions as YAML, in its own order; OSError passes through."""
    text = yaml.safe_dump(
        {**record, "versions": versions(record["input"]["decoder"], record["engine"])},
        sort_keys=False,
        allow_unicode=True,
        width=100,
    )
    (folder / RECORD_NAME).write_text(_HEADER + text, encoding="utf-8")
