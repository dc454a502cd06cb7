"""The process pool of batches and sweeps: a crash costs one task only."""

import multiprocessing
import signal
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent import futures
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import chain, islice
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
from dlgmd_cli.machine.threads import limit_threads, n_processors

TaskT = TypeVar("TaskT")
ValueT = TypeVar("ValueT")

DONE, FAILED, CRASHED, KILLED, TIMEOUT = "done", "failed", "crashed", "killed", "timeout"

# Interval (s) between checks of the stop flag.
_TICK_S = 0.1
# So many pools in a row may break before any task ends.
_MOST_POOLS = 3


@dataclass(frozen=True)
class TaskEnd(Generic[ValueT]):
    """How a task ended.

    `status` is `done`; `failed` (the function raised `error`); `crashed` (the process crashed);
    `killed` (the process was killed, as happens when memory runs out); or `timeout`. `value` is
    the return value of the function; `error` says why the task is not done.
    """

    status: str
    value: ValueT | None = None
    error: Exception | None = None

    def result(self) -> ValueT:
        """`value`; raises `error` if there is one."""
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

    The processes share this machine's processors, see `limit_threads`, and ignore Ctrl-C. This
    process issues their warnings again.

    Parameters
    ----------
    function : callable
        Takes one task. The function, the tasks, and its return values and exceptions must be
        picklable.
    tasks : iterable
    jobs : int
        Number of processes.
    timeout_s : float, optional
        Time limit of one task, in seconds.

    Yields
    ------
    (task, TaskEnd)
        In the order in which the tasks end.

    Raises
    ------
    Interrupted
        If the user asks to stop; unfinished tasks are dropped.
    WorkerError
        If no process begins to work, as in a script without ``if __name__ == "__main__":``.
    """
    if _is_starting():
        raise _none_begins()
    pool, n_pools = _pool(jobs), 1
    running: dict[futures.Future, TaskT] = {}
    waiting, again = iter(tasks), list[TaskT]()
    try:
        while True:
            # All at once would fill the pipe, and a stop would break into what is being written.
            for task in islice(waiting, 0 if again else 2 * jobs - len(running)):
                try:
                    begun = pool.schedule(worked, args=(function, task), timeout=timeout_s)
                except RuntimeError:  # the pool broke just now
                    again.append(task)
                    break
                running[begun] = task
            if not running and not again:
                return
            if not running:
                if n_pools == _MOST_POOLS:
                    raise _none_begins()
                pool.stop()  # type: ignore[no-untyped-call]
                pool, n_pools = _pool(jobs), n_pools + 1
                waiting, again = chain(again, waiting), []
                continue
            ended, _ = futures.wait(running, timeout=_TICK_S, return_when=futures.FIRST_COMPLETED)
            cancel.check()
            if not ended and not pool.active:  # given up, with no word of what was scheduled
                again.extend(running.values())
                running.clear()
            for future in ended:
                task = running.pop(future)
                # Pebble gives up the pool if a worker dies before its task is known: not the
                # fault of the other tasks, which a new pool works on.
                if isinstance(future.exception(), BrokenProcessPool):
                    again.append(task)
                else:
                    n_pools = 1
                    yield task, _outcome(future, timeout_s)
    finally:
        pool.stop()  # type: ignore[no-untyped-call]
        pool.join()


def _pool(jobs: int) -> ProcessPool:
    """A pool of `jobs` processes."""
    return ProcessPool(
        max_workers=jobs,
        initializer=_begin,
        initargs=(max(1, n_processors() // jobs), argument_names()),
        context=multiprocessing.get_context("spawn"),
    )


def _is_starting() -> bool:
    """Whether this is a worker that has not begun: it imports the script that started the pool."""
    return getattr(multiprocessing.current_process(), "_inheriting", False)


def _none_begins() -> WorkerError:
    """The error that no worker begins; it is one line if a script does not catch it."""
    if not _is_starting():
        _show_errors_in_one_line()
    script = "" if argument_names() else getattr(sys.modules["__main__"], "__file__", "")
    guard = "Put the call below 'if __name__ == \"__main__\":'. " if script else ""
    hint = f"If memory or threads run short, end other programs or use fewer {argument('jobs')}."
    return WorkerError(script, "the worker processes end before they begin", guard + hint)


def _show_errors_in_one_line(form: str = "Error: {}\n") -> None:
    """Print an uncaught DlgmdError in this form from now on, without a traceback."""
    before = sys.excepthook

    def hook(kind: type[BaseException], error: BaseException, trace: Any) -> None:
        if isinstance(error, DlgmdError):
            sys.stderr.write(form.format(error))
        else:
            before(kind, error, trace)

    sys.excepthook = hook


# A script without its guard calls the task again in each worker. The errors there, such as that of
# a locked folder, are not shown: the pool says why no worker begins.
if _is_starting():
    _show_errors_in_one_line("")


def results_of(
    function: Callable[[TaskT], ValueT], tasks: Iterable[TaskT], jobs: int | None
) -> Iterator[tuple[TaskT, ValueT | DlgmdError]]:
    """Every task with its value or its DlgmdError, in the order in which tasks end.

    `jobs` is the number of processors unless given, and at most the number of tasks. A single job
    runs in this process. Other errors than DlgmdError are raised. See `run_tasks`.
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


def _begin(n_threads: int, names: Mapping[str, str]) -> None:
    """Prepare a process of the pool."""
    name_arguments(names)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_threads(n_threads)


def worked(function: Callable[[TaskT], ValueT], task: TaskT) -> tuple[ValueT, list[str]]:
    """Run a task in a worker; returns the value, and the texts of the task's warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DlgmdWarning)
        value = function(task)
    return value, [str(one.message) for one in caught if one.category is DlgmdWarning]


def done(value: ValueT, warned: Iterable[str]) -> TaskEnd[ValueT]:
    """The end of a task that a worker completed; issues the task's warnings in this process."""
    for text in warned:
        warn(text)
    return TaskEnd(DONE, value)
