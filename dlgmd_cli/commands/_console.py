"""What the user sees of a run: progress, messages, and errors as one line with an exit code."""

import json
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import click

from dlgmd_cli.errors import DlgmdError, OutputExistsError, ParameterError, printable

EXIT_FAILED, EXIT_USAGE, EXIT_INTERRUPTED = 1, 2, 130


class Settings:
    """The options that stand before the command."""

    def __init__(self, quiet: bool = False, debug: bool = False) -> None:
        self.quiet, self.debug = quiet, debug


class Failed(click.ClickException):
    """A library error on its way to one line on stderr."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message)
        self.exit_code = exit_code  # type: ignore[misc]


def settings() -> Settings:
    """The settings of the command line being run."""
    found = click.get_current_context().find_object(Settings)
    return found or Settings()


class Command(click.Command):
    """A command whose errors, the library's and bugs alike, end as one line and an exit code."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """As click does, after a look at what no operating system could have handed over."""
        if any("\0" in arg for arg in args):
            raise click.UsageError("an argument holds a NUL, which no name does.", ctx)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command."""
        with errors_as_one_line():
            return super().invoke(ctx)


@contextmanager
def usage_errors_escaped() -> Iterator[None]:
    """Let click quote what was typed, but not as it was typed."""
    try:
        yield
    except click.ClickException as error:
        message = printable(error.message)
        if isinstance(error, click.NoSuchOption) and _starts_a_name(error.option_name):
            message += " A file's name that begins like this needs ./ in front."
        error.message = message  # type: ignore[misc]
        raise


def _starts_a_name(option: str) -> bool:
    """Whether something here is called so that it was taken for that option."""
    try:
        return any(path.name.startswith(option) for path in Path().iterdir())
    except OSError:
        return False


@contextmanager
def errors_as_one_line() -> Iterator[None]:
    """Turn what the library raises, bugs included, into click's own errors."""
    try:
        with usage_errors_escaped():
            yield
    except (click.ClickException, click.exceptions.Exit, click.Abort):
        raise
    except BrokenPipeError:  # the reader of stdout has gone; click ends quietly
        raise
    except KeyboardInterrupt:
        say("Interrupted.")
        raise click.exceptions.Exit(EXIT_INTERRUPTED) from None
    except DlgmdError as error:
        if settings().debug:
            raise
        message = printable(str(error))
        if isinstance(error, ParameterError):
            raise click.UsageError(message, click.get_current_context()) from None
        code = EXIT_USAGE if isinstance(error, OutputExistsError) else EXIT_FAILED
        raise Failed(message, code) from None
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise Failed(f"the output cannot be written ({reason}).", EXIT_FAILED) from None
    except MemoryError:
        raise Failed(
            "not enough memory. Process smaller frames with --scale.", EXIT_FAILED
        ) from None
    except Exception as error:
        if settings().debug:
            raise
        raise Failed(
            f"internal error ({type(error).__name__}). "
            "Rerun with --debug and report the traceback.",
            EXIT_FAILED,
        ) from None


def say(message: str) -> None:
    """A message on stderr."""
    click.echo(printable(message), err=True)


def warn(message: str) -> None:
    """A warning on stderr; never silenced."""
    say(f"Warning: {message}.")


def show_traceback(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """In place of Python's own hook: a traceback on stderr, which may quote names."""
    for part in traceback.format_exception(kind, error, trace):
        for line in part.rstrip("\n").split("\n"):
            say(line)


def print_path(path: Path | str) -> None:
    """A path or URL on stdout, on one line."""
    click.echo(printable(os.fspath(path)))


def print_json(facts: dict[str, Any]) -> None:
    """An object on stdout, in ASCII: JSON has escapes of its own."""
    click.echo(json.dumps(facts))


def is_lively() -> bool:
    """Whether stderr may show bars and colours."""
    # None: it was closed by the shell.
    return sys.stderr is not None and sys.stderr.isatty() and not os.environ.get("NO_COLOR")


@contextmanager
def progress(name: str, total: int | None, unit: str = "frame") -> Iterator[Callable[[int], None]]:
    """A bar with speed and time left on stderr; yields what to call with the frames done."""
    if settings().quiet or not is_lively():
        yield lambda done: None
        return
    from rich import progress as bars
    from rich.console import Console
    from rich.text import Text

    class Rate(bars.ProgressColumn):
        """Frames, or what is counted, per second over the last seconds."""

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

        def advance(done: int) -> None:
            # The total is only what the container announces.
            display.update(task, completed=done, total=max(total, done) if total else None)

        yield advance


def print_table(header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    """A table on stdout, as wide as it needs to be where that is no terminal."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    if sys.stdout is None:  # closed by the shell
        return
    table = Table(box=box.SIMPLE, show_header=any(header), pad_edge=False)
    for title in header:
        table.add_column(title, overflow="fold")
    for row in rows:
        table.add_row(*map(printable, row))
    console = Console(
        markup=False, emoji=False, highlight=False, no_color=not sys.stdout.isatty() or None
    )
    if not sys.stdout.isatty():
        console.width = 200
    console.print(table)


def explain_infinity() -> None:
    """What an infinite distinguishability in a table means, on stdout."""
    click.echo("inf: no membrane potential within 5 frames of the false positive, none to mistake.")
