"""What a command shows of the outcome of its task, and the exit code; the same for all."""

from typing import TYPE_CHECKING

import click

from dlgmd_cli.commands.console import print_json, print_path, print_table, say
from dlgmd_cli.machine import cancel

if TYPE_CHECKING:
    from dlgmd_cli.results.outcome import Outcome


def show(outcome: "Outcome", *, as_json: bool = False) -> None:
    """Print an outcome as tables and paths, or as JSON.

    Exits with code 130 if the user asked to stop, after a line that says what there is. Raises the
    outcome's failure, if there is one.
    """
    if as_json:
        print_json(outcome.facts())
    for block in () if as_json else outcome.shown():
        if isinstance(block, tuple):
            print_table(*block)
        elif isinstance(block, str):
            click.echo(block)
        else:
            print_path(str(block))
    if cancel.requested() or not outcome.complete:
        say(f"Interrupted. {outcome.kept()}.")
        raise click.exceptions.Exit(cancel.EXIT_INTERRUPTED)
    if outcome.failure is not None:
        raise outcome.failure
