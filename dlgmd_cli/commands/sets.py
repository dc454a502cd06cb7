"""`dlgmd sets`: list the parameter sets, or print one as YAML."""

from typing import Any

import click
from click.shell_completion import CompletionItem

from dlgmd_cli.commands.console import Command, Group, print_table
from dlgmd_cli.commands.options import find_modules_here
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters.checks import Spec, nearest
from dlgmd_cli.parameters.presets import (
    MODELS,
    PRESETS,
    Config,
    DlgmdParameters,
    find_model,
    installed_models,
    load_config,
    load_model_preset,
    load_preset,
    load_set,
    parameters_of,
    preset_names,
)

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
    cls=_Sets,
    invoke_without_command=True,
    short_help="List the sets, models and presets.",
    epilog="Example: dlgmd sets show 9 > my.yaml",
)
@click.pass_context
def sets(ctx: click.Context) -> None:
    """List the paper's parameter sets, the other models and the presets.

    'dlgmd sets 9' prints set 9, as 'dlgmd sets show 9' does.
    """
    if ctx.invoked_subcommand is not None:
        return
    specs = DlgmdParameters.specs()
    header = ("set", *(specs[key].symbol for key in _SHOWN))
    rows = []
    for name in preset_names():
        values = load_set(name).to_dict()
        rows.append((name, *(f"{values[key]:g}" for key in _SHOWN)))
    print_table(header, rows)
    keys = (f"{specs[key].symbol} {key}" for key in _SHOWN if specs[key].symbol != key)
    click.echo(f"Keys: {', '.join(keys)}. 'dlgmd sets N' shows all parameters, with units.")
    others = [name for name in MODELS if name != DlgmdParameters.model]
    click.echo(f"Other models: {', '.join(others)}.")
    click.echo("'dlgmd sets lgmd' shows the parameters of one of them.")
    click.echo(f"Presets: {', '.join(PRESETS)}; the first is the default.")


def _complete_name(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    names = [*preset_names(), *MODELS, *PRESETS]
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _paper_set(name: str) -> Config:
    """One of the paper's sets; the error names everything that `show` takes."""
    numbers, others = preset_names(), (*PRESETS, *MODELS)
    if name.removeprefix("set") not in numbers:
        near = nearest(name[:100], others)
        hint = f"Did you mean {near!r}? " if near else ""
        mend = f"{hint}Choose {numbers[0]} to {numbers[-1]}, {', '.join(others)}."
        raise ParameterError("", f"there is no set {name[:40]}", mend)
    return load_preset(name)


@sets.command(
    cls=Command,
    epilog="Example: dlgmd sets show 9 > my.yaml; dlgmd run flight.mp4 --config my.yaml",
)
@click.argument("name", metavar="NAME", shell_complete=_complete_name)
def show(name: str) -> None:
    """Print the parameters of NAME as YAML, for use with --config.

    NAME is a set (1 to 9), a preset such as flight, or a model such as lgmd or
    package.module:Class.
    """
    config, origin = _named(name)
    params = parameters_of(config)
    click.echo(f"# {origin}")
    click.echo(f"model: {params.model}")
    for key, meaning in (
        ("width_px", "width of the processed frame (px)"),
        ("model_fps", "frames a second at most, of a video"),
    ):
        click.echo(f"{f'{key}: {getattr(config, key):g}':<22} # {meaning}")
    for key, value in params.to_dict().items():
        click.echo(_line(key, value, params.specs()[key]))


def _named(name: str) -> tuple[Config, str]:
    """The parameters of that name, and where they are from; raises ParameterError."""
    if name in PRESETS:
        is_default = name == PRESETS[0]
        return load_config(name), f"The preset {name}{', the default' * is_default}."
    if name in MODELS and name != DlgmdParameters.model:
        return load_model_preset(name), f"{MODELS[name].source}, and defaults."
    if ":" in name or name in installed_models():
        if ":" in name:
            find_modules_here()
        return Config(name, model=find_model(name).model), "The defaults."
    number = name.removeprefix("set")
    return _paper_set(name), f"Set {number}; Table II of {DlgmdParameters.source}, and defaults."


def _line(key: str, value: Any, spec: Spec) -> str:
    """A parameter with its meaning as a comment."""
    import yaml

    line = yaml.safe_dump({key: value}).strip()
    unit = "" if spec.unit == "–" else f" ({spec.unit})"
    symbol = "" if spec.symbol == "–" else f"{spec.symbol}: "
    return f"{line:<22} # {symbol}{spec.meaning}{unit}; {spec.allowed}"
