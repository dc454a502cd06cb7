"""Names of results: short, and told apart."""

import os
from collections.abc import Sequence
from pathlib import Path


def numbered(names: Sequence[str]) -> list[str]:
    """The names, with (2), (3) … after those that stood before."""
    found: list[str] = []
    for name in names:
        candidate, number = name, 1
        while candidate in found:
            number += 1
            candidate = f"{name} ({number})"
        found.append(candidate)
    return found


def told_apart(paths: Sequence[Path]) -> list[str]:
    """The last part of every path; where several end alike, as many as tell them apart."""
    every = [Path(os.path.abspath(path)).parts for path in paths]
    names = []
    for parts in every:
        others = [other for other in every if other != parts]
        n = 1
        while n < len(parts) and any(other[-n:] == parts[-n:] for other in others):
            n += 1
        names.append("/".join(parts[-n:]))
    return numbered(names)
