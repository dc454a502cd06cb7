"""How much is computed, and the seam that every part of the paper has: jobs, values, figures."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from dlgmd_cli.parameters import FORMULATIONS
from dlgmd_cli.reproduce.clips import Clip, Job, Watcher, watch

# In place of a formulation, where the claim is not about the D-LGMD.
ANY = "any"

# What the jobs computed, by their keys.
Data = Mapping[Any, Any]
# Claim -> formulation -> a value for each seed; NaN where nothing can be said.
Values = dict[str, dict[str, list[float]]]
# File name without its suffix -> what draws the figure, as `plots` do.
Figures = dict[str, Callable[[], Any]]


@dataclass(frozen=True)
class Plan:
    """How much is computed: quickly, with one seed, or in full; and the authors' own frames."""

    quick: bool = False
    reference: Path | None = None

    @property
    def seeds(self) -> tuple[int, ...]:
        """Where the random parts of flights start."""
        return (0,) if self.quick else (0, 1, 2, 3, 4)


@dataclass(frozen=True)
class Exhibit:
    """A figure or a table of the paper: what is computed for it, and what is made of that."""

    id: str
    jobs: Callable[[Plan], list[Job]]
    values: Callable[[Plan, Data], Values]
    figures: Callable[[Plan, Data], Figures]


def watching(clip: Clip, watchers: Mapping[str, Watcher]) -> list[Job]:
    """The job of rendering a clip for models."""
    return [Job(clip, clip.scene, partial(watch, clip, watchers))]


def by_formulation(value: Callable[[str], list[float]]) -> dict[str, list[float]]:
    """The values of each formulation."""
    return {formulation: value(formulation) for formulation in FORMULATIONS}


def joined(jobs: list[Job]) -> list[Job]:
    """Each job once; models that watch the same clip do so together."""
    found: dict[Any, Job] = {}
    for job in jobs:
        before = found.get(job.key)
        if before is None or not isinstance(job.key, Clip):
            found[job.key] = job
            continue
        watchers = {**before.call.args[1], **job.call.args[1]}  # type: ignore[attr-defined]
        found[job.key] = watching(job.key, watchers)[0]
    return list(found.values())
