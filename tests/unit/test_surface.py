"""Which options there are."""

import click

from dlgmd_cli.commands.app import cli


def options_of(command, name="dlgmd", without=()):
    """Command -> names of its options, `--help` apart; those of groups count, too."""
    context = click.Context(command)
    options = [one for one in command.get_params(context) if isinstance(one, click.Option)]
    found = {name: [max(one.opts, key=len) for one in options if "--help" not in one.opts]}
    for word in command.list_commands(context) if isinstance(command, click.Group) else ():
        if word not in without:
            found |= options_of(command.get_command(context, word), f"{name} {word}")
    return found


def test_no_option_is_there_twice():
    found = options_of(cli, without=("lab",))
    assert "dlgmd run" in found and "dlgmd sets show" in found
    for name, options in found.items():
        assert len(set(options)) == len(options), name
        # The general options are those of the tool alone.
        assert name == "dlgmd" or not {"--quiet", "--json", "--log", "--debug"} & {*options}
