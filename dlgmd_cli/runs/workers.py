"""Processes that share out tasks, and neither outlive nor hang the one that started them."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Generic, TypeVar

from dlgmd_cli.errors import WorkerError
from dlgmd_cli.runs.ahead import opencv_threads

TaskT = TypeVar("TaskT")
AnswerT = TypeVar("AnswerT")
Work = Callable[[TaskT], AnswerT]


def n_processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def here(
    prepare: Callable[[], Work[TaskT, AnswerT]],
) -> Iterator[Callable[[Iterable[TaskT]], Iterator[tuple[TaskT, AnswerT]]]]:
    """One worker, which is this process; for what `Workers` does with several."""
    with opencv_threads(1):
        work = prepare()
        yield lambda tasks: ((task, work(task)) for task in tasks)


class Workers(Generic[TaskT, AnswerT]):
    """Context manager with processes that each work on one task at a time.

    Ctrl-C is left to the process that started them. They end with the context, in the middle of a
    task if need be, and by themselves should that process die. Of OpenCV's threads each has one.

    Parameters
    ----------
    count : int
        How many.
    prepare : callable
        Called once in every process; makes what answers a task. It, tasks and answers can be
        pickled.

    Raises
    ------
    WorkerError
        If one of them dies. What it raises instead is raised here.
    """

    def __init__(self, count: int, prepare: Callable[[], Work[TaskT, AnswerT]]) -> None:
        self._count, self._prepare = count, prepare
        self._processes: dict[Connection[Any, Any], SpawnProcess] = {}

    def __enter__(self) -> Callable[[Iterable[TaskT]], Iterator[tuple[TaskT, AnswerT]]]:
        try:
            with _interrupts_later():
                for _ in range(self._count):
                    self._start()
            for connection in self._processes:
                self._receive(connection)
        except BaseException:
            self._end()
            raise
        return self._answers

    def __exit__(self, *_: object) -> None:
        self._end()

    def _start(self) -> None:
        """Start one process."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, self._prepare), daemon=True)
        process.start()
        theirs.close()  # so that the pipe breaks when the process dies
        self._processes[ours] = process

    def _answers(self, tasks: Iterable[TaskT]) -> Iterator[tuple[TaskT, AnswerT]]:
        """Every task with its answer, as they are done; tasks are taken as they are needed."""
        waiting = iter(tasks)
        busy: dict[Any, TaskT] = {}
        free: list[Any] = list(self._processes)
        while True:
            for connection, task in zip(free, waiting, strict=False):
                self._send(connection, task)
                busy[connection] = task
            if not busy:
                return
            free = list(wait(busy))
            for connection in free:
                yield busy.pop(connection), self._receive(connection)

    def _send(self, connection: "Connection[Any, Any]", task: TaskT) -> None:
        try:
            connection.send(task)
        except OSError:
            raise self._death_of(connection) from None

    def _receive(self, connection: "Connection[Any, Any]") -> Any:
        """What a process sends; raises what was raised there."""
        try:
            answer, error = connection.recv()
        except (EOFError, OSError):
            raise self._death_of(connection) from None
        if error is not None:
            raise error
        return answer

    def _death_of(self, connection: "Connection[Any, Any]") -> WorkerError:
        """The error for a process that has died."""
        process = self._processes[connection]
        process.join(1.0)
        code = process.exitcode or 0
        how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
        return WorkerError(
            "a worker process",
            f"it {how}, as happens when memory runs out",
            "Use fewer with --jobs, or process smaller frames.",
        )

    def _end(self) -> None:
        for connection, process in self._processes.items():
            process.terminate()
            connection.close()
        for process in self._processes.values():
            process.join()
        self._processes.clear()


@contextmanager
def _interrupts_later() -> Iterator[None]:
    """Put Ctrl-C off until the end; a process that is started meanwhile never sees it."""
    if threading.current_thread() is not threading.main_thread():  # which alone is interrupted
        yield
        return
    caught: list[Any] = []
    handler = signal.signal(signal.SIGINT, lambda *signalled: caught.append(signalled))
    try:
        with _sigint_masked():
            yield
    finally:
        signal.signal(signal.SIGINT, handler)
    if caught and callable(handler):
        handler(*caught[0])


@contextmanager
def _sigint_masked() -> Iterator[None]:
    """Keep SIGINT from this thread, and for good from processes that it starts meanwhile."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker  # where there are no masks it cannot be had

    resource_tracker.ensure_running()  # as it starts, it would lift the mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(connection: "Connection[Any, Any]", prepare: Callable[[], Work[Any, Any]]) -> None:
    """What a worker does until its pipe breaks, or something is raised."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with opencv_threads(1):
            work = prepare()
            connection.send((None, None))
            while True:
                connection.send((work(connection.recv()), None))
    except (EOFError, ConnectionError):  # nobody is there any more
        return
    except Exception as error:
        with suppress(ConnectionError):
            connection.send((None, error))
