"""`dlgmd sets`: list the parameter sets, print one as YAML, or draw its kernels."""

from pathlib import Path

import click
from click.shell_completion import CompletionItem

from dlgmd_cli.commands import console, options
from dlgmd_cli.commands.console import Command, Group
from dlgmd_cli.parameters import keys, presets


class _Sets(Group):
    """`dlgmd sets 9` is short for `dlgmd sets show 9`."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; a name that is not a command is an argument of `show`."""
        return super().resolve_command(ctx, args if args[0] in self.commands else ["show", *args])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """The commands, and the arguments of `show`."""
        return [*super().shell_complete(ctx, incomplete), *_named(incomplete)]


@click.group(
    cls=_Sets, invoke_without_command=True, short_help="List the sets, models and presets."
)
@click.pass_context
def sets(ctx: click.Context) -> None:
    """List the paper's parameter sets, the other models and the presets.

    \b
    Examples:
      dlgmd sets                       # the table of all of them
      dlgmd sets 9                     # set 9 as YAML; short for sets show 9
      dlgmd sets 9 --plot 9.png        # the kernels of set 9 as a figure
    """
    if ctx.invoked_subcommand is not None:
        return
    from dlgmd_cli.tasks import sets as task

    console.show(task.sets())


def _named(incomplete: str) -> list[CompletionItem]:
    names = [*presets.preset_names(), *presets.MODELS, *presets.PRESETS]
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


@sets.command(cls=Command)
@click.argument("name", metavar="NAME", shell_complete=lambda _, __, word: _named(word))
@click.option(
    "--plot",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Draw the kernels of a D-LGMD into FILE instead: excitation, inhibition and latency.",
)
@options.overwrite_option
def show(name: str, plot: Path | None, overwrite: bool) -> None:
    """Print the parameters of NAME as YAML, for use with --config.

    \b
    Examples:
      dlgmd sets show 9                 # the paper's set 9
      dlgmd sets show flight > my.yaml  # to change, and run with --config
      dlgmd sets show my.yaml --plot kernels.pdf

    NAME is a set (1 to 9), a preset such as flight, a model such as lgmd or package.module:Class,
    or a YAML file.
    """
    if ":" in name:
        keys.find_modules_here()
    from dlgmd_cli.tasks import sets as task

    console.show(task.sets(name, plot, overwrite=overwrite))


@sets.command(cls=Command)
@click.argument("name", metavar="MODULE:CLASS")
def check(name: str) -> None:
    """Step a custom model over 20 frames, and say what its class gets wrong.

    \b
    Examples:
      dlgmd sets check fast:Fast        # the class Fast of fast.py

    A mistake that a run would end with is an error. Signs, data types, reset, and methods that
    override nothing are reported; a run goes on with them.
    """
    from dlgmd_cli.models.base import create_model
    from dlgmd_cli.models.trial import trial
    from dlgmd_cli.results.csv import row_type

    keys.find_modules_here()
    params = presets.parameters_of(presets.config_of(name))
    row_type(create_model(params).columns)  # raises for a name that is taken
    facts, faults = trial(params)
    for line in [*facts, *faults]:
        click.echo(f"{name}: {line}")
    if not faults:
        click.echo(f"{name}: no mistake was found")
