"""The plan of a report, and the interface of an exhibit: its jobs, values and figures."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from dlgmd_cli.lab.reproduce.clips import Clip, Job, ModelSpec, run_clip
from dlgmd_cli.parameters import FORMULATIONS

# Replaces the formulation of claims that are not about the D-LGMD.
ANY = "any"

# Results of the jobs, by their keys.
Data = Mapping[Any, Any]
# Claim -> formulation -> one value per seed; NaN where it is undefined.
Values = dict[str, dict[str, list[float]]]
# File name without suffix -> the function that draws the figure.
Figures = dict[str, Callable[[], Any]]


@dataclass(frozen=True)
class Plan:
    """The extent of a report (`quick`: one seed per flight), and the folder of reference frames."""

    quick: bool = False
    reference: Path | None = None

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds of the flights."""
        return (0,) if self.quick else (0, 1, 2, 3, 4)


@dataclass(frozen=True)
class Exhibit:
    """A figure or table of the paper: the jobs it needs, and how its values and figures follow."""

    id: str
    jobs: Callable[[Plan], list[Job]]
    values: Callable[[Plan, Data], Values]
    figures: Callable[[Plan, Data], Figures]


def clip_jobs(models: Mapping[str, ModelSpec], *clips: Clip) -> list[Job]:
    """One job per clip, which renders it and runs the models over it."""
    return [Job(clip, clip.scene, partial(run_clip, clip, models)) for clip in clips]


def by_formulation(value: Callable[[str], list[float]]) -> dict[str, list[float]]:
    """The values for each formulation."""
    return {formulation: value(formulation) for formulation in FORMULATIONS}


def merged(jobs: list[Job]) -> list[Job]:
    """Each job once; jobs with the same clip become one, with the models of all."""
    found: dict[Any, Job] = {}
    for job in jobs:
        before = found.get(job.key)
        if before is None or not isinstance(job.key, Clip):
            found[job.key] = job
            continue
        models = {**before.call.args[1], **job.call.args[1]}  # type: ignore[attr-defined]
        (found[job.key],) = clip_jobs(models, job.key)
    return list(found.values())
