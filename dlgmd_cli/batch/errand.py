"""What a Dask worker does with a task: has a child process do it, and watches that."""

import os
import platform
import threading
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from dlgmd_cli import __version__
from dlgmd_cli.batch.attend import Attendant, hear_next, tidy
from dlgmd_cli.batch.events import TICK_S, Advanced, Began, Ended, Event
from dlgmd_cli.batch.places import Folder
from dlgmd_cli.batch.remote import is_url
from dlgmd_cli.batch.task import FAILED, Ending, Order, Outcome, Task
from dlgmd_cli.errors import WorkerError
from dlgmd_cli.runs.worker import Message
from dlgmd_cli.threads import n_processors

# A child that has nothing to do for so long ends.
IDLE_S = 5.0


@dataclass(frozen=True)
class Job:
    """What is the same for every task of a batch on a cluster.

    Attributes
    ----------
    name : str
        What tells it from other batches; also the topic under which it reports.
    order : Order
        How each video is computed.
    timeout_s : float or None
        How long one may take.
    signs : tuple of str
        Files or folders that every worker must see, or it does not see where results go.
    version : str
        The release that sends it.
    """

    name: str
    order: Order
    timeout_s: float | None
    signs: tuple[str, ...]
    version: str = __version__


class _Helper:
    """A child process of a Dask worker, for one task after the other."""

    def __init__(self, job: Job, n_threads: int) -> None:
        self._inbox: SimpleQueue[Message] = SimpleQueue()
        order = replace(job.order, threads=n_threads)
        self._attendant = Attendant(order, self._inbox, job.timeout_s)

    def is_alive(self) -> bool:
        """Whether it can take a task."""
        while message := hear_next(self._inbox, 0.0):
            self._attendant.hear(message)
        return self._attendant.is_alive

    def give(self, task: Task) -> None:
        """Begin a task."""
        self._attendant.give(task)

    def next_event(self) -> Event | None:
        """What happens next, or None if nothing does for a moment."""
        message = hear_next(self._inbox, TICK_S)
        event = self._attendant.hear(message) if message else None
        return event or self._attendant.overdue()

    def ask_to_end(self) -> None:
        """Let it end, soon."""
        self._attendant.worker.ask_to_end()

    def end(self) -> None:
        """End it, whatever it does; it cleans up."""
        self._attendant.worker.end()


class _Idle:
    """Children that wait for their next task, by their batch; for a while."""

    def __init__(self) -> None:
        self._helpers: dict[str, list[_Helper]] = defaultdict(list)
        self._lock = threading.Lock()

    def put(self, name: str, helper: _Helper) -> None:
        """Keep one for `IDLE_S`."""
        with self._lock:
            self._helpers[name].append(helper)
        timer = threading.Timer(IDLE_S, self._expire, (name, helper))
        timer.daemon = True
        timer.start()

    def take(self, name: str) -> _Helper | None:
        """One that is alive, if there is any."""
        while True:
            with self._lock:
                kin = self._helpers.get(name)
                helper = kin.pop() if kin else None
            if helper is None or helper.is_alive():
                return helper

    def dismiss(self, name: str) -> None:
        """Let all of a batch end."""
        with self._lock:
            helpers = self._helpers.pop(name, [])
        for helper in helpers:
            helper.ask_to_end()

    def _expire(self, name: str, helper: _Helper) -> None:
        with self._lock:
            if helper not in self._helpers.get(name, ()):
                return
            self._helpers[name].remove(helper)
            if not self._helpers[name]:
                del self._helpers[name]
        helper.end()


_idle = _Idle()


def run_errand(job: Job, task: Task) -> Outcome:
    """Do a task of a batch, on a thread of a Dask worker.

    Raises
    ------
    WorkerError
        If another release of dlgmd is installed here.
    """
    from distributed import Reschedule, get_worker

    if job.version != __version__:
        raise version_error(platform.node(), __version__)
    obstacle = _obstacle(job, task)
    if obstacle:
        return dict.fromkeys(task.wanted, Ending(FAILED, f"on {platform.node()}, {obstacle}"))
    worker = get_worker()
    key = worker.get_current_task()
    n_threads = max(1, n_processors() // worker.state.nthreads)
    helper = _idle.take(job.name) or _Helper(job, n_threads)
    helper.give(task)
    try:
        while True:
            event = helper.next_event()
            if isinstance(event, Ended):
                break
            if isinstance(event, Began | Advanced):
                worker.log_event(job.name, [key, *_progress(event)])
            if not _is_wanted(worker, key):  # cancelled, or the client is gone
                raise Reschedule
    except BaseException:
        helper.end()
        tidy(job.order)
        raise
    if helper.is_alive():
        _idle.put(job.name, helper)
    else:
        tidy(job.order)
    return event.outcome


def dismiss(name: str) -> None:
    """End the children that wait for more tasks of a batch; does not wait for that."""
    _idle.dismiss(name)


def version_error(where: str, version: str | None) -> WorkerError:
    """Another release, or none, is installed somewhere on the cluster."""
    found = f"there is dlgmd {version}, here {__version__}" if version else "dlgmd is not installed"
    return WorkerError(where, found, f"Install dlgmd {__version__} on all of the cluster.")


def _is_wanted(worker: Any, key: str) -> bool:
    """Whether the scheduler still waits for a task."""
    state = worker.state.tasks.get(key)
    return state is not None and state.state in ("executing", "long-running")


def _progress(event: Began | Advanced) -> tuple[int | None, int | None]:
    """How far a task is; of one that has just begun, nothing."""
    return (event.n_frames, event.n_expected) if isinstance(event, Advanced) else (None, None)


def _obstacle(job: Job, task: Task) -> str:
    """What keeps this machine from doing a task that others may be able to do."""
    path = task.video.path
    if not is_url(path) and not os.path.lexists(path):
        return (
            f"there is no {path}. Put the videos where all workers see them, in a shared folder "
            "or behind a URL."
        )
    for sign in job.signs:
        folder = Path(sign).parent
        shared = "Choose an --out that all workers can write, a shared folder or a URL."
        if not os.path.lexists(sign):
            return f"the folder of the results is not to be seen, {folder}. {shared}"
        if not os.access(folder, os.W_OK | os.X_OK):
            return f"the folder of the results cannot be written, {folder}. {shared}"
    return ""


def signs_in(order: Order) -> list[Folder]:
    """The folders of results that workers must see."""
    return [one.place for one in order.variants if isinstance(one.place, Folder)]
