"""`dlgmd sets`: list the parameter sets, print one as YAML, or draw its kernels."""

from functools import partial
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, Group, print_path, print_table
from dlgmd_cli.errors import ParameterError, printable
from dlgmd_cli.parameters import presets
from dlgmd_cli.parameters.checks import Spec
from dlgmd_cli.results.files import FIGURE_FORMATS

_SHOWN = ("alpha", "beta", "lam", "sigma_e", "sigma_i", "r", "a", "t0", "kappa")


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


def _named(incomplete: str) -> list[CompletionItem]:
    names = [*presets.preset_names(), *presets.MODELS, *presets.PRESETS]
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _figure_file(ctx: click.Context, param: click.Parameter, path: Path | None) -> Path | None:
    """The file of a figure; raises BadParameter for another suffix."""
    if path is not None and path.suffix.lower()[1:] not in FIGURE_FORMATS:
        given = printable(str(path))[:80]
        raise click.BadParameter(f"{given!r} is no figure. Write kernels.png, .pdf or .svg.")
    return path


@sets.command(cls=Command)
@click.argument("name", metavar="NAME", shell_complete=lambda _, __, word: _named(word))
@click.option(
    "--plot",
    type=click.Path(path_type=Path),
    callback=_figure_file,
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
        options.find_modules_here()
    config = presets.config_of(name)
    params = presets.parameters_of(config)
    if plot is not None:
        _draw_kernels(config.label, params, plot, overwrite=overwrite)
        return
    click.echo(f"# {_origin(config, params)}")
    click.echo(f"model: {params.model}")
    for key, meaning in (
        ("width_px", "width of the processed frame (px)"),
        ("model_fps", "frames a second at most, of a video"),
    ):
        click.echo(f"{f'{key}: {getattr(config, key):g}':<22} # {meaning}")
    for key, value in params.to_dict().items():
        click.echo(_line(key, value, params.specs()[key]))


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

    options.find_modules_here()
    params = presets.parameters_of(presets.config_of(name))
    row_type(create_model(params).columns)  # raises for a name that is taken
    facts, faults = trial(params)
    for line in [*facts, *faults]:
        click.echo(f"{name}: {line}")
    if not faults:
        click.echo(f"{name}: no mistake was found")


def _draw_kernels(label: str, params: presets.Parameters, path: Path, *, overwrite: bool) -> None:
    """Write the figure of a D-LGMD's kernels; raises ParameterError for another model."""
    from dlgmd_cli.models.base import create_model
    from dlgmd_cli.results.outcome import drawn_by
    from dlgmd_cli.results.store import claimed

    taps = getattr(create_model(params), "connections", None)
    if taps is None or not isinstance(params, presets.DlgmdParameters):
        raise ParameterError("", f"only the D-LGMD model has kernels, not {params.model}")
    plot_kernels = drawn_by("sheets.plot_kernels")
    draw = partial(plot_kernels, label, taps.excitation, taps.inhibition, taps.latency)
    files = drawn_by("style.figure_files")({path.stem: draw}, (path.suffix[1:].lower(),), 200)
    with claimed(path.parent, names=files, overwrite=overwrite, named_by="plot") as claim:
        claim.write(files)
    print_path(path)


def _origin(config: presets.Config, params: presets.Parameters) -> str:
    """The origin of parameters, in words."""
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
