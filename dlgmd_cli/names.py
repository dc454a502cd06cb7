"""Short, distinct names for results."""

import os
from collections.abc import Sequence
from pathlib import Path


def numbered(names: Sequence[str]) -> list[str]:
    """The names in their order; repeated ones get (2), (3) … appended."""
    distinct: list[str] = []
    for name in names:
        candidate, number = name, 1
        while candidate in distinct:
            number += 1
            candidate = f"{name} ({number})"
        distinct.append(candidate)
    return distinct


def told_apart(paths: Sequence[Path]) -> list[str]:
    """The last part of each path, or as many parts as it takes to make the names distinct."""
    all_parts = [Path(os.path.abspath(path)).parts for path in paths]
    names = []
    for parts in all_parts:
        others = [other for other in all_parts if other != parts]
        n = 1
        while n < len(parts) and any(other[-n:] == parts[-n:] for other in others):
            n += 1
        names.append("/".join(parts[-n:]))
    return numbered(names)
