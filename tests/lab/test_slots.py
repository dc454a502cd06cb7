"""How many options all commands have together, those of the laboratory included."""

import click

from dlgmd_cli.commands.app import cli

MOST_SLOTS = 282


def n_slots(command):
    """The number of options of a command and of those below it, `--help` apart."""
    context = click.Context(command)
    options = [one for one in command.get_params(context) if isinstance(one, click.Option)]
    below = command.list_commands(context) if isinstance(command, click.Group) else ()
    return sum("--help" not in one.opts for one in options) + sum(
        n_slots(command.get_command(context, name)) for name in below
    )


def test_the_options_of_all_commands_are_few():
    assert n_slots(cli) <= MOST_SLOTS
