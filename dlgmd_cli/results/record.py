"""Records such as run.yaml: everything needed to repeat a run, its summary, and what made it."""

import base64
import math
import platform
import re
import zlib
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import yaml

from dlgmd_cli import __version__
from dlgmd_cli.errors import ParameterError, ResultError, argument
from dlgmd_cli.machine.files import open_regular
from dlgmd_cli.parameters import plain_yaml
from dlgmd_cli.parameters.presets import reformulated

if TYPE_CHECKING:
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

    numbers = {
        "dlgmd": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }
    for package in (_PACKAGES[name] for name in used if name in _PACKAGES):
        numbers[package] = import_module(package).__version__
    return numbers


def unpacked_flags(text: str, n_flags: int) -> npt.NDArray[np.bool_]:
    """Flags, shape (n_flags,), from the text of records up to 2.0: bits, by zlib, in base64.

    Raises ValueError for any other text.
    """
    reader = zlib.decompressobj()
    try:
        data = reader.decompress(base64.b64decode(text, validate=True), n_flags // 8 + 1)
    except zlib.error as error:
        raise ValueError(str(error)) from None
    flags = np.unpackbits(np.frombuffer(data, np.uint8))[:n_flags]
    if len(flags) < n_flags:
        raise ValueError("too few flags")
    return flags.astype(np.bool_)


class _Dumper(yaml.SafeDumper):
    """Writes an object in full wherever it appears; no reader takes references."""

    def ignore_aliases(self, data: Any) -> bool:
        """Never refer to an object."""
        return True


def yaml_text(document: Mapping[str, Any], header: str = _HEADER, **look: Any) -> str:
    """A document as YAML in its own order; pure ASCII if it contains control characters."""
    look |= {"Dumper": _Dumper, "sort_keys": False, "width": 100}
    text = str(yaml.dump(dict(document), allow_unicode=True, **look))
    if not all(map(str.isprintable, text.split("\n"))):
        text = str(yaml.dump(dict(document), **look))
    return header + text


def record_text(record: Mapping[str, Any], engines: Iterable[str], header: str = _HEADER) -> str:
    """A record with the schema number, the versions and the machine, as YAML."""
    ours = ("schema", "versions", "machine")
    known = {key: value for key, value in record.items() if key not in ours}
    decoder, made_by = str(known.get("input", {}).get("decoder")), provenance()
    used = versions(decoder, *engines)
    used |= {key: made_by[key] for key in ("commit",) if key in made_by}
    if ffmpeg := ffmpeg_of(decoder):
        used["ffmpeg"] = ffmpeg
    machine = {key: made_by[key] for key in ("cpu", "os") if key in made_by}
    return yaml_text({"schema": SCHEMA, **known, "versions": used, "machine": machine}, header)


def read_record(path: "Path | UPath") -> dict[str, Any]:
    """The record in a file; empty if the file is not a readable record. Never raises.

    Depth and size are bounded, and references are refused. Keys that `_KINDS` has are left out if
    their values are of another kind, so that whatever is there can be relied on.
    """
    try:
        with open_regular(path, "rb") as file:
            text = file.read(_MAX_BYTES + 1)
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast
        most = _MAX_BYTES
        if _UNDECODABLE.search(text):
            loader, most = yaml.SafeLoader, plain_yaml.MAX_CONFIG_BYTES
        document = plain_yaml.parse("", text, loader) if len(text) <= most else None
    except (OSError, ParameterError):
        return {}
    return _of_kinds(document, _KINDS) if isinstance(document, dict) else {}


def require(path: object, record: Mapping[str, Any], *names: str) -> None:
    """Raise ResultError unless a record has all of these; ``input.fps`` is `fps` of `input`."""
    for name in names:
        section, _, key = name.rpartition(".")
        if (record.get(section, {}) if section else record).get(key) is None:
            raise ResultError(str(path), f"does not state a valid {name}", "Run again.")


# What the item `input` of a record says of the input beside what identifies it.
_ABOUT_INPUT = {
    *("name", "width", "height", "fps", "frames", "duration_s", "decoder", "deinterlaced"),
    *("repeats", "repeated_rows", "dropped", "left_out"),
}


def identity_in(record: Mapping[str, Any]) -> dict[str, Any]:
    """What identifies the input that a record is about."""
    known = record.get("input") or {}
    return {key: value for key, value in known.items() if key not in _ABOUT_INPUT}


def differences(
    record: Mapping[str, Any],
    *,
    identity: Mapping[str, Any] | None = None,
    settings: Mapping[str, Any] | None = None,
    options: Mapping[str, Any] | None = None,
) -> list[str]:
    """Names of everything in which a record differs from what is asked; empty for the same job.

    Parameters
    ----------
    record : mapping
        As `read_record` returns it.
    identity : mapping, optional
        What identifies the input, such as its path and size; named `input` if anything differs.
    settings : mapping, optional
        Keys of the record and the values that they should have.
    options : mapping, optional
        All options; one that only the record has is a difference, too. They are named as users
        write them. A file's hash belongs to the option that names the file.
    """
    known, chosen = record.get("input") or {}, record.get("options") or {}
    # A record of before latency and saturate were keys has only their formulation; one of before
    # there was the rule expansion has another rule, to which its threshold means nothing.
    wanted, recorded = settings or {}, reformulated(record)
    if "expansion_alarm" in wanted:
        recorded.setdefault("expansion_alarm", wanted["expansion_alarm"])
    differing = [key for key in wanted if recorded.get(key) != wanted[key]]
    if options is not None:
        names = [key for key in {**options, **chosen} if options.get(key) != chosen.get(key)]
        differing += [argument(key.removesuffix("_sha256").replace("-", "_")) for key in names]
    if identity is not None and not all(known.get(k) == v for k, v in identity.items()):
        differing.append("input")
    return list(dict.fromkeys(differing))


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_number(value: Any) -> bool:
    """Whether a value is a number that fits into a float; it may be infinite."""
    is_real = isinstance(value, int | float) and not isinstance(value, bool)
    return is_real and not _MAX_NUMBER < abs(value) < math.inf


def _is_rate(value: Any) -> bool:
    return _is_number(value) and 0.0 < value < math.inf


def _whole(low: int, high: int = 2**63 - 1) -> Callable[[Any], bool]:
    """A check for whole numbers within bounds."""
    return lambda value: type(value) is int and low <= value <= high


_MAX_NUMBER, _MAX_SIDE = 1e30, 65_536
_is_count, _is_whole, _is_side = _whole(0), _whole(1 - 2**63), _whole(1, _MAX_SIDE)
# Of a mapping, whatever its keys are; of a list.
_EACH = "*"
_Kind = Callable[[Any], bool] | dict[str, Any] | list[Any]
# The kind of value that each key takes: a check, a mapping of keys, or a list. Others are not read,
# or are parameters, which the model's class checks.
_KINDS: dict[str, _Kind] = {
    **dict.fromkeys(("model", "preset", "engine", "label", "scene", "codec", "sheet"), _is_text),
    "manner": _is_text,
    **dict.fromkeys(("schema", "set", "seed"), _is_whole),
    **dict.fromkeys(("width", "height"), _is_side),
    **dict.fromkeys(("width_px", "model_fps"), _is_rate),
    "target": lambda value: value is None or _is_text(value),
    "cells": _is_count,
    "collision_frame": lambda value: value is None or _is_count(value),
    "complete": lambda value: isinstance(value, bool),
    "wall_s": _is_number,
    "input": {
        **dict.fromkeys(("path", "decoder", "deinterlaced", "sha256", "repeated_rows"), _is_text),
        "content_sha256": _is_text,
        **dict.fromkeys(("width", "height"), _is_side),
        **dict.fromkeys(("frames", "bytes", "repeats", "dropped", "left_out"), _is_count),
        "mtime_ns": _is_whole,
        "fps": _is_rate,
        **dict.fromkeys(("duration_s", "contact_s"), _is_number),
    },
    "processed": {
        **dict.fromkeys(("width", "height"), _is_side),
        **dict.fromkeys(("frames", "cells"), _is_count),
    },
    "options": {_EACH: lambda value: isinstance(value, str | bool) or _is_number(value)},
    "versions": {_EACH: _is_text},
    "summary": {
        _EACH: lambda value: value is None or _is_number(value),
        "rule": _is_text,
        "first_alarm_side": lambda value: value is None or _is_text(value),
    },
    "sweep": {},
    "settings": {},
    "columns": [_is_text],
    "warnings": [_is_text],
}
_KINDS["models"] = [_KINDS]


def _of_kinds(document: dict[Any, Any], kinds: Mapping[str, _Kind]) -> dict[str, Any]:
    """A mapping without those parts that are not of their kind."""
    kept: dict[str, Any] = {}
    for key, value in document.items():
        kind = kinds.get(key, kinds.get(_EACH))
        if not isinstance(key, str):
            continue
        if isinstance(kind, list):
            parts = {str(i): v for i, v in enumerate(value if isinstance(value, list) else ())}
            kept[key] = [*_of_kinds(parts, {_EACH: kind[0]}).values()]
        elif isinstance(kind, dict):
            if isinstance(value, dict):
                kept[key] = _of_kinds(value, kind)
        elif kind is None or kind(value):
            kept[key] = value
    return kept


@cache
def provenance() -> dict[str, str]:
    """`dlgmd`, `commit` in a checkout, `ffmpeg`, `cpu` and `os`, as far as known."""
    texts = {
        "dlgmd": __version__,
        "commit": _commit(Path(__file__).resolve().parents[2] / ".git"),
        "ffmpeg": ffmpeg_of("pyav") or ffmpeg_of("opencv"),
        "cpu": _cpu(),
        "os": platform.platform(),
    }
    return {name: text for name, text in texts.items() if text}


def _commit(git: Path) -> str:
    """The commit that a checkout is at, read without Git; empty outside a checkout."""
    try:
        if git.is_file():  # a worktree
            git = (git.parent / git.read_text().removeprefix("gitdir:").strip()).resolve()
        head = (git / "HEAD").read_text().strip()
        if not head.startswith("ref: "):
            return head
        name = head.removeprefix("ref: ")
        shared = git / "commondir"
        common = git / shared.read_text().strip() if shared.is_file() else git
        if (common / name).is_file():
            return (common / name).read_text().strip()
        packed = (common / "packed-refs").read_text().splitlines()
        return next((line.split()[0] for line in packed if line.endswith(f" {name}")), "")
    except (OSError, ValueError):
        return ""


def ffmpeg_of(decoder: str) -> str:
    """The version of the FFmpeg that a decoder brings, or of its codecs; empty without one."""
    if decoder == "pyav":
        try:
            return str(getattr(import_module("av"), "ffmpeg_version_info", ""))
        except ImportError:
            return ""
    if decoder == "opencv":
        import cv2

        match = re.search(r"avcodec:\s+YES \((\S+)\)", cv2.getBuildInformation())
        return f"avcodec {match[1]}" if match else ""
    return ""


def _cpu() -> str:
    """The name of the processor: Linux tells it in a file, other systems in a call."""
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        return platform.processor()
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, "") or platform.processor() or platform.machine()
