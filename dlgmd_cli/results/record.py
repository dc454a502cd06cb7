"""run.yaml: everything that it takes to repeat a run, and what came of it."""

import platform
import re
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from dlgmd_cli import __version__
from dlgmd_cli.results.folder import RUN, Kind

_HEADERS = {
    RUN: "# Written by dlgmd. 'dlgmd run INPUT --config' with this file repeats the run.\n",
}

# Far more than any record has.
MAX_RECORD_BYTES = 1_000_000

# How the bytes of a file's name that are no UTF-8 are written.
_UNDECODABLE = re.compile(rb"\\u[dD][89a-fA-F]")

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


def yaml_text(document: dict[str, Any], **look: Any) -> str:
    """A document as YAML in its own order, all in ASCII if a terminal would act on a letter."""

    def dump(allow_unicode: bool) -> str:
        return str(
            yaml.safe_dump(
                document, sort_keys=False, width=100, allow_unicode=allow_unicode, **look
            )
        )

    text = dump(allow_unicode=True)
    return text if all(map(str.isprintable, text.split("\n"))) else dump(allow_unicode=False)


def write_record(
    folder: Path, record: dict[str, Any], kind: Kind = RUN, *, engines: Iterable[str]
) -> None:
    """Write `record` and the versions as YAML, in its own order; OSError passes through.

    `engines` are those that made the numbers.
    """
    used = versions(record["input"]["decoder"], *engines)
    text = yaml_text({**record, "versions": used})
    header = _HEADERS.get(kind, "# Written by dlgmd.\n")
    (folder / kind.record).write_text(header + text, encoding="utf-8")


def parse_document(text: bytes) -> dict[str, Any]:
    """A record of any kind, or nothing if it is none; never raises."""
    if len(text) > MAX_RECORD_BYTES:
        return {}
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast
    if _UNDECODABLE.search(text):
        loader = yaml.SafeLoader  # the fast one refuses them
    try:
        document = yaml.load(text, loader)
    except (yaml.YAMLError, ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}


def read_document(path: Path) -> dict[str, Any]:
    """The record of any kind in a file, or nothing if it cannot be read or is none."""
    try:
        with path.open("rb") as file:
            return parse_document(file.read(MAX_RECORD_BYTES + 1))
    except OSError:
        return {}


def parse_record(text: bytes) -> dict[str, Any]:
    """What `write_record` wrote, or nothing if it is not such; never raises."""
    record = parse_document(text)
    is_record = all(
        isinstance(record.get(key), dict) for key in ("input", "processed", "versions", "summary")
    )
    return record if is_record else {}
