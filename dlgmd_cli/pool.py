"""The pool of processes that batches, sweeps and `synth --count` share; a crash costs one task."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent import futures
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import chain, islice
from multiprocessing import connection, resource_tracker
from typing import Any, TypeVar

from pebble import ProcessExpired, ProcessPool

from dlgmd_cli import cancel
from dlgmd_cli.errors import WorkerError
from dlgmd_cli.threads import limit_threads, n_processors

TaskT = TypeVar("TaskT")

DONE, FAILED, CRASHED, KILLED, TIMEOUT = "done", "failed", "crashed", "killed", "timeout"

# How long processes may take to end by themselves.
_PATIENCE_S = 5.0
# How often the stop flag is looked at.
_TICK_S = 0.1
# So many pools in a row may end before one of their processes begins a task.
_MAX_BROKEN = 3


@dataclass(frozen=True)
class Outcome:
    """How a task ended.

    Attributes
    ----------
    status : str
        `done`; `failed` (the function raised `error`); `crashed` (it took its process with it);
        `killed` (something else ended the process, as happens when memory runs out); `timeout`.
    value : object
        What the function returned.
    error : Exception or None
        Why it is not done.
    """

    status: str
    value: Any = None
    error: Exception | None = None

    def result(self) -> Any:
        """The value; raises `error` if there is one."""
        if self.error is not None:
            raise self.error
        return self.value


def run_tasks(
    function: Callable[[TaskT], Any],
    tasks: Iterable[TaskT],
    jobs: int,
    *,
    timeout_s: float | None = None,
) -> Iterator[tuple[TaskT, Outcome]]:
    """Call `function` on every task, `jobs` at a time, each in a process.

    The processes share this machine's processors, see `limit_threads`. They ignore Ctrl-C, and end
    when this process does.

    Parameters
    ----------
    function : callable
        Takes one task. It, the tasks and what it returns or raises can be pickled.
    tasks : iterable
        Taken as they are needed.
    jobs : int
        Processes at a time.
    timeout_s : float, optional
        How long one task may take.

    Yields
    ------
    (task, Outcome)
        As the tasks end.

    Raises
    ------
    Interrupted
        If the user asks to stop; tasks that are being worked on are dropped.
    WorkerError
        If no process lives long enough to begin a task.
    """
    waiting, n_broken = iter(tasks), 0
    pool: Any = _new_pool(function, jobs)
    running: dict[Any, TaskT] = {}
    try:
        while True:
            # One more than there are processes, so that none waits for this loop.
            chosen = list(islice(waiting, jobs + 1 - len(running)))
            is_broken = False
            with _sigint_blocked():
                while chosen and not is_broken:
                    try:
                        future = pool.schedule(function, args=chosen[:1], timeout=timeout_s)
                    except RuntimeError:
                        is_broken = True
                    else:
                        running[future] = chosen.pop(0)
            if not running and not chosen:
                # Not at once: a process that is only starting would complain of what is gone.
                pool.close()
                with suppress(TimeoutError, futures.TimeoutError):
                    pool.join(timeout=_PATIENCE_S)
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
                    raise WorkerError("", "worker processes end before they start working")
                _end(pool)
                waiting = chain(running.values(), chosen, waiting)
                pool, running = _new_pool(function, jobs), {}
    finally:
        _end(pool)


def _new_pool(function: Callable[..., Any], jobs: int) -> Any:
    """So many processes, which start with the first task.

    They get `function` as they start, so that they import what it needs before they take a task:
    who is killed while it takes one would keep the others from theirs.
    """
    return ProcessPool(
        max_workers=jobs,
        initializer=_begin,
        initargs=(max(1, n_processors() // jobs), function),
        context=multiprocessing.get_context("spawn"),
    )


def _end(pool: Any) -> None:
    """End the processes of a pool, whatever they do."""
    pool.stop()
    pool.join()


def _outcome(future: Any, timeout_s: float | None) -> Outcome:
    """How the task of an ended future ended."""
    error = future.exception()
    if error is None:
        return Outcome(DONE, future.result())
    if isinstance(error, ProcessExpired):
        code = error.exitcode
        if code == -getattr(signal, "SIGKILL", 9):
            why = "its process was killed, as happens when memory runs out"
            return Outcome(KILLED, error=WorkerError("", why, "Use fewer --jobs."))
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return Outcome(CRASHED, error=WorkerError("", f"its process crashed ({how})"))
    if isinstance(error, TimeoutError | futures.TimeoutError):  # one class from Python 3.11 on
        why = f"not done after {timeout_s:g} s"
        return Outcome(TIMEOUT, error=WorkerError("", why, "Raise --timeout."))
    return Outcome(FAILED, error=error)


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    """Block Ctrl-C in the processes started meanwhile, until they have learnt to ignore it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # else started with the first process, and unblocks Ctrl-C
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(n_threads: int, function: Callable[..., Any]) -> None:
    """What every process of the pool does first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    limit_threads(n_threads)
    threading.Thread(target=_end_with_parent, name="dlgmd-parent", daemon=True).start()


def _end_with_parent() -> None:
    """End this process when its parent has ended, however that came."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
