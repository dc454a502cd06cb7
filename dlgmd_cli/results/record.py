"""Records such as run.yaml: all that is needed to repeat a run, its summary, and the versions."""

import platform
import re
import subprocess
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
import yaml

from dlgmd_cli import __version__
from dlgmd_cli.errors import ResultError, argument, warn
from dlgmd_cli.machine.files import open_regular
from dlgmd_cli.parameters.facts import (
    SCHEMA,
    InputFacts,
    Json,
    Record,
    Size,
    Value,
    extended,
    for_json,
    misfits,
    of_another_schema,
    part_of,
)
from dlgmd_cli.parameters.keys import Parameters

if TYPE_CHECKING:
    from upath import UPath

_AGAIN = "Run again."
_HEADER = "# Written by dlgmd.\n"
# The entries of an input that identify it, see `InputFacts`.
_IDENTIFYING = {"path", "bytes", "mtime_ns", "pictures", "sha256", "version"}


def versions(decoder: str) -> dict[str, str]:
    """Versions of all packages that affect the numbers."""
    import cv2

    numbers = {
        "dlgmd": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }
    if decoder == "pyav":
        numbers["av"] = import_module("av").__version__
    return numbers


class _Dumper(yaml.SafeDumper):
    """Writes repeated objects in full, since readers of records accept no YAML references."""

    def ignore_aliases(self, data: Json) -> bool:
        """Never write a reference."""
        return True


def yaml_text(
    document: Mapping[str, object], header: str = _HEADER, *, flow: bool | None = False
) -> str:
    """A document as YAML, keys in their order; pure ASCII if it contains control characters.

    If `flow` is None, lists and mappings that contain only single values are written on one line.
    """

    def dumped(*, allow_unicode: bool) -> str:
        return yaml.dump(
            dict(document),
            Dumper=_Dumper,
            sort_keys=False,
            width=100,
            default_flow_style=flow,
            allow_unicode=allow_unicode,
        )

    text = dumped(allow_unicode=True)
    is_printable = all(map(str.isprintable, text.split("\n")))
    return header + (text if is_printable else dumped(allow_unicode=False))


def record_text(record: Mapping[str, object], header: str = _HEADER) -> str:
    """A record with the schema number, the versions and the machine, as YAML."""
    ours = ("schema", "versions", "machine")
    known = {key: value for key, value in record.items() if key not in ours}
    source = record.get("input")
    decoder = str(source.get("decoder")) if isinstance(source, Mapping) else ""
    used = {**versions(decoder), "commit": _commit(), "ffmpeg": _ffmpeg(decoder)}
    used = {name: text for name, text in used.items() if text}
    machine = {"cpu": _cpu(), "os": platform.platform()}
    return yaml_text({"schema": SCHEMA, **known, "versions": used, "machine": machine}, header)


def read_record(path: "Path | UPath") -> Record:
    """The record in a file; empty, with a warning if it is damaged, unless it is readable."""
    try:
        return checked_record(path)
    except ResultError as error:
        warn(f"{error.what}: {error.why}; it is ignored")
        return {}


def checked_record(path: "Path | UPath") -> Record:
    """The record in a file; empty if the file is not a readable record.

    Raises ResultError if an entry is of another type than `Record` says.
    """
    try:
        with open_regular(path, "rb") as file:
            text = file.read()
        try:
            # The C loader is ten times as fast as the Python loader, but only the Python loader
            # reads file names that are not UTF-8.
            document = yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        except yaml.YAMLError:
            document = yaml.load(text, yaml.SafeLoader)
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        return {}
    if not isinstance(document, dict):
        return {}
    if of_another_schema(document) is None:
        for name in misfits(document):
            raise ResultError(str(path), f"does not state a valid {name}", _AGAIN)
    return cast(Record, document)


def model_entry(label: str, record: Record, params: Parameters) -> Record:
    """What a record of several models says of one: its label, size of frames and parameters."""
    facts: Record = {"label": label, "model": params.model}
    return {**extended(facts, params.to_dict()), **part_of(record["processed"], Size)}


def require(path: Path, record: Record, *names: str) -> None:
    """Raise ResultError unless a record has all `names`; ``input.fps`` is `fps` of `input`."""
    for name in names:
        section, _, key = name.rpartition(".")
        part = record.get(section) if section else record
        if not isinstance(part, Mapping) or part.get(key) is None:
            raise ResultError(str(path), f"does not state a valid {name}", _AGAIN)


def differences(
    record: Record,
    *,
    identity: InputFacts | None = None,
    settings: Record | None = None,
    options: Mapping[str, Value] | None = None,
) -> list[str]:
    """Names of everything in which a record differs from what is asked; empty for the same job.

    Parameters
    ----------
    record : Record
        As `read_record` returns it.
    identity : InputFacts, optional
        What identifies the input, such as its path and size; named `input` if anything differs.
    settings : Record, optional
        Keys of the record and the values that they should have; the schema is one of them.
    options : mapping, optional
        All options; one that only the record has is a difference, too. They are named as users
        write them. A file's hash belongs to the option that names the file.
    """
    known, chosen = record.get("input") or {}, record.get("options") or {}
    wanted, recorded = for_json(settings or {}), for_json(record)
    if settings is not None:
        wanted = {"schema": SCHEMA, **wanted}
    differing = [key for key in wanted if recorded.get(key) != wanted[key]]
    if options is not None:
        names = [key for key in {**options, **chosen} if options.get(key) != chosen.get(key)]
        differing += [argument(key.removesuffix("_sha256").replace("-", "_")) for key in names]
    identifying = _IDENTIFYING.intersection(identity or ())
    if identity is not None and any(known.get(k) != identity.get(k) for k in identifying):
        differing.append("input")
    return list(dict.fromkeys(differing))


@cache
def _commit() -> str:
    """The current commit of a checkout; empty outside a checkout, and without Git."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return ""
    command = ["git", "-C", str(root), "rev-parse", "HEAD"]
    try:
        return subprocess.run(command, check=False, capture_output=True, text=True).stdout.strip()
    except OSError:
        return ""


def _ffmpeg(decoder: str) -> str:
    """The version of a decoder's FFmpeg, or of its codecs; empty if unknown."""
    if decoder == "pyav":
        return str(getattr(import_module("av"), "ffmpeg_version_info", ""))
    if decoder == "opencv":
        import cv2

        match = re.search(r"avcodec:\s+YES \((\S+)\)", cv2.getBuildInformation())
        return f"avcodec {match[1]}" if match else ""
    return ""


@cache
def _cpu() -> str:
    """The name of the processor: from a file on Linux, from `platform` on other systems."""
    lines: list[str] = []
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, "") or platform.processor() or platform.machine()
