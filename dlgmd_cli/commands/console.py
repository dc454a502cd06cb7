"""What the user sees: messages and tables, and errors as one line with an exit code."""

import json
import os
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import click

from dlgmd_cli import cancel
from dlgmd_cli.errors import DlgmdError, OutputExistsError, ParameterError, printable

EXIT_FAILED, EXIT_USAGE = 1, 2


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
        with errors_as_one_line(), warnings.catch_warnings():
            # What the library warns of, such as letters that a figure's font lacks.
            warnings.filterwarnings("always", category=UserWarning, module="dlgmd_cli")
            warnings.showwarning = lambda message, *_, **__: warn(str(message))
            return super().invoke(ctx)


@contextmanager
def usage_errors_escaped() -> Iterator[None]:
    """Let click quote what was typed, but not as it was typed."""
    try:
        yield
    except click.ClickException as error:
        error.message = printable(error.message)  # type: ignore[misc]
        raise


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
    except (KeyboardInterrupt, cancel.Interrupted):
        say("Interrupted.")
        raise click.exceptions.Exit(cancel.EXIT_INTERRUPTED) from None
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


def end_if_interrupted(target: Path | str, n_frames: int, *, complete: bool) -> None:
    """After a stop, say what `target` holds and exit as interrupted."""
    if not cancel.requested():
        return
    kept = "the whole result" if complete else f"the {n_frames} frames processed before the stop"
    say(f"Interrupted. {target} holds {kept}.")
    raise click.exceptions.Exit(cancel.EXIT_INTERRUPTED)


def print_path(path: Path | str) -> None:
    """A path or URL on stdout, on one line."""
    click.echo(printable(os.fspath(path)))


def print_json(facts: dict[str, Any]) -> None:
    """An object on stdout, in ASCII: JSON has escapes of its own."""
    click.echo(json.dumps(facts))


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
