"""A worker process under watch: what it tells, and what its death or its silence means."""

import signal
import time
from functools import partial
from queue import Empty, SimpleQueue

from dlgmd_cli.batch.events import Advanced, Began, Ended, Event
from dlgmd_cli.batch.remote import tidy_scratch
from dlgmd_cli.batch.task import CRASHED, KILLED, TIMEOUT, Ending, Order, Task
from dlgmd_cli.batch.work import as_failed, prepare
from dlgmd_cli.runs.worker import Death, Message, Worker

# A process of which nothing is heard for so long hangs.
STALL_S = 300.0


class Attendant:
    """A worker process, and the task that it works on.

    Parameters
    ----------
    order : Order
        What is the same for every task.
    inbox : SimpleQueue of Message
        Where what the process sends arrives.
    timeout_s : float or None
        How long it may take over one video.

    Attributes
    ----------
    task : Task or None
        What it works on.
    is_alive : bool
        Whether it can be given tasks.
    """

    def __init__(
        self, order: Order, inbox: "SimpleQueue[Message]", timeout_s: float | None
    ) -> None:
        self.worker = Worker(partial(prepare, order), inbox)
        self.task: Task | None = None
        self.is_alive = True
        self._timeout_s = timeout_s
        # What a process takes to start is not the video's.
        self._is_ready = self._has_begun = False
        self._given_s = self._heard_s = 0.0

    def give(self, task: Task) -> None:
        """Let it work on a task; it has none now."""
        self.task, self._has_begun = task, False
        self._given_s = self._heard_s = time.monotonic()
        self.worker.send(task)

    def hear(self, message: Message) -> Event | None:
        """What a message of its process means."""
        self._heard_s = time.monotonic()
        if message.kind == "death":
            self.is_alive = False
            return self._end(_ending_of(message.value)) if self.task else None
        if message.kind == "ready":
            self._is_ready, self._given_s = True, self._heard_s
        if self.task is None or message.kind == "ready":
            return None
        if message.kind == "error":  # not even the work could be made ready, and it ends
            self.is_alive = False
            return self._end(as_failed(message.value))
        if message.kind == "answer":
            task, self.task = self.task, None
            return Ended(task, message.value)
        if not self._has_begun:
            self._has_begun = True
            return Began(self.task)
        return Advanced(self.task, *message.value) if message.value else None

    def overdue(self) -> Ended | None:
        """The end of its task if that has taken too long; its process is killed then."""
        why = self._excess()
        if self.task is None or not why:
            return None
        self.worker.kill()
        self.is_alive = False
        return self._end(Ending(TIMEOUT, why))

    def _excess(self) -> str:
        """Why the task has taken too long, if it has."""
        now = time.monotonic()
        given_s = self._given_s if self._is_ready else now
        if self._timeout_s is not None and now - given_s > self._timeout_s:
            return f"it took more than {self._timeout_s:g} s. Give it more with --timeout."
        if now - self._heard_s > STALL_S:
            return f"nothing happened for {STALL_S:g} s. Try it alone with 'dlgmd run'."
        return ""

    def _end(self, ending: Ending) -> Ended:
        """The task's end, the same in every variant."""
        assert self.task is not None
        task, self.task = self.task, None
        if ending.wall_s is None:
            wall_s = round(time.monotonic() - self._given_s, 3)
            ending = Ending(ending.status, ending.error, wall_s=wall_s)
        return Ended(task, dict.fromkeys(task.wanted, ending))


def hear_next(inbox: "SimpleQueue[Message]", timeout_s: float) -> Message | None:
    """The next message, or None if none comes in time."""
    try:
        return inbox.get(timeout=timeout_s)
    except Empty:
        return None


def tidy(order: Order) -> None:
    """Remove what processes that died were writing."""
    tidy_scratch()
    for variant in order.variants:
        variant.place.tidy()


def _ending_of(death: Death) -> Ending:
    """What a process's death means for the video that it worked on."""
    if death.code == -getattr(signal, "SIGKILL", 9):
        return Ending(
            KILLED,
            "its process was killed, as happens when memory runs out. Use fewer --jobs, or "
            "process smaller frames with --scale.",
        )
    words = f" ({death.last_words[:200]})" if death.last_words else ""
    return Ending(CRASHED, f"its process crashed: {death}{words}. Try re-encoding it with ffmpeg.")
