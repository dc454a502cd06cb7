"""`dlgmd sets`: list the parameter sets, or print one as YAML."""

from typing import Any

import click
from click.shell_completion import CompletionItem

from dlgmd_cli.commands.console import Command, Group, print_table
from dlgmd_cli.commands.options import find_modules_here
from dlgmd_cli.parameters import presets
from dlgmd_cli.parameters.checks import Spec

_SHOWN = ("alpha", "beta", "lam", "sigma_e", "sigma_i", "r", "a", "t0", "kappa")


class _Sets(Group):
    """`dlgmd sets 9` is short for `dlgmd sets show 9`."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; a name that is not a command is shown."""
        return super().resolve_command(ctx, args if args[0] in self.commands else ["show", *args])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """The commands, and the names that `show` takes."""
        names = _complete_name(ctx, self.params[0], incomplete)
        return [*super().shell_complete(ctx, incomplete), *names]


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
      dlgmd sets show 9 > my.yaml      # a file to change, for --config
    """
    if ctx.invoked_subcommand is not None:
        return
    specs = presets.DlgmdParameters.specs()
    header = ("set", *(specs[key].symbol for key in _SHOWN))
    rows = []
    for name in presets.preset_names():
        values = presets.load_set(name).to_dict()
        rows.append((name, *(f"{values[key]:g}" for key in _SHOWN)))
    print_table(header, rows)
    keys = (f"{specs[key].symbol} {key}" for key in _SHOWN if specs[key].symbol != key)
    click.echo(f"Keys: {', '.join(keys)}. 'dlgmd sets N' shows all parameters, with units.")
    others = [name for name in presets.MODELS if name != presets.DlgmdParameters.model]
    click.echo(f"Other models: {', '.join(others)}.")
    click.echo("'dlgmd sets lgmd' shows the parameters of one of them.")
    click.echo(f"Presets: {', '.join(presets.PRESETS)}; the first is the default.")


def _complete_name(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    names = [*presets.preset_names(), *presets.MODELS, *presets.PRESETS]
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


@sets.command(cls=Command)
@click.argument("name", metavar="NAME", shell_complete=_complete_name)
def show(name: str) -> None:
    """Print the parameters of NAME as YAML, for use with --config.

    \b
    Examples:
      dlgmd sets show 9                 # the paper's set 9
      dlgmd sets show flight > my.yaml  # to change, and run with --config
      dlgmd sets show lgmd              # another model

    NAME is a set (1 to 9), a preset such as flight, or a model such as lgmd or
    package.module:Class.
    """
    if ":" in name:
        find_modules_here()
    config = presets.config_of(name)
    params = presets.parameters_of(config)
    click.echo(f"# {_origin(config, params)}")
    click.echo(f"model: {params.model}")
    for key, meaning in (
        ("width_px", "width of the processed frame (px)"),
        ("model_fps", "frames a second at most, of a video"),
    ):
        click.echo(f"{f'{key}: {getattr(config, key):g}':<22} # {meaning}")
    for key, value in params.to_dict().items():
        click.echo(_line(key, value, params.specs()[key]))


def _origin(config: presets.Config, params: presets.Parameters) -> str:
    """Where parameters are from."""
    if "preset" in config.named:
        is_default = config.named["preset"] == presets.PRESETS[0]
        return f"The preset {config.label}{', the default' * is_default}."
    if "set" in config.named:
        return f"Set {config.named['set']}; Table II of {params.source}, and defaults."
    return f"{params.source}, and defaults." if params.source else "The defaults."


def _line(key: str, value: Any, spec: Spec) -> str:
    """A parameter with its meaning as a comment."""
    import yaml

    line = yaml.safe_dump({key: value}).strip()
    unit = "" if spec.unit == "–" else f" ({spec.unit})"
    symbol = "" if spec.symbol == "–" else f"{spec.symbol}: "
    return f"{line:<22} # {symbol}{spec.meaning}{unit}; {spec.allowed}"
