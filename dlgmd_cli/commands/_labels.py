"""Names of results: short, and told apart."""

import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path


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


def numbered(names: Sequence[str]) -> list[str]:
    """The names, with (2), (3) … after those that stood before."""
    distinct: list[str] = []
    times = Counter[str]()
    for name in names:
        candidate = name
        while candidate in distinct:
            times[name] += 1
            candidate = f"{name} ({times[name] + 1})"
        distinct.append(candidate)
    return distinct
