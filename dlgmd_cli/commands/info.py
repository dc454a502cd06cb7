"""`dlgmd info`: describe videos, and suggest options for a run."""

from typing import Any

import click
from click.core import ParameterSource

from dlgmd_cli.commands import console, defaults, options


@click.command(
    cls=console.Command, short_help="Describe videos: size, frame rate, duplicate frames, damage."
)
@click.argument("input_paths", metavar="INPUT...", nargs=-1, shell_complete=options.complete_file)
@console.settings_option(
    is_flag=False,
    flag_value="",
    help=f"Without INPUT: show the own defaults in {defaults.NAME}, or in FILE.",
)
@click.option(
    "--write-mask",
    type=options.file_ending("mask.png"),
    metavar="FILE.png",
    help="Write a mask for --mask: black where pixels never change, such as an on-screen display.",
)
@options.overwrite_option
@options.input_option("input_fps")
@options.input_option("topic")
@options.input_option("decoder")
@options.json_option
def info(input_paths: tuple[str, ...], as_json: bool, **arguments: Any) -> None:
    """Describe videos: size, codec, frame rate, duplicate frames, damage.

    \b
    Examples:
      dlgmd info flight.mp4                        # facts, and fitting options
      dlgmd info flight.mp4 --write-mask mask.png  # a mask for the display in it
      dlgmd info --settings                        # your own defaults of options

    INPUT is as in 'dlgmd run', and is read to the end. Below the facts, the command suggests
    options of 'dlgmd run', or what to do with the file first.

    The file dlgmd.yaml, in the working folder or in one above it, may set size, mask, decoder,
    format and out, such as 'out: results' on a line. Paths are relative to the file, and no URLs.
    Options take precedence over it. A file of another user is refused; the search ends at your home
    folder.
    """
    if not input_paths:
        _show_settings(as_json=as_json)
        return
    from dlgmd_cli.tasks import info as task

    console.show(task.info(input_paths, progress=console.progress, **arguments), as_json=as_json)


def _show_settings(*, as_json: bool) -> None:
    """Print the own defaults; raises UsageError if --settings is not given."""
    source = click.get_current_context().get_parameter_source("own_defaults")
    if source is ParameterSource.DEFAULT and console.settings().own_defaults is None:
        raise click.UsageError("Missing argument 'INPUT...'.")
    path = defaults.find(console.settings().own_defaults)
    values = {} if path is None else defaults.read(path)
    if as_json:
        console.print_json({"settings": None if path is None else str(path), **values})
        return
    if path is None:
        click.echo(f"There is no {defaults.NAME} here or in a folder above. It may set:")
        console.print_table(("", ""), list(defaults.KEYS.items()))
        return
    texts = {key: [value] if isinstance(value, str) else value for key, value in values.items()}
    rows = [(key, ", ".join(texts[key])) for key in defaults.KEYS if key in texts]
    console.print_table(("", str(path)), rows)
