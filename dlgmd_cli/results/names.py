"""Names of results, and numbers as text for sentences."""

import math
import os
from collections.abc import Sequence
from pathlib import Path

from dlgmd_cli.parameters.facts import InputFacts, Record
from dlgmd_cli.video.base import input_name


def recorded_name(known: InputFacts) -> str:
    """Name of the input that a record's `input` describes; the input need not exist any more."""
    path = str(known.get("path", ""))
    return str(known.get("name") or input_name(path, are_pictures="pictures" in known))


def numbered(names: Sequence[str]) -> list[str]:
    """The names in the same order; repeated names get (2), (3) … appended."""
    distinct: list[str] = []
    for name in names:
        candidate, number = name, 1
        while candidate in distinct:
            number += 1
            candidate = f"{name} ({number})"
        distinct.append(candidate)
    return distinct


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """The last part of each path, or as many last parts as make the names distinct."""
    all_parts = [Path(os.path.abspath(path)).parts for path in paths]
    names = []
    for parts in all_parts:
        others = [other for other in all_parts if other != parts]
        n = 1
        while n < len(parts) and any(other[-n:] == parts[-n:] for other in others):
            n += 1
        names.append("/".join(parts[-n:]))
    return numbered(names)


def frames_text(record: Record) -> str:
    """The number of processed frames: 60, or 60 of 120 if some were not processed."""
    n, n_read = record["processed"]["frames"], record["input"]["frames"]
    return f"{n}" if n == n_read else f"{n} of {n_read}"


def part_text(time_s: Sequence[float]) -> str:
    """Which part of an input the frames at these times (s) are: from the first to the last."""
    if not time_s:
        return ", no part of the input"
    return f", only {time_s[0]:.3f} to {time_s[-1]:.3f} s of the input"


def threshold_text(value: float) -> str:
    """A number with four digits, or with nine if four digits would round the number up to 1."""
    text = f"{value:.4g}"
    return text if value >= 1.0 or float(text) < 1.0 else f"{value:.9g}"


def difference_text(value: float, low: float, high: float, p: float) -> str:
    """A difference with its interval and p-value, in tables."""
    if math.isnan(value):
        return "–"
    bounds = "" if math.isnan(low) else f" ({low:+.2f} to {high:+.2f})"
    return f"{value:+.2f}{bounds}, p = {p:.2g}"
