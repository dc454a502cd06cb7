"""Output for the user: messages, progress, outcomes, and errors as one line with an exit code."""

import json
import logging
import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any, NoReturn

import click
from click.core import ParameterSource
from click.exceptions import NoArgsIsHelpError
from click.shell_completion import CompletionItem

from dlgmd_cli import __version__
from dlgmd_cli.commands.mending import is_there, meant_call
from dlgmd_cli.errors import (
    DlgmdError,
    DlgmdWarning,
    Once,
    OutputExistsError,
    ParameterError,
    argument,
    naming_arguments,
    printable,
)
from dlgmd_cli.machine import cancel
from dlgmd_cli.parameters.checks import refuse, require_known

if TYPE_CHECKING:
    from dlgmd_cli.results.outcome import Outcome

_log = logging.getLogger(__name__)

EXIT_FAILED, EXIT_USAGE = 1, 2

# Sections of the help with their options, the common options first. An option in no section is
# specific to its command, and comes before all sections.
SECTIONS = {
    "Model": "set config model param alarm threshold variant label normalise",
    "Input": "realtime input-size pixel-format size scale fps start end crop mask repeats "
    "input-fps bit-depth topic decoder",
    "Camera": "fov camera-tilt heading",
    "Output": "out record format overwrite force width",
    "General": "json quiet verbose log debug version help",
}
_COMMON = " ".join(SECTIONS.values()).split()
_NO_MEMORY = "not enough memory. Process smaller frames with --scale, or end other programs."
# Texts in the errors of Python, the module loader and OpenCV when memory or threads run short.
_SHORTAGES = {
    "failed to map segment": _NO_MEMORY,
    "annot allocate memory": _NO_MEMORY,
    "nsufficient memory": _NO_MEMORY,
    "can't start new thread": "the system lets this program start no more threads. "
    "End other programs, or raise the limit (ulimit -u, or pids of a container).",
}
# Most rows of a table that is transposed, and a width in characters that no table has.
_MOST_TURNED, _UNLIMITED = 12, 10_000
# Number of extra arguments that an error lists.
_MAX_LISTED = 3


@dataclass
class Settings:
    """The general options, given before or after the name of the command."""

    quiet: bool = False
    verbose: bool = False
    log: Path | None = None
    debug: bool = False
    as_json: bool = False


_flag = partial(click.option, is_flag=True)


