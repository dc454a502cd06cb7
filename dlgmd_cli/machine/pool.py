"""The process pool of batches, sweeps and many flights: a crash costs one task only."""

import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent import futures
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, islice
from multiprocessing import connection, resource_tracker
from types import TracebackType
from typing import Any, Generic, TypeVar

from pebble import ProcessExpired, ProcessPool

from dlgmd_cli.errors import (
    DlgmdError,
    DlgmdWarning,
    WorkerError,
    argument,
    argument_names,
    name_arguments,
    warn,
)
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.threads import environment, limit_threads, n_processors

TaskT = TypeVar("TaskT")
ValueT = TypeVar("ValueT")

DONE, FAILED, CRASHED, KILLED, TIMEOUT = "done", "failed", "crashed", "killed", "timeout"

# Interval between checks of the stop flag.
_TICK_S = 0.1
# How many pools in a row may break before any process begins a task.
_MAX_BROKEN = 3


@dataclass(frozen=True)
class TaskEnd(Generic[ValueT]):
    """How a task ended.

    `status` is `done`; `failed` (the function raised `error`); `crashed` (its process crashed);
    `killed` (its process was killed, as happens when memory runs out); or `timeout`. `value` is
    what the function returned, and `error` says why the task is not done.
    """

    status: str
    value: ValueT | None = None
    error: Exception | None = None

    def result(self) -> ValueT:
        """The value; raises `error` if there is one."""
        if self.error is not None:
            raise self.error
        return self.value  # type: ignore[return-value]


def run_tasks(
    function: Callable[[TaskT], ValueT],
    tasks: Iterable[TaskT],
    jobs: int,
    *,
    timeout_s: float | None = None,
) -> Iterator[tuple[TaskT, TaskEnd[ValueT]]]:
    """Call `function` on every task, in `jobs` processes at a time.

    The processes share this machine's processors, see `limit_threads`. They ignore Ctrl-C, and exit
    when this process does. Their warnings are issued here.

    Parameters
    ----------
    function : callable
        Takes one task. The function, the tasks, and its return values and exceptions must be
        picklable.
    tasks : iterable
        Consumed as needed.
    jobs : int
        Number of processes.
    timeout_s : float, optional
        Time limit of one task.

    Yields
    ------
    (task, TaskEnd)
        In the order in which the tasks end.

    Raises
    ------
    Interrupted
        If the user asks to stop; unfinished tasks are dropped.
    WorkerError
        If no process lives long enough to begin a task.
    """
    # They begin as ``python -c``, which takes Python's own modules from the working folder first: a
    # stranger's socket.py would run. Later on they search where this process does. Before Python
    # 3.11, there is no way to tell them.
    with environment("PYTHONSAFEPATH", "1"):
        yield from _run_tasks(function, tasks, jobs, timeout_s)


def _run_tasks(
    function: Callable[[TaskT], ValueT], tasks: Iterable[TaskT], jobs: int, timeout_s: float | None
) -> Iterator[tuple[TaskT, TaskEnd[ValueT]]]:
    """The loop of `run_tasks`."""
    waiting, n_broken = iter(tasks), 0
    pool = _new_pool(function, jobs)
    running: dict[futures.Future, TaskT] = {}
    try:
        while True:
            # One task more than there are processes keeps them from waiting for this loop.
            chosen = list(islice(waiting, jobs + 1 - len(running)))
            is_broken = False
            with _sigint_blocked():
                while chosen and not is_broken:
                    try:
                        work = (function, chosen[0])
                        scheduled = pool.schedule(worked, args=work, timeout=timeout_s)
                    except RuntimeError:
                        is_broken = True
                    else:
                        running[scheduled] = chosen.pop(0)
            if not running and not chosen:
                break
            ended, _ = futures.wait(running, timeout=_TICK_S, return_when=futures.FIRST_COMPLETED)
            cancel.check()
            for future in ended:
                if isinstance(future.exception(), futures.BrokenExecutor):
                    is_broken = True
                else:
                    n_broken = 0
                    yield running.pop(future), _outcome(future, timeout_s)
            if is_broken or not pool.active:  # a process ended before it began a task
                n_broken += 1
                if n_broken > _MAX_BROKEN:
                    why = "worker processes end before they start working"
                    jobs_name = argument("jobs")
                    hint = (
                        "A Python script needs if __name__ == '__main__' around the call. If "
                        f"memory or threads run short, end other programs or lower {jobs_name}."
                    )
                    raise _in_one_line(WorkerError("", why, hint))
                _end(pool)
                waiting = chain(running.values(), chosen, waiting)
                pool, running = _new_pool(function, jobs), {}
    finally:
        _end(pool)


