"""Everything that a report needs, computed by several processes."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from dlgmd_cli import cancel
from dlgmd_cli.errors import WorkerError
from dlgmd_cli.pool import run_tasks
from dlgmd_cli.reproduce import flights, stimuli
from dlgmd_cli.reproduce.claims import Story
from dlgmd_cli.reproduce.clips import Job
from dlgmd_cli.reproduce.plan import Data, Plan, joined

EXHIBITS = {one.id: one for one in (*stimuli.EXHIBITS, *flights.EXHIBITS)}


def jobs_for(stories: Mapping[str, Story], plan: Plan) -> list[Job]:
    """What some exhibits need, each once; what is timed comes last."""
    needed = joined([job for name in stories for job in EXHIBITS[name].jobs(plan)])
    return sorted(needed, key=lambda job: job.alone)


def compute(jobs: Sequence[Job], n_processes: int, on_job: Callable[[int, str], None]) -> Data:
    """Do all jobs, those that are timed one by one in this process.

    `on_job` is called with the number that are done, and the name of one. Raises Interrupted if the
    user asks to stop, and what a job raises.
    """
    data: dict[Any, Any] = {}
    shared = [job for job in jobs if not job.alone]
    if n_processes > 1 and len(shared) > 1:
        for job, outcome in run_tasks(do, shared, min(n_processes, len(shared))):
            if isinstance(outcome.error, WorkerError):
                raise WorkerError(job.name, outcome.error.why, outcome.error.mend)
            data[job.key] = outcome.result()
            on_job(len(data), job.name)
    for job in jobs:
        if job.key not in data:
            cancel.check()
            data[job.key] = do(job)
            on_job(len(data), job.name)
    cancel.check()
    return data


def do(job: Job) -> Any:
    """What a job computes, in any process."""
    return job.call()
