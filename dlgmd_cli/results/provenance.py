"""What made a result: the version of this package, FFmpeg, the processor and the system."""

import platform
import re
from functools import cache
from importlib import import_module
from pathlib import Path

from dlgmd_cli import __version__

_PACKAGE = Path(__file__).resolve().parents[1]


@cache
def provenance() -> dict[str, str]:
    """`dlgmd`, `commit` in a checkout, `ffmpeg`, `cpu` and `os`, as far as known."""
    texts = {
        "dlgmd": __version__,
        "commit": _commit(_PACKAGE.parent / ".git"),
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
