"""Processes that share out tasks, and neither outlive nor hang the one that started them."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from typing import Any, Generic, TypeVar

from dlgmd_cli.errors import WorkerError
from dlgmd_cli.runs.worker import Message, Worker
from dlgmd_cli.video.prefetch import opencv_threads

TaskT = TypeVar("TaskT")
AnswerT = TypeVar("AnswerT")
Work = Callable[[TaskT], AnswerT]


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
        self._inbox: SimpleQueue[Message] = SimpleQueue()
        self._workers: list[Worker] = []

    def __enter__(self) -> Callable[[Iterable[TaskT]], Iterator[tuple[TaskT, AnswerT]]]:
        try:
            for _ in range(self._count):
                self._workers.append(Worker(self._prepare, self._inbox))
            for _ in self._workers:
                self._receive()
        except BaseException:
            self._end()
            raise
        return self._answers

    def __exit__(self, *_: object) -> None:
        self._end()

    def _answers(self, tasks: Iterable[TaskT]) -> Iterator[tuple[TaskT, AnswerT]]:
        """Every task with its answer, as they are done; tasks are taken as they are needed."""
        waiting = iter(tasks)
        busy: dict[Worker, TaskT] = {}
        free = list(self._workers)
        while True:
            for worker, task in zip(free, waiting, strict=False):
                worker.send(task)
                busy[worker] = task
            if not busy:
                return
            worker, answer = self._receive()
            yield busy.pop(worker), answer
            free = [worker]

    def _receive(self) -> tuple[Worker, Any]:
        """Whatever comes next, and from whom; raises what was raised there."""
        worker, kind, value = self._inbox.get()
        if kind == "error":
            raise value
        if kind == "death":
            raise WorkerError(
                "a worker process",
                f"{value}, as happens when memory runs out",
                "Use fewer with --jobs, or process smaller frames.",
            )
        return worker, value

    def _end(self) -> None:
        for worker in self._workers:
            worker.ask_to_end()
        for worker in self._workers:
            worker.end()
        self._workers.clear()
