"""How much the command line asks a user to know."""

import click

from dlgmd_cli.commands.app import cli

# Of the tool without the laboratory; with it, `tests/lab/test_slots.py` counts.
MOST_SLOTS = 250


def slots(command, name="dlgmd", without=()):
    """Command -> names of its options, `--help` apart; those of groups count, too."""
    context = click.Context(command)
    options = [one for one in command.get_params(context) if isinstance(one, click.Option)]
    found = {name: [max(one.opts, key=len) for one in options if "--help" not in one.opts]}
    for word in command.list_commands(context) if isinstance(command, click.Group) else ():
        if word not in without:
            found |= slots(command.get_command(context, word), f"{name} {word}")
    return found


def test_the_options_of_the_tool_are_few():
    found = slots(cli, without=("lab",))
    assert "dlgmd run" in found and "dlgmd sets show" in found
    assert sum(map(len, found.values())) <= MOST_SLOTS, {k: len(v) for k, v in found.items()}
    for name, options in found.items():
        assert len(set(options)) == len(options), name
        # The general options are those of the tool alone.
        assert name == "dlgmd" or not {"--quiet", "--json", "--log", "--debug"} & {*options}
