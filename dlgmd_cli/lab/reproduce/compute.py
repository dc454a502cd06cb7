"""Run the jobs of a report in several processes."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from dlgmd_cli import cancel
from dlgmd_cli.errors import WorkerError
from dlgmd_cli.lab.reproduce import flights, stimuli
from dlgmd_cli.lab.reproduce.claims import ExhibitSpec
from dlgmd_cli.lab.reproduce.clips import Job
from dlgmd_cli.lab.reproduce.plan import Data, Plan, merged
from dlgmd_cli.pool import run_tasks

EXHIBITS = {one.id: one for one in (*stimuli.EXHIBITS, *flights.EXHIBITS)}


def jobs_for(specs: Mapping[str, ExhibitSpec], plan: Plan) -> list[Job]:
    """The jobs that some exhibits need, each once; timed jobs come last."""
    needed = merged([job for name in specs for job in EXHIBITS[name].jobs(plan)])
    return sorted(needed, key=lambda job: job.is_timed)


def compute(jobs: Sequence[Job], n_processes: int, on_job: Callable[[int, str], None]) -> Data:
    """Run all jobs; timed jobs run one by one in this process.

    `on_job` is called with the number of jobs done and the name of the last. Raises Interrupted if
    the user asks to stop, and passes on the exceptions of a job.
    """
    data: dict[Any, Any] = {}
    shared = [job for job in jobs if not job.is_timed]
    if n_processes > 1 and len(shared) > 1:
        for job, outcome in run_tasks(run_job, shared, min(n_processes, len(shared))):
            if isinstance(outcome.error, WorkerError):
                raise WorkerError(job.name, outcome.error.why, outcome.error.mend)
            data[job.key] = outcome.result()
            on_job(len(data), job.name)
    for job in jobs:
        if job.key not in data:
            cancel.check()
            data[job.key] = job.call()
            on_job(len(data), job.name)
    cancel.check()
    return data


def run_job(job: Job) -> Any:
    """Run a job; a function of the module, so that workers can import it."""
    return job.call()
