"""Records such as run.yaml: all that is needed to repeat a run, its summary, and the versions."""

import platform
import re
from collections.abc import Mapping
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
    Value,
    for_json,
    misfits,
    of_another_schema,
)

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
    source, made_by = record.get("input"), provenance()
    decoder = str(source.get("decoder")) if isinstance(source, Mapping) else ""
    used = versions(decoder)
    used |= {key: made_by[key] for key in ("commit",) if key in made_by}
    if ffmpeg := ffmpeg_of(decoder):
        used["ffmpeg"] = ffmpeg
    machine = {key: made_by[key] for key in ("cpu", "os") if key in made_by}
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
    """The current commit of a checkout, read without Git; empty outside a checkout."""
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
    """The version of a decoder's FFmpeg, or of its codecs; empty if unknown."""
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
    """The name of the processor: from a file on Linux, from `platform` on other systems."""
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        return platform.processor()
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, "") or platform.processor() or platform.machine()
