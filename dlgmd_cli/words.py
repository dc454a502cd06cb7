"""Numbers in sentences: their plural, and enough of their digits."""

from collections.abc import Mapping
from typing import Any


def counted(n: int, noun: str) -> str:
    """A number with its noun: 0 videos, 1 video, 2 videos."""
    return f"{n} {noun}{'s' * (n != 1)}"


def frames_text(record: Mapping[str, Any]) -> str:
    """How many frames of an input were processed: 60, or 60 of 120."""
    n, n_read = record["processed"]["frames"], record["input"]["frames"]
    return f"{n}" if n == n_read else f"{n} of {n_read}"


def threshold_text(value: float, digits: int = 4) -> str:
    """A number in a few digits, but in nine where these would round it up to 1."""
    text = f"{value:.{digits}g}"
    return text if value >= 1.0 or float(text) < 1.0 else f"{value:.9g}"
