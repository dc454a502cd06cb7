"""What happens while a batch is worked on, wherever that is; and the interface of who does it."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

from dlgmd_cli.batch.task import Outcome, Task


@dataclass(frozen=True)
class Began:
    """Work on a video has begun."""

    task: Task


@dataclass(frozen=True)
class Advanced:
    """So many of a video's frames are done, of so many as it announces, if it does."""

    task: Task
    n_frames: int
    n_expected: int | None


@dataclass(frozen=True)
class Ended:
    """A video has ended, one way or another."""

    task: Task
    outcome: Outcome


@dataclass(frozen=True)
class Waiting:
    """Nothing happened for a moment; `why` says what is waited for, if that is worth saying."""

    why: str = ""


Event = Began | Advanced | Ended | Waiting
# How long nothing may happen before there is a `Waiting`.
TICK_S = 0.5


class Pool(Protocol):
    """Whoever works on the videos: processes here, or a cluster.

    A context manager; leaving it ends what is being worked on, which is then not written.
    """

    def __enter__(self) -> "Pool": ...

    def __exit__(self, *error: object) -> None: ...

    def work_on(self, tasks: Iterable[Task]) -> Iterator[Event]:
        """Do all the tasks; tell what happens, and each task's end exactly once."""
        ...
