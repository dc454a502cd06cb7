"""A batch as it is seen while it goes on: videos done and failed, frames a second, time left."""

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from dlgmd_cli.commands._console import is_lively, say, settings
from dlgmd_cli.errors import printable

if TYPE_CHECKING:
    from dlgmd_cli.batch.events import Event
    from dlgmd_cli.batch.task import Outcome, Task

# Frames a second are those of the last so many seconds.
_SPAN_S = 10.0
_MAX_SHOWN = 8
# Of the bytes; before that, the time left is anybody's guess.
_LEAST_SHARE = 0.02


class Tally:
    """How far a batch is.

    Parameters
    ----------
    tasks : sequence of Task
        What is left to do.
    """

    def __init__(self, tasks: "Sequence[Task]") -> None:
        self._bytes = {one.video.name: one.video.identity.get("bytes") or 0 for one in tasks}
        self.n_total, self.n_done, self.n_failed = len(tasks), 0, 0
        self._began_s = time.monotonic()
        self._bytes_done = 0.0
        self._frames: dict[str, int] = {}
        self._recent: deque[tuple[float, int]] = deque()
        self.running: dict[str, float] = {}

    def take(self, event: "Event") -> None:
        """Take an event down."""
        from dlgmd_cli.batch.events import Advanced, Began, Ended

        if isinstance(event, Began):
            self.running[event.task.video.name] = 0.0
        elif isinstance(event, Advanced):
            name = event.task.video.name
            share = event.n_frames / event.n_expected if event.n_expected else 0.0
            self.running[name] = min(1.0, share)
            self._count(name, event.n_frames)
        elif isinstance(event, Ended):
            self._end(event.task.video.name, event.outcome)

    def _end(self, name: str, outcome: "Outcome") -> None:
        is_done = not failures(outcome)
        self.n_done += is_done
        self.n_failed += not is_done
        self.running.pop(name, None)
        self._bytes_done += self._bytes[name]
        for ending in outcome.values():
            self._count(name, ending.record.get("input", {}).get("frames", 0))
        self._frames.pop(name, None)

    def _count(self, name: str, n_frames: int) -> None:
        """Remember that so many frames of a video are done by now."""
        new = n_frames - self._frames.get(name, 0)
        if new > 0:
            self._frames[name] = n_frames
            self._recent.append((time.monotonic(), new))

    def frames_per_s(self) -> float:
        """Frames a second, lately."""
        now = time.monotonic()
        while self._recent and self._recent[0][0] < now - _SPAN_S:
            self._recent.popleft()
        span_s = min(_SPAN_S, now - self._began_s)
        return sum(count for _, count in self._recent) / span_s if span_s > 0.0 else 0.0

    def seconds_left(self) -> float | None:
        """By the bytes of what is left; None as long as nothing is known."""
        partly = sum(share * self._bytes[name] for name, share in self.running.items())
        done, total = self._bytes_done + partly, sum(self._bytes.values())
        if done <= _LEAST_SHARE * total:
            return None
        return (time.monotonic() - self._began_s) * max(0.0, total - done) / done


@contextmanager
def batch_view(
    tasks: "Sequence[Task]", labels: Sequence[str]
) -> "Iterator[Callable[[Event], None]]":
    """Show how far it is, and a line for every video that fails; yields what takes the events."""
    if settings().quiet or not is_lively() or not tasks:
        yield Speaker(labels, say).hear
        return
    tally = Tally(tasks)
    with _live(tally) as (refresh, tell):
        speaker = Speaker(labels, tell)

        def show(event: "Event") -> None:
            tally.take(event)
            speaker.hear(event)
            refresh()

        yield show


class Speaker:
    """Says what should not be missed, a line each.

    Parameters
    ----------
    labels : sequence of str
        What the models are called.
    tell : callable
        Takes the lines.
    """

    def __init__(self, labels: Sequence[str], tell: Callable[[str], None]) -> None:
        self._labels, self._tell = labels, tell
        self._said: set[str] = set()

    def hear(self, event: "Event") -> None:
        """Say why a video failed, what is doubtful of one that is done, or what is waited for."""
        from dlgmd_cli.batch.events import Ended, Waiting

        if isinstance(event, Ended):
            lines = [*failures(event.outcome, self._labels), *_doubts(event.outcome)]
            for line in lines:
                self._tell(f"Warning: {event.task.video.name}: {line.rstrip('.')}.")
        elif isinstance(event, Waiting) and event.why and event.why not in self._said:
            self._said.add(event.why)
            self._tell(event.why)


def failures(outcome: "Outcome", labels: Sequence[str] = ()) -> list[str]:
    """Why a video is not done, a line a reason; with the models' labels where they differ."""
    reasons: dict[str, list[str]] = {}
    for number, ending in outcome.items():
        if ending.status != "done":
            label = labels[number] if len(labels) > 1 else ""
            reasons.setdefault(f"{ending.status}: {ending.error}", []).append(label)
    is_common = len(reasons) == 1 and len(outcome) == sum(len(kin) for kin in reasons.values())
    return [
        reason if is_common or not any(kin) else f"{', '.join(kin)}: {reason}"
        for reason, kin in reasons.items()
    ]


def _doubts(outcome: "Outcome") -> list[str]:
    """What is doubtful of a video, each line once."""
    lines = (line for ending in outcome.values() for line in ending.record.get("warnings", []))
    return list(dict.fromkeys(lines))


@contextmanager
def _live(tally: Tally) -> Iterator[tuple[Callable[[], None], Callable[[str], None]]]:
    """A bar and the videos being worked on, on stderr; what draws it anew, and what adds a line."""
    from rich.console import Console, Group
    from rich.live import Live
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    def picture() -> Group:
        ended, left_s = tally.n_done + tally.n_failed, tally.seconds_left()
        line = Table.grid(padding=(0, 2))
        line.add_row(
            "batch",
            ProgressBar(tally.n_total, ended, width=30),
            f"{ended}/{tally.n_total} videos",
            Text(f"{tally.n_failed} failed", style="red" if tally.n_failed else ""),
            f"{tally.frames_per_s():.0f} frame/s",
            "" if left_s is None else f"{_clock(left_s)} left",
        )
        shown = list(tally.running.items())[:_MAX_SHOWN]
        lines = [
            Text(f"  {share:4.0%}  {printable(name)}", overflow="ellipsis", no_wrap=True)
            for name, share in shown
        ]
        if len(tally.running) > len(shown):
            lines.append(Text(f"  … and {len(tally.running) - len(shown)} more"))
        return Group(line, *lines)

    console = Console(stderr=True)
    with Live(picture(), console=console, transient=True, refresh_per_second=4) as live:
        yield (
            lambda: live.update(picture()),
            lambda text: console.print(Text(printable(text)), soft_wrap=True),
        )


def _clock(seconds: float) -> str:
    """`83` -> `1:23`, `3725` -> `1:02:05`."""
    minutes, second = divmod(round(seconds), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02}:{second:02}" if hours else f"{minute}:{second:02}"