def _in_one_line(error: WorkerError) -> WorkerError:
    """An error which, where a script does not catch it, is one line instead of a traceback."""
    before = sys.excepthook

    def hook(kind: type[BaseException], raised: BaseException, trace: TracebackType | None) -> None:
        if raised is error:
            print(f"Error: {error}", file=sys.stderr)
        else:
            before(kind, raised, trace)

    if not _is_starting():  # the processes themselves say nothing
        sys.excepthook = hook
    return error


def results_of(
    function: Callable[[TaskT], ValueT], tasks: Iterable[TaskT], jobs: int | None
) -> Iterator[tuple[TaskT, ValueT | DlgmdError]]:
    """Every task with its value, or the DlgmdError that it raised, as they end; see `run_tasks`.

    There are at most as many jobs as tasks, and as many as processors unless given. One job runs in
    this process. Other errors are raised.
    """
    tasks = list(tasks)
    jobs = min(jobs or n_processors(), len(tasks))
    if jobs > 1:
        for task, outcome in run_tasks(function, tasks, jobs):
            yield task, outcome.error if isinstance(outcome.error, DlgmdError) else outcome.result()
        return
    for task in tasks:
        value: ValueT | DlgmdError
        try:
            value = function(task)
        except DlgmdError as error:
            value = error
        yield task, value
        cancel.check()


def _new_pool(function: Callable[[TaskT], ValueT], jobs: int) -> ProcessPool:
    """A pool of `jobs` processes, which start with the first task.

    They get `function` at the start, and so import its modules before they take a task. A process
    that is killed while it takes a task would block the others.
    """
    return ProcessPool(
        max_workers=jobs,
        initializer=_begin,
        initargs=(max(1, n_processors() // jobs), argument_names(), function),
        context=multiprocessing.get_context("spawn"),
    )


def _end(pool: Any) -> None:
    pool.stop()
    pool.join()


def _outcome(future: futures.Future, timeout_s: float | None) -> TaskEnd[ValueT]:
    error = future.exception()
    if error is None:
        return done(*future.result())
    if isinstance(error, ProcessExpired):
        code = error.exitcode
        if code == -getattr(signal, "SIGKILL", 9):
            why = "its process was killed, as happens when memory runs out"
            return TaskEnd(KILLED, error=WorkerError("", why, f"Use fewer {argument('jobs')}."))
        ending = f"signal {-code}" if code < 0 else f"exit code {code}"
        return TaskEnd(CRASHED, error=WorkerError("", f"its process crashed ({ending})"))
    if isinstance(error, TimeoutError | futures.TimeoutError):  # one class from Python 3.11 on
        why = f"not done after {timeout_s:g} s"
        return TaskEnd(TIMEOUT, error=WorkerError("", why, f"Raise {argument('timeout')}."))
    assert isinstance(error, Exception)
    return TaskEnd(FAILED, error=error)


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    """Block Ctrl-C in processes started inside; `_begin` unblocks it once they ignore it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # starting it later would unblock Ctrl-C
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _is_starting() -> bool:
    """Whether this is a process of a pool that has not begun to work."""
    return getattr(multiprocessing.current_process(), "_inheriting", False)


# A process that is starting ends without a traceback until `_begin`: its pool may have ended, and
# its locks be gone; or a script without a main guard led here, as the pool says where that runs.
if _is_starting():
    sys.excepthook = lambda *_: None


def _begin(n_threads: int, names: Mapping[str, str], function: Callable[..., Any]) -> None:
    """Prepare a process of the pool."""
    name_arguments(names)
    sys.excepthook = sys.__excepthook__
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    limit_threads(n_threads)
    threading.Thread(target=_end_with_parent, name="dlgmd-parent", daemon=True).start()


def worked(function: Callable[[TaskT], ValueT], task: TaskT) -> tuple[ValueT, list[str]]:
    """Run a task in a worker; returns its value, and the texts of the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DlgmdWarning)
        value = function(task)
    return value, [str(one.message) for one in caught if one.category is DlgmdWarning]


def done(value: ValueT, warned: Iterable[str]) -> TaskEnd[ValueT]:
    """The end of a task that a worker has done; issues its warnings here."""
    for text in warned:
        warn(text)
    return TaskEnd(DONE, value)


def _end_with_parent() -> None:
    """Exit when the parent process has ended, for whatever reason."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
