"""`dlgmd completion`: print the script with which a shell completes commands and options."""

import click
from click.shell_completion import get_completion_class

from dlgmd_cli.commands.console import Command

SHELLS = ("bash", "zsh", "fish")
# The environment variable by which a shell asks click for completions.
_VARIABLE = "_DLGMD_COMPLETE"
# The line of click's bash script that adds a word. No space may follow KEY=.
_ADDED = "COMPREPLY+=($value)"


@click.command(cls=Command)
@click.argument("shell", metavar="bash|zsh|fish", type=click.Choice(SHELLS))
def completion(shell: str) -> None:
    """Print a script that completes dlgmd in your shell.

    The script completes commands, options, files, scenes, sets, presets and parameter keys. For
    all new shells, add your shell's line to its start-up file:

    \b
    Examples:
      eval "$(dlgmd completion bash)"     # in ~/.bashrc
      eval "$(dlgmd completion zsh)"      # in ~/.zshrc
      dlgmd completion fish | source      # in ~/.config/fish/config.fish
    """
    kind = get_completion_class(shell)
    assert kind is not None
    root = click.get_current_context().find_root().command
    source = kind(root, {}, "dlgmd", _VARIABLE).source()
    click.echo(source.replace(_ADDED, f"{_ADDED}; [[ $value == *= ]] && compopt -o nospace"))
