"""Progress bars on stderr. No other module knows about them."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from dlgmd_cli.commands.console import settings
from dlgmd_cli.errors import printable


def is_lively() -> bool:
    """Whether stderr may show bars and colours."""
    # stderr is None if the shell closed it.
    return sys.stderr is not None and sys.stderr.isatty() and not os.environ.get("NO_COLOR")


@contextmanager
def progress(name: str, total: int | None, unit: str = "frame") -> Iterator[Callable[..., None]]:
    """Show a bar with speed and time left; yields a function that takes the number done.

    A text passed with the number replaces `name`.
    """
    if settings().quiet or not is_lively():
        yield lambda done, text=None: None
        return
    from rich import progress as bars
    from rich.console import Console
    from rich.text import Text

    class Rate(bars.ProgressColumn):
        """Frames, or other units, per second."""

        def render(self, task: bars.Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text(f"{speed:.{0 if speed >= 10 else 1}f} {unit}/s" if speed else f"– {unit}/s")

    columns = (
        bars.TextColumn("{task.description}", markup=False),
        bars.BarColumn(),
        bars.MofNCompleteColumn(),
        Rate(),
        bars.TimeRemainingColumn(),
    )
    with bars.Progress(*columns, console=Console(stderr=True), transient=True) as display:
        task = display.add_task(printable(name), total=total)

        def advance(done: int, text: str | None = None) -> None:
            # The total is what the container states, and may be too low.
            most = max(total, done) if total else None
            display.update(task, completed=done, total=most, description=printable(text or name))

        yield advance
