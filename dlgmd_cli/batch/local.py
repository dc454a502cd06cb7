"""Worker processes on this machine, one for each of so many videos at a time."""

from collections import deque
from collections.abc import Iterable, Iterator
from queue import SimpleQueue

from dlgmd_cli.batch.attend import Attendant, hear_next, tidy
from dlgmd_cli.batch.events import TICK_S, Event, Waiting
from dlgmd_cli.batch.task import Order, Task
from dlgmd_cli.errors import WorkerError
from dlgmd_cli.runs.worker import Message, Worker


class LocalPool:
    """Processes that share the videos out; see `Pool`. One that dies is replaced.

    Parameters
    ----------
    order : Order
        How each video is computed.
    jobs : int
        How many at a time.
    timeout_s : float, optional
        How long one may take.
    """

    def __init__(self, order: Order, jobs: int, timeout_s: float | None = None) -> None:
        self._order, self._jobs, self._timeout_s = order, jobs, timeout_s
        self._inbox: SimpleQueue[Message] = SimpleQueue()
        self._attendants: dict[Worker, Attendant] = {}

    def __enter__(self) -> "LocalPool":
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._attendants:
            worker.ask_to_end()
        for worker in self._attendants:
            worker.end()
        self._attendants.clear()
        tidy(self._order)

    def work_on(self, tasks: Iterable[Task]) -> Iterator[Event]:
        """See `Pool`."""
        waiting = deque(tasks)
        while True:
            self._share_out(waiting)
            if not any(attendant.task for attendant in self._attendants.values()):
                return
            message = hear_next(self._inbox, TICK_S)
            attendant = self._attendants.get(message.worker) if message else None
            event = attendant.hear(message) if message and attendant else None
            yield event or Waiting()
            for attendant in list(self._attendants.values()):
                late = attendant.overdue()
                if late:
                    yield late
                if not attendant.is_alive:
                    del self._attendants[attendant.worker]
                    tidy(self._order)

    def _share_out(self, waiting: "deque[Task]") -> None:
        """Give everyone something to do, as far as there is anything."""
        free = [one for one in self._attendants.values() if one.task is None]
        while waiting and (free or len(self._attendants) < self._jobs):
            if not free and not self._hire(free):
                return
            free.pop().give(waiting.popleft())

    def _hire(self, free: list[Attendant]) -> bool:
        """One process more, or from now on as few as there are; raises WorkerError if none."""
        try:
            new = Attendant(self._order, self._inbox, self._timeout_s)
        except WorkerError:
            if not self._attendants:
                raise
            self._jobs = len(self._attendants)
            return False
        self._attendants[new.worker] = new
        free.append(new)
        return True