def general_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the general options, which apply to every command."""
    for option in (
        click.version_option(__version__, "-V", "--version", prog_name="dlgmd"),
        _flag("--debug", help="Show the traceback of an error."),
        click.option(
            "--log",
            type=click.Path(path_type=Path),
            metavar="FILE",
            help="Append all messages to FILE, details included, with their times.",
        ),
        _flag("-v", "--verbose", help="Also show details, such as the parameters."),
        _flag("-q", "--quiet", help="Show nothing but results and errors."),
        _flag("--json", "as_json", help="Print one JSON object instead of tables."),
    ):
        command = option(command)
    return command


def general_first(options: Iterable[click.Parameter], args: list[str]) -> list[str]:
    """The arguments with the general options moved before the command."""
    flags = {name: option for option in options for name in option.opts}
    end = args.index("--") if "--" in args else len(args)
    first: list[str] = []
    others: list[str] = []
    words = iter(args[:end])
    for word in words:
        option = flags.get(word.partition("=")[0])
        (others if option is None else first).append(word)
        if isinstance(option, click.Option) and not option.is_flag and "=" not in word:
            first += [value for value in (next(words, None),) if value is not None]
    return [*first, *others, *args[end:]]


class Failed(click.ClickException):
    """A failure that click prints as one line on stderr."""

    def __init__(self, message: str, exit_code: int = EXIT_FAILED) -> None:
        super().__init__(message)
        self.exit_code = exit_code  # type: ignore[misc]


def settings() -> Settings:
    """The settings of the command line being run."""
    ctx = click.get_current_context(silent=True)
    return (ctx and ctx.find_object(Settings)) or Settings()


def tell(message: str) -> None:
    """Print a message on stderr, unless --quiet is given."""
    _log.info("%s", message)


class _TwoLines(click.UsageError):
    """A usage error that is printed as two lines: the usage, and the error."""

    def show(self, file: IO[Any] | None = None) -> None:
        """Print the usage and the error."""
        if self.ctx is not None:
            usage = " ".join(self.ctx.get_usage().split())
            click.echo(f"{usage} (see --help)", file=file or sys.stderr)
        click.echo(f"Error: {self.format_message()}", file=file or sys.stderr)


class _WithSections(click.Command):
    """A command whose help has sections; the general options come last.

    An option with the attribute `section` is listed in the section of that name.
    """

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands of a group, then the options in the sections of the help."""
        if isinstance(self, click.Group):
            self.format_commands(ctx, formatter)
        for title, records in self.sections(ctx).items():
            with formatter.section(title):
                formatter.write_dl(records)

    def sections(self, ctx: click.Context) -> dict[str, list[tuple[str, str]]]:
        """Title of each section of the help -> names and text of its options, in order."""
        ranks = {
            f"--{name}": (section, rank)
            for section, names in SECTIONS.items()
            for rank, name in enumerate(names.split())
        }
        lines: dict[str, list[tuple[int, tuple[str, str]]]] = {"Options": []}
        general = ctx.find_root().command.params if ctx.parent is not None else []
        for param in [*general, *self.get_params(ctx)]:
            record = param.get_help_record(ctx)
            if record is None or not isinstance(param, click.Option):
                continue
            section, rank = ranks.get(max(param.opts, key=len), ("Options", 0))
            if hasattr(param, "section"):
                section, rank = param.section, 0
            names, text = record
            names = re.sub(r"(--\S+), --\S+", r"\1", names)  # leave out aliases
            lines.setdefault(section, []).append((rank, (names, text)))
        titles = [*(title for title in lines if title not in SECTIONS), *SECTIONS]
        return {
            title: [record for _, record in sorted(lines[title], key=lambda line: line[0])]
            for title in titles
            if lines.get(title)
        }


class Group(_WithSections, click.Group):
    """A group of commands."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; the error for an unknown name suggests a similar one."""
        if self.get_command(ctx, args[0]) is None:
            require_known("command", args[0], self.list_commands(ctx))
        return super().resolve_command(ctx, args)


