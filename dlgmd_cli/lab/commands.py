"""`dlgmd lab`: the commands of the laboratory, each imported when it is called."""

from importlib import import_module
from importlib.util import find_spec

import click

from dlgmd_cli.commands.console import Group, errors_as_one_line
from dlgmd_cli.errors import MissingExtraError

COMMANDS = ("fly", "paper", "bench", "measure")


class LabGroup(Group):
    """The commands by name; that of `fly` is `dlgmd_cli.lab.fly.command.fly`, and so on."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names, in the order of the help."""
        return [*COMMANDS]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; None if there is none of that name."""
        if cmd_name not in COMMANDS:
            return None
        module = import_module(f"dlgmd_cli.lab.{cmd_name}.command")
        command: click.Command = getattr(module, cmd_name)
        return command


@click.group(cls=LabGroup)
def lab() -> None:
    """Render flights, check the paper, measure speed and the tables of the pages.

    \b
    Examples:
      dlgmd lab fly --count 20 --out flights    # 20 labelled flights
      dlgmd lab paper                           # the claims of the paper
      dlgmd lab bench                           # speed

    These commands need the extra: pip install '.[lab]' in the clone.
    """
    if find_spec("mujoco") is None:
        with errors_as_one_line():
            raise MissingExtraError.of("dlgmd lab", "mujoco")
