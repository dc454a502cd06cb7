"""`dlgmd completion`: what a shell runs to complete commands, options and their values."""

import click
from click.shell_completion import get_completion_class

from dlgmd_cli.commands.console import Command

SHELLS = ("bash", "zsh", "fish")
# What click looks for in the environment when a shell asks for completions.
_VARIABLE = "_DLGMD_COMPLETE"
# After a key and its equals sign, a value follows at once; this is how click's bash adds a word.
_ADDED = "COMPREPLY+=($value)"


@click.command(cls=Command, epilog="Example: dlgmd completion bash > dlgmd-complete.sh")
@click.argument("shell", metavar="bash|zsh|fish", type=click.Choice(SHELLS))
def completion(shell: str) -> None:
    """Print a script that completes dlgmd in your shell.

    It completes commands, options, files, scenes, sets, presets and the keys of parameters. To
    keep it, add the line for your shell to its start-up file:

    \b
    ~/.bashrc                   eval "$(dlgmd completion bash)"
    ~/.zshrc                    eval "$(dlgmd completion zsh)"
    ~/.config/fish/config.fish  dlgmd completion fish | source
    """
    kind = get_completion_class(shell)
    assert kind is not None
    root = click.get_current_context().find_root().command
    source = kind(root, {}, "dlgmd", _VARIABLE).source()
    click.echo(source.replace(_ADDED, f"{_ADDED}; [[ $value == *= ]] && compopt -o nospace"))