class Command(_WithSections):
    """A command that prints each error as one line."""

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """The options of the command, and the general options."""
        options = [name for option in ctx.find_root().command.params for name in option.opts]
        general = [name for name in options if incomplete and name.startswith(incomplete)]
        return [*super().shell_complete(ctx, incomplete), *map(CompletionItem, general)]

    def argument_names(self) -> dict[str, str]:
        """Function's argument -> option of this command, such as `out` -> `--out`."""
        names = {name.replace("-", "_"): f"--{name}" for name in _COMMON}
        for param in self.params:
            for option in [*param.opts, *param.secondary_opts]:
                if option.startswith("--"):
                    names[option.removeprefix("--").replace("-", "_")] = option
                    names.setdefault(str(param.name), option)
        return names

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments; the error is short if a shell has expanded a pattern."""
        if any("\0" in arg for arg in args):
            raise click.UsageError("an argument contains a NUL character.", ctx)
        ctx.allow_extra_args = True  # the error below lists them
        words = tuple(args)  # click empties the list
        try:
            with naming_arguments(self.argument_names()):
                rest = super().parse_args(ctx, args)
        except NoArgsIsHelpError:
            raise
        except click.MissingParameter as error:
            raise click.UsageError(f"{_line(error)} {self._example(ctx)}".strip(), ctx) from None
        except click.UsageError as error:
            names = getattr(getattr(error, "param", None), "opts", ())
            wrong = [word for name, word in pairwise(words) if name in names]
            is_elsewhere = getattr(error, "option_name", "").removeprefix("--") in _COMMON
            is_missing = is_elsewhere and isinstance(error, click.NoSuchOption)
            meant = "Other commands have it." if is_missing else meant_call(ctx, words, wrong)
            _raise_with_call(error, meant)
        missing = [word for word in (*rest, *self._inputs(ctx)) if not is_there(word)]
        if rest and not ctx.resilient_parsing:
            error_line = _too_many(rest, has_input=any(self._inputs(ctx)))
            meant = meant_call(ctx, words, missing) or self._example(ctx)
            _raise_with_call(click.UsageError(error_line, ctx), meant)
        if missing and (meant := meant_call(ctx, words, missing)):
            _raise_with_call(click.UsageError(f"{missing[0]!r} is no file.", ctx), meant)
        return rest

    def _inputs(self, ctx: click.Context) -> Iterator[str]:
        """The words that are arguments of the command, not options."""
        for param in self.params:
            if isinstance(param, click.Argument):
                value = ctx.params.get(str(param.name)) or ()
                yield from map(str, value if isinstance(value, tuple) else (value,))

    def _example(self, ctx: click.Context) -> str:
        """The first example of the help."""
        first = re.search(rf"^ *({ctx.command_path}( .*?)?) *(#|$)", str(self.help), re.MULTILINE)
        return f"Write '{first[1].strip()}'." if first else ""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; an error that was only logged also gives the exit code 1."""
        with (
            naming_arguments(self.argument_names()),
            logged() as lines,
            errors_as_one_line(),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("ignore", DlgmdWarning)  # these warnings are also logged
            returned = super().invoke(ctx)
            if lines.has_error:
                raise click.exceptions.Exit(EXIT_FAILED)
            return returned


def refuse_given(names: Collection[str], why: str) -> None:
    """`refuse` the arguments `names` that are given as options; their defaults are not."""
    source = click.get_current_context().get_parameter_source
    refuse({name: source(name) is ParameterSource.COMMANDLINE for name in names}, why)


def _raise_with_call(error: click.UsageError, meant: str) -> NoReturn:
    """Raise the error of a wrong call, with the call that was meant in place of other guesses."""
    line = _line(error)
    if meant:
        line = re.sub(r" \(?(Did you mean|Possible options|Write) .*", "", line)
        line = f"{line.rstrip('.')}."  # older releases of click end without a full stop
    raise click.UsageError(f"{line} {meant}".strip(), error.ctx) from None


def _line(error: click.ClickException) -> str:
    return " ".join(error.format_message().split())


def _too_many(extra: list[str], *, has_input: bool) -> str:
    """The error for arguments that a command does not take."""
    n_extra = len(extra)
    endings = {Path(name).suffix.lower() for name in extra}
    if n_extra >= _MAX_LISTED and len(endings) == 1 and all(map(os.path.exists, extra)):
        pattern = Path(extra[0]).parent / f"*{Path(extra[0]).suffix}"
        return (
            f"{n_extra + 1} files were given instead of one. If they are the frames of one video, "
            f"quote the pattern: '{pattern}'. For several videos, use 'dlgmd batch'."
        )
    more = f" and {n_extra - _MAX_LISTED} more" if n_extra > _MAX_LISTED else ""
    listed = ", ".join(repr(name) for name in extra[:_MAX_LISTED])
    line = f"unexpected {'argument' if n_extra == 1 else 'arguments'}: {listed}{more}."
    if not has_input or not all(Path(name).suffix for name in extra):
        return line
    return f"{line} A name with spaces needs quotes; 'dlgmd batch' takes several videos."


@contextmanager
def errors_as_one_line() -> Iterator[None]:
    """Turn exceptions of the library, and bugs, into click's own errors.

    Control characters in click's errors, which quote the arguments, are escaped.
    """
    try:
        yield
    # If the reader of stdout has ended (BrokenPipeError), click exits silently.
    # The message of NoArgsIsHelpError is the help.
    except (click.exceptions.Exit, click.Abort, BrokenPipeError, NoArgsIsHelpError):
        raise
    except click.MissingParameter as error:  # click would list the choices on several lines
        line = " ".join(error.format_message().split())
        raise _TwoLines(printable(line), error.ctx) from None
    except click.UsageError as error:
        raise _TwoLines(printable(error.format_message()), error.ctx) from None
    except click.ClickException as error:
        error.message = printable(error.message)  # type: ignore[misc]
        raise
    except (KeyboardInterrupt, cancel.Interrupted):
        say("Interrupted.")
        raise click.exceptions.Exit(cancel.EXIT_INTERRUPTED) from None
    except Exception as error:
        if settings().debug and not isinstance(error, OSError):
            raise
        raise _as_one_line(error) from None


def _as_one_line(error: Exception) -> click.ClickException:
    """Click's error for an exception of the library, or for a bug."""
    kind = type(error).__name__
    if isinstance(error, ParameterError):
        line = str(error)
        if error.argument:
            why = str(DlgmdError(error.what, error.why, error.hint))
            line = f"Invalid value for '{argument(error.argument)}': {why}"
        return _TwoLines(printable(line), click.get_current_context(silent=True))
    if isinstance(error, DlgmdError):
        is_usage = isinstance(error, OutputExistsError) or error.hint.startswith("Did you mean")
        return Failed(printable(str(error)), EXIT_USAGE if is_usage else EXIT_FAILED)
    if isinstance(error, OSError):
        return Failed(f"the output cannot be written ({error.strerror or kind}).")
    if isinstance(error, MemoryError | SystemError):  # SystemError: C code without memory
        return Failed(_NO_MEMORY)
    for sign, line in _SHORTAGES.items():
        if sign in str(error):
            return Failed(line)
    return Failed(f"internal error ({kind}). Rerun with --debug and report the traceback.")


def say(message: str) -> None:
    """Print a message on stderr, even with --quiet: an error, the end of a run, an address."""
    _show_line(message)
    _log.info("%s", message, extra={"is_shown": True})


def _show_line(message: str) -> None:
    with suppress(OSError):  # a closed stderr must not stop the command
        click.echo(printable(message), err=True)


class _Lines(logging.Handler):
    """Shows messages on stderr, and records whether any message was an error."""

    has_error = False

    def emit(self, record: logging.LogRecord) -> None:
        """Print a message with its level, unless `say` or click has printed it."""
        if hasattr(record, "is_shown"):
            return
        self.has_error |= record.levelno >= logging.ERROR
        is_serious = record.levelno >= logging.WARNING
        form = f"{record.levelname.capitalize()}: {{}}." if is_serious else "{}"
        _show_line(form.format(record.getMessage()))


class _FileLines(logging.Formatter):
    """Formats each message as one line."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802, logging's name
        """The time, the level, the logger and the message."""
        return printable(super().formatMessage(record))


@contextmanager
def logged() -> Iterator[_Lines]:
    """Show the messages of dlgmd_cli's loggers while a command runs, by -q, -v and --log."""
    log, general = logging.getLogger("dlgmd_cli"), settings()
    shown = logging.ERROR if general.quiet else logging.DEBUG if general.verbose else logging.INFO
    lines = _Lines(shown)
    handlers: list[logging.Handler] = [lines]
    if general.log is not None:
        if general.log.is_fifo():  # opening a pipe would wait for a reader
            raise Failed(f"--log: {general.log}: is a pipe, not a file.")
        try:
            handlers.append(logging.FileHandler(general.log, encoding="utf-8", errors="replace"))
        except OSError as error:
            raise Failed(f"--log: {general.log}: cannot be written ({error.strerror}).") from None
        handlers[-1].setFormatter(_FileLines("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    before, log.propagate = log.level, False
    warned = Once()

    def is_new(record: logging.LogRecord) -> bool:
        """Whether a warning of `errors.warn` is new; a filter sees no messages of child loggers."""
        return warned.is_new(record.getMessage())

    log.addFilter(is_new)
    for handler in handlers:
        log.addHandler(handler)
    log.setLevel(min(shown, logging.DEBUG if general.log else logging.INFO))
    try:
        yield lines
    except click.ClickException as error:
        _log.error("%s", error.format_message(), extra={"is_shown": True})
        raise
    finally:
        log.removeFilter(is_new)
        for handler in handlers:
            log.removeHandler(handler)
            handler.close()
        log.setLevel(before)
        log.propagate = True


def show_traceback(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """Print a traceback on stderr with control characters escaped; replaces Python's own hook."""
    for part in traceback.format_exception(kind, error, trace):
        for line in part.rstrip("\n").split("\n"):
            say(line)


def print_path(path: Path | str) -> None:
    """Print a path or URL on stdout, on one line."""
    click.echo(printable(os.fspath(path)))


def print_table(header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    """Print a table on stdout; up to 200 characters wide if stdout is not a terminal.

    A short table that would have to break words is transposed: titles on the left, and the rows as
    columns beside the titles, as many per block as fit.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    if sys.stdout is None:  # closed by the shell
        return
    console = Console(
        markup=False, emoji=False, highlight=False, no_color=not sys.stdout.isatty() or None
    )
    if not sys.stdout.isatty():
        console.width = 200
    unlimited = console.options.update(width=_UNLIMITED)

    def table_of(titles: tuple[str, ...], lines: Iterable[tuple[str, ...]]) -> Table:
        table = Table(box=box.SIMPLE, show_header=any(titles), pad_edge=False)
        for title in titles:
            table.add_column(title, overflow="fold")
        for line in lines:
            table.add_row(*line)
        return table

    def turned(columns: Sequence[tuple[str, ...]]) -> Table:
        titles, *lines = zip(header, *columns, strict=True)
        return table_of(titles, lines)

    left = [tuple(map(printable, row)) for row in rows]
    table = table_of(header, left)
    breaks_words = console.measure(table, options=unlimited).minimum > console.width
    if not (breaks_words and any(header) and len(left) <= _MOST_TURNED):
        console.print(table)
        return
    while left:
        fits = [
            n
            for n in range(1, len(left) + 1)
            if console.measure(turned(left[:n]), options=unlimited).maximum <= console.width
        ]
        n_beside = max(fits, default=1)
        console.print(turned(left[:n_beside]))
        left = left[n_beside:]


def show(outcome: "Outcome") -> None:
    """Print an outcome as tables and paths, or as JSON with --json.

    If the user asked to stop, prints a line about the kept results and exits with code 130. Raises
    the outcome's failure, if there is one.
    """
    if settings().as_json:
        click.echo(json.dumps(outcome.facts()))  # in ASCII, for terminals of any encoding
    for block in () if settings().as_json else outcome.shown():
        if isinstance(block, tuple):
            print_table(*block)
        elif isinstance(block, str):
            click.echo(block)
        else:
            print_path(str(block))
    if cancel.requested() or outcome.interrupted:
        say(f"Interrupted. {outcome.kept()}.")
        raise click.exceptions.Exit(cancel.EXIT_INTERRUPTED)
    if outcome.failure is not None:
        raise outcome.failure


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
    from rich.table import Column
    from rich.text import Text

    class Rate(bars.ProgressColumn):
        """Frames, or other units, per second."""

        def render(self, task: bars.Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text(f"{speed:.{0 if speed >= 10 else 1}f} {unit}/s" if speed else f"– {unit}/s")

    console = Console(stderr=True)
    # In a narrow terminal, a long name is cut, and the bar stays on its line.
    shortened = Column(no_wrap=True, max_width=max(12, console.width // 3))
    columns = (
        bars.TextColumn("{task.description}", markup=False, table_column=shortened),
        bars.BarColumn(),
        bars.MofNCompleteColumn(),
        Rate(table_column=Column(no_wrap=True)),
        bars.TimeRemainingColumn(),
    )
    with bars.Progress(*columns, console=console, transient=True) as display:
        task = display.add_task(printable(name), total=total)

        def advance(done: int, text: str | None = None) -> None:
            # The total is the number that the container states; it may be too low.
            most = max(total, done) if total else None
            display.update(task, completed=done, total=most, description=printable(text or name))

        yield advance
