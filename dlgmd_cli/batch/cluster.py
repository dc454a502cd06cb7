"""The workers of a Dask cluster, each of which does its tasks in children of its own."""

import secrets
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from functools import partial
from itertools import chain
from queue import Empty, SimpleQueue
from typing import Any

from dlgmd_cli import __version__
from dlgmd_cli.batch.errand import Job, dismiss, run_errand, signs_in, version_error
from dlgmd_cli.batch.events import TICK_S, Advanced, Began, Ended, Event, Waiting
from dlgmd_cli.batch.scheduler import CONNECT_S, connect
from dlgmd_cli.batch.task import KILLED, Ending, Order, Task
from dlgmd_cli.batch.work import as_failed
from dlgmd_cli.errors import DlgmdError, WorkerError
from dlgmd_cli.results.workshop import Workshop

_CLOSE_S = 5.0
# How many tasks a worker may have for each of its threads, so that none waits for its next one.
PER_THREAD = 2
# What tells the release elsewhere, and can be sent to where there is none.
_VERSION = "__import__('dlgmd_cli').__version__"


class Cluster:
    """The workers of a Dask scheduler; see `Pool`. It is looked for when there is work.

    A task whose worker is lost goes to another one, a few times; and then, since it may have been
    another task of that worker that did it, a few times more while nothing else is worked on. More
    tasks than the workers can hold stay here.

    Parameters
    ----------
    order : Order
        How each video is computed; `threads` is up to the workers.
    scheduler : str
        Its address, or the name of its scheduler file.
    timeout_s : float, optional
        How long one video may take.
    quiet : bool
        Keep Dask's log from stderr; what matters of it is raised.
    """

    def __init__(
        self,
        order: Order,
        scheduler: str,
        timeout_s: float | None = None,
        *,
        quiet: bool = False,
    ) -> None:
        self._order, self._scheduler, self._timeout_s = order, scheduler, timeout_s
        self._quiet = quiet
        self._name = f"dlgmd-{secrets.token_hex(8)}"
        self._inbox: SimpleQueue[tuple[Any, ...]] = SimpleQueue()
        self._sent: dict[str, tuple[Task, Any]] = {}
        self._n_sent = 0
        self._suspects: deque[Task] = deque()
        self._is_alone = False
        self._capacity, self._counted_s = 0, 0.0
        self._known: set[str] = set()
        self._client: Any = None
        self._stack = ExitStack()

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(self, *error: object) -> None:
        if self._client is not None:
            with suppress(Exception):
                if error[0] is None:
                    self._client.run(dismiss, self._name, on_error="ignore")
            # The scheduler forgets the tasks of a client that leaves, and the workers end them.
            with suppress(Exception):
                self._client.close(timeout=_CLOSE_S)
            self._client = None
        self._stack.close()

    def work_on(self, tasks: Iterable[Task]) -> Iterator[Event]:
        """See `Pool`.

        Raises
        ------
        ParameterError
            If the scheduler's address is none.
        MissingExtraError
            If Dask is not installed.
        WorkerError
            If the scheduler does not answer, or no longer, or if dlgmd is missing on the cluster.
        """
        waiting = iter(tasks)
        first = next(waiting, None)
        if first is None:
            return
        self._client = connect(self._scheduler, quiet=self._quiet)
        self._client.subscribe_topic(self._name, lambda event: self._inbox.put(tuple(event[1])))
        job = self._job()
        waiting = chain([first], waiting)
        while True:
            self._count()
            self._send_out(job, waiting)
            if not self._sent and self._suspects:
                self._is_alone = True
                self._send(job, self._suspects.popleft())
            if not self._sent:
                return
            try:
                event = self._take(*self._inbox.get(timeout=TICK_S))
            except Empty:
                event = None
            yield event or Waiting("" if self._known else "Waiting for workers of the cluster.")

    def _job(self) -> Job:
        """What workers need; the signs stay in the results' folders until this is left."""
        signs = []
        for place in signs_in(self._order):
            signs.append(str(self._stack.enter_context(Workshop(place.path)).path))
        return Job(self._name, self._order, self._timeout_s, tuple(signs))

    def _count(self) -> None:
        """See how many tasks the workers can hold, now and then."""
        now = time.monotonic()
        if now - self._counted_s < TICK_S:
            return
        try:
            n_threads = self._client.nthreads()
            if n_threads.keys() - self._known or not self._counted_s:
                self._check_versions()
        except DlgmdError:
            raise
        except Exception:
            raise self._lost() from None
        self._known = set(n_threads)
        # One even without workers: a cluster that grows with its work has to have some.
        self._capacity = max(1, PER_THREAD * sum(n_threads.values()))
        self._counted_s = time.monotonic()

    def _check_versions(self) -> None:
        """Raise WorkerError unless this release is installed everywhere."""
        try:
            found = {"the scheduler": self._client.run_on_scheduler(eval, _VERSION)}
        except ImportError as error:
            found = {"the scheduler": error}
        found.update(self._client.run(eval, _VERSION, on_error="return"))
        for where, version in found.items():
            if isinstance(version, ImportError):
                raise version_error(where, None)
            if isinstance(version, str) and version != __version__:
                raise version_error(where, version)

    def _send_out(self, job: Job, waiting: Iterator[Task]) -> None:
        """Submit as many tasks as the workers can hold."""
        while len(self._sent) < self._capacity:
            task = next(waiting, None)
            if task is None:
                return
            self._send(job, task)

    def _send(self, job: Job, task: Task) -> None:
        """Submit a task."""
        self._n_sent += 1
        key = f"{self._name}-{self._n_sent}"
        try:
            future = self._client.submit(run_errand, job, task, key=key, pure=False)
        except Exception:
            raise self._lost() from None
        self._sent[key] = task, future
        self._watch(key, future)

    def _watch(self, key: str, future: Any) -> None:
        """Have the end of a task put into the inbox."""
        future.add_done_callback(partial(_put, self._inbox, key))

    def _take(self, key: str, *news: int | None) -> Event | None:
        """What came: how far a task is, or without that, that it has ended."""
        task, future = self._sent.get(key, (None, None))
        if task is None or future is None:
            return None
        if news:
            n_frames, n_expected = news
            return Began(task) if n_frames is None else Advanced(task, n_frames, n_expected)
        ended = self._end(task, key, future)
        if ended is not None or task in self._suspects:
            del self._sent[key]
        return ended

    def _end(self, task: Task, key: str, future: Any) -> Ended | None:
        """How a task has ended; None if it has not: it begins anew, or is to be tried alone."""
        from distributed import KilledWorker, TimeoutError

        if future.status == "cancelled":
            raise self._lost()
        try:
            error = future.exception(timeout=CONNECT_S)
            if error is None:
                return Ended(task, future.result(timeout=CONNECT_S))
        except TimeoutError:
            self._watch(key, future)
            return None
        except Exception:
            raise self._lost() from None
        if isinstance(error, DlgmdError):
            raise error
        if isinstance(error, KilledWorker) and not self._is_alone:
            self._suspects.append(task)
            return None
        if isinstance(error, KilledWorker):
            ending = Ending(
                KILLED,
                "every worker that had it was lost, as happens when memory runs out. Give workers "
                "fewer threads, or process smaller frames with --scale.",
            )
        elif isinstance(error, OSError | MemoryError):  # what a worker's machine is short of
            ending = as_failed(error)
        elif isinstance(error, ImportError) and "dlgmd_cli" in str(error):
            raise version_error("a worker of the cluster", None)
        else:
            why = " ".join(str(error).split())[:200]
            raise WorkerError(
                self._scheduler,
                f"the cluster cannot do this work ({type(error).__name__}: {why})",
                "Have the same releases of Python, dlgmd and Dask everywhere.",
            )
        return Ended(task, dict.fromkeys(task.wanted, ending))

    def _lost(self) -> WorkerError:
        return WorkerError(
            self._scheduler,
            "the scheduler was lost, or dropped the work",
            "Start it again, then the same command, which goes on from there.",
        )


def _put(inbox: "SimpleQueue[tuple[Any, ...]]", key: str, future: Any) -> None:
    """Take down the end of a task; called in a thread of Dask's."""
    inbox.put((key,))
