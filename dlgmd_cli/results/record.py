"""Records such as run.yaml: everything needed to repeat a run, and its summary."""

import base64
import platform
import re
import zlib
from collections.abc import Iterable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import yaml

from dlgmd_cli import __version__

if TYPE_CHECKING:
    from pathlib import Path

    from upath import UPath

# Incremented when a key of the records changes its meaning.
SCHEMA = 1
_HEADER = "# Written by dlgmd.\n"
# Far more than any record needs.
_MAX_BYTES = 1_000_000
# Escapes for bytes of a file name that are not UTF-8; PyYAML's fast loader refuses them.
_UNDECODABLE = re.compile(rb"\\u[dD][89a-fA-F]")
# Packages that affect the numbers, by the decoder or engine that uses them.
_PACKAGES = {"pyav": "av", "numba": "numba"}


def versions(*used: str) -> dict[str, str]:
    """Versions of everything the numbers depend on, for the decoder and the engines in use."""
    import cv2

    found = {
        "dlgmd": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }
    for package in (_PACKAGES[name] for name in used if name in _PACKAGES):
        found[package] = import_module(package).__version__
    return found


def packed_flags(flags: bytes | bytearray) -> str:
    """Flags, one per byte, as short text: packed to bits, compressed by zlib, in base64."""
    bits = np.packbits(np.frombuffer(flags, np.bool_))
    return base64.b64encode(zlib.compress(bits.tobytes(), 9)).decode("ascii")


def unpacked_flags(text: str, n_flags: int) -> npt.NDArray[np.bool_]:
    """The inverse of `packed_flags`, shape (n_flags,); raises ValueError for any other text."""
    reader = zlib.decompressobj()
    try:
        data = reader.decompress(base64.b64decode(text, validate=True), n_flags // 8 + 1)
    except zlib.error as error:
        raise ValueError(str(error)) from None
    flags = np.unpackbits(np.frombuffer(data, np.uint8))[:n_flags]
    if len(flags) < n_flags:
        raise ValueError("too few flags")
    return flags.astype(np.bool_)


def yaml_text(document: Mapping[str, Any], header: str = _HEADER, **look: Any) -> str:
    """A document as YAML in its own order; pure ASCII if it contains control characters."""

    def dump(allow_unicode: bool) -> str:
        return str(
            yaml.safe_dump(
                dict(document), sort_keys=False, width=100, allow_unicode=allow_unicode, **look
            )
        )

    text = dump(allow_unicode=True)
    if not all(map(str.isprintable, text.split("\n"))):
        text = dump(allow_unicode=False)
    return header + text


def record_text(record: Mapping[str, Any], engines: Iterable[str], header: str = _HEADER) -> str:
    """A record with the schema number and the versions, as YAML."""
    known = {key: value for key, value in record.items() if key not in ("schema", "versions")}
    used = versions(str(known.get("input", {}).get("decoder")), *engines)
    return yaml_text({"schema": SCHEMA, **known, "versions": used}, header)


def read_record(path: "Path | UPath") -> dict[str, Any]:
    """The record in a file; empty if the file is not a readable record. Never raises."""
    try:
        with path.open("rb") as file:
            text = file.read(_MAX_BYTES + 1)
    except OSError:
        return {}
    if len(text) > _MAX_BYTES:
        return {}
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast
    if _UNDECODABLE.search(text):
        loader = yaml.SafeLoader
    try:
        document = yaml.load(text, loader)
    except (yaml.YAMLError, ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}
