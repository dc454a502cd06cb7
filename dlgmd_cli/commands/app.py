"""The `dlgmd` command: the general options, and the commands, each imported when called."""

import io
import os
import sys
from importlib import import_module
from typing import Any

import click

from dlgmd_cli.commands.console import (
    Group,
    Settings,
    errors_as_one_line,
    general_first,
    general_options,
    show_traceback,
)
from dlgmd_cli.commands.mending import meant_command, plain

# Section of the help -> its commands; the common commands come first.
GROUPS = {
    "Commands": ("run", "live", "batch", "info", "view", "compare", "evaluate", "plot"),
    "More": ("layers", "sweep", "sets", "calibrate", "export", "synth", "lab"),
}
COMMANDS = tuple(name for names in GROUPS.values() for name in names)
# Commands that no help lists.
HIDDEN = ("completion",)
# The module of a command outside this folder. An installation may lack the laboratory.
HOMES = {"lab": "dlgmd_cli.lab.commands"}


class LazyGroup(Group):
    """The commands by name; each command is imported from its own module when needed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names of the commands; the common commands come first."""
        return [name for name in COMMANDS if self.get_command(ctx, name) is not None]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands by their sections."""
        longest = max(map(len, COMMANDS))
        for title, names in GROUPS.items():
            commands = [(name, self.get_command(ctx, name)) for name in names]
            with formatter.section(title):
                formatter.write_dl(
                    [
                        (f"{name:{longest}}", command.get_short_help_str(formatter.width))
                        for name, command in commands
                        if command is not None
                    ]
                )

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; None for an unknown name, or a command that is not installed."""
        if cmd_name not in (*COMMANDS, *HIDDEN):
            return None
        home = HOMES.get(cmd_name, f"dlgmd_cli.commands.{cmd_name}")
        try:
            command: click.Command = getattr(import_module(home), cmd_name)
        except ModuleNotFoundError as error:
            if cmd_name not in HOMES or not home.startswith(str(error.name)):
                raise
            return None
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; the error for an unknown name suggests a similar one."""
        name = click.utils.make_str(args[0])
        if name not in COMMANDS and self.get_command(ctx, name) is None:
            ctx.fail(f"no such command {name!r}. {meant_command(args, COMMANDS)}")
        return click.Group.resolve_command(self, ctx, args)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the general options, which may also follow the command."""
        words = plain(args)
        try:
            return super().parse_args(ctx, general_first(self.params, [*words]))
        except click.NoSuchOption as error:
            meant = meant_command(words, COMMANDS)
            raise click.UsageError(f"No such option {error.option_name!r}. {meant}", ctx) from None

    def make_context(
        self,
        info_name: str | None,
        args: list[str],
        parent: click.Context | None = None,
        **extra: Any,
    ) -> click.Context:
        """Parse the arguments, or print the help; an exception becomes one line."""
        with errors_as_one_line():
            return super().make_context(info_name, args, parent, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; an exception becomes one line and an exit code."""
        with errors_as_one_line():
            return super().invoke(ctx)


@click.group(
    cls=LazyGroup,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "max_content_width": 100,
        "auto_envvar_prefix": "DLGMD",
    },
)
@general_options
@click.pass_context
def cli(ctx: click.Context, /, **general: Any) -> None:
    """Run the D-LGMD, a model of a locust's neuron, over video. By default, the expansion of the
    image raises alarms.

    \b
    Examples:
      dlgmd run flight.mp4                 # alarms of one video
      dlgmd live 0 --serve 8000            # a camera, with a page in the browser
      dlgmd batch flights --out results    # every video of a folder

    The general options may also follow the command. 'dlgmd COMMAND --help' explains a command. An
    environment variable sets an option: DLGMD_RUN_FOV=90 means 'dlgmd run --fov 90'.
    """
    ctx.obj = Settings(**general)


def main() -> None:
    """Run the command line."""
    # OpenCV and FFmpeg would report damage line by line, in addition to our own warning.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    # The greatest width of a decoded image in px, see `video.base.MAX_SIDE`; read on import of cv2.
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_WIDTH", "8192")
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_HEIGHT", "8192")
    # NumPy and OpenCV each load a BLAS, which reserves memory and starts threads per processor, and
    # crashes if the system refuses them. One thread suffices: our matrices are small.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.excepthook = show_traceback
    _prepare_streams()
    _require_a_folder()
    cli(prog_name="dlgmd")


def _require_a_folder() -> None:
    """Exit if the working folder has been deleted: relative paths would have no meaning."""
    try:
        os.getcwd()  # noqa: PTH109, Path.cwd is the same
    except OSError as error:
        click.echo(
            f"Error: the working folder is gone ({error.strerror}). Change to one.", err=True
        )
        sys.exit(2)


def _prepare_streams() -> None:
    """Make the standard streams fit for our output, and stderr for our output alone."""
    # The shell may have closed a stream: no result file must get its descriptor.
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free descriptor
    stream = sys.stderr
    if isinstance(stream, io.TextIOWrapper):
        # C libraries lose their stderr: libpng and libjpeg print lines about damaged images.
        sys.stderr = os.fdopen(os.dup(2), "w", 1, stream.encoding, stream.errors)
        sys.__stderr__ = sys.stderr  # type: ignore[misc]
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 2)
        os.close(nothing)
    # Not every terminal can encode the characters of file names and the model's symbols.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
