"""Options that several commands share, and the types of their values."""

import math
import os
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters import presets
from dlgmd_cli.parameters.checks import Spec, in_argument
from dlgmd_cli.parameters.facts import Value
from dlgmd_cli.parameters.keys import RULES
from dlgmd_cli.video.base import parse_size
from dlgmd_cli.video.options import DECLARED, Declared, File

if TYPE_CHECKING:
    from dlgmd_cli.tasks.call import Setup as Setup


class Parsed(click.ParamType):
    """A value that the library parses; a ParameterError becomes click's error.

    `names` gives the words to complete.
    """

    def __init__(
        self, name: str, parse: Callable[[str], Any], names: Callable[[], Iterable[str]] = tuple
    ) -> None:
        self.name, self.parse, self.names = name, parse, names

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """`480x270` -> (480, 270), for example."""
        try:
            return self.parse(str(value))
        except ParameterError as error:
            self.fail(str(error), param, ctx)

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        """The name as it is; click would write WXH."""
        return self.name

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """The names that match."""
        return [CompletionItem(name) for name in self.names() if name.startswith(incomplete)]


def numeric(kind: type = float, low: float = 0, high: float = math.inf, **facts: Any) -> Parsed:
    """The type of a number that only the command line takes."""
    return Parsed("N" if kind is int else "float", Spec(kind, low, high, **facts).parse)


def _model_names() -> tuple[str, ...]:
    return (*presets.MODELS, *presets.installed_models())


def _model(text: str) -> str:
    """A model's name, which is looked up later."""
    if ":" in text:
        find_modules_here()
    return text


def find_modules_here() -> None:
    """Let Python find modules in the working folder, once the command line names one.

    Not before: else a file there would be taken for an optional package that is not installed. And
    last, so that no file there replaces a library.
    """
    here = os.path.abspath("")
    if here not in sys.path:
        sys.path.append(here)


SIZE, FRAME = Parsed("WxH", parse_size), numeric(int, 0, 999_999_999)
_SET = Parsed("set", str, lambda: (*presets.preset_names(), *presets.PRESETS, *_model_names()))
MODEL = Parsed("model", _model, _model_names)
# Formats of figures.
FORMATS = ("png", "pdf", "svg")


# Suffixes of files, which no folder for results has.
_ENDINGS = """
    avi bmp csv eps gif htm html jpeg jpg json mkv mov mp4 npy npz pdf png ps svg tif tiff txt webm
    webp yaml yml
"""
_OF_FILES = frozenset(f".{ending}" for ending in _ENDINGS.split())


def is_file_name(path: Path) -> bool:
    """Whether a path for results is that of a file, by its suffix; any other is a folder."""
    return path.suffix.lower() in _OF_FILES


def folder_name(ctx: click.Context, param: click.Parameter, value: Any) -> Any:
    """Callback of options that name a folder: raises BadParameter for the name of a file."""
    if value is None:
        return None
    text = str(value)
    if not text.strip():
        raise click.BadParameter("must not be empty. Give the name of a folder.", ctx, param)
    if is_file_name(Path(text)):
        shown, stem = text[:80], Path(text).stem[:80]
        why = f"{shown!r} is the name of a file. Give a folder for the files, such as {stem!r}."
        raise click.BadParameter(why, ctx, param)
    return value


def distinct(ctx: click.Context, param: click.Parameter, values: tuple[Any, ...]) -> Any:
    """The values of an option whose names must be distinct and not empty."""
    names = [value if isinstance(value, str) else value[0] for value in values]
    if not all(name.strip() for name in names):
        raise click.BadParameter("must not be empty.", ctx, param)
    for name in names:
        if names.count(name) > 1:
            raise click.BadParameter(f"{name[:40]!r} is given twice.", ctx, param)
    return values


def file_ending(example: str) -> Callable[[str], Path]:
    """The type of a path that must end as `example` does."""

    def convert(value: str) -> Path:
        path, suffix = Path(value), Path(example).suffix
        if path.suffix.lower() != suffix:
            raise click.BadParameter(f"{value[:80]!r} does not end in {suffix}. Write {example}.")
        return path

    return convert


Option = Callable[[Any], Any]


class SectionOption(click.Option):
    """An option in a given section of the help."""

    def __init__(self, *args: Any, section: str, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.section = section


def option_group(argument: str, collect: Callable[..., Any], *options: Option) -> Option:
    """One decorator for several options, which the command receives as one argument.

    Parameters
    ----------
    argument : str
        Name of the command's argument; empty for one that `collect` names itself, or several.
    collect : callable
        Called with the options' values by name; returns the argument, or arguments by name.
    options : click.option decorators
        In the order of the help.
    """

    def bare() -> None: ...

    for option in options:
        option(bare)
    parameters: list[click.Parameter] = bare.__click_params__  # type: ignore[attr-defined]
    names = [str(parameter.name) for parameter in parameters if parameter.expose_value]

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def collecting(*arguments: Any, **values: Value) -> Any:
            collected = collect(**{name: values.pop(name) for name in names})
            return command(
                *arguments, **values, **({argument: collected} if argument else collected)
            )

        for option in reversed(options):
            option(collecting)
        return collecting

    return decorate


# Completion in the shell.


complete_file = click.Path().shell_complete
complete_folder = click.Path(file_okay=False).shell_complete


def complete_key(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Keys of parameters with an equals sign; if a model is named, only its own."""
    kinds = list(presets.MODELS.values())
    with suppress(ParameterError):  # none is named, several are, or it cannot be imported
        kinds = [presets.find_model(ctx.params.get("model"))]
    specs = {key: spec for kind in kinds for key, spec in kind.specs().items()}
    return [
        CompletionItem(f"{key}=", help=spec.meaning)
        for key, spec in specs.items()
        if key.startswith(incomplete)
    ]


def complete_config(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Presets whose names match, otherwise files."""
    names = [name for name in presets.PRESETS if incomplete and name.startswith(incomplete)]
    return [CompletionItem(name) for name in names] or complete_file(ctx, param, incomplete)


input_argument = click.argument("input_path", metavar="INPUT", shell_complete=complete_file)
collisions_option = click.option(
    "--collisions",
    "--labels",
    "collisions",
    type=click.Path(path_type=Path),
    metavar="LABELS.csv",
    shell_complete=complete_file,
    help="Table of collisions, as for 'dlgmd evaluate'; those of the video count.",
)
results_argument = click.argument(
    "paths", metavar="RESULT...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
optional_input_argument = click.argument(
    "input_path", metavar="[INPUT]", required=False, shell_complete=complete_file
)
inputs_argument = click.argument(
    "inputs", metavar="[INPUT]...", nargs=-1, shell_complete=complete_file
)

# The model and its parameters.


def _only_one(ctx: click.Context, param: click.Parameter, values: tuple[Value, ...]) -> Any:
    """The value of an option; raises UsageError if it is given more than once."""
    if len(values) > 1:
        raise click.UsageError(
            f"{param.opts[0]} is given {len(values)} times, but this command runs one model. "
            "'dlgmd compare' and 'dlgmd batch' run several.",
            ctx,
        )
    return values[0] if values else None


param_option = click.option(
    "--param",
    "pairs",
    multiple=True,
    metavar="KEY=VALUE",
    shell_complete=complete_key,
    help="Change one parameter, such as r=4; repeatable. 'dlgmd sets show 9' lists them.",
)


alarm_option = click.option(
    "--alarm",
    type=click.Choice(RULES),
    expose_value=False,
    callback=lambda ctx, _, value: ctx.meta.update(alarm=value),
    help="Rule that raises an alarm: n_sp spikes in a row, an expansion of expansion_alarm or "
    "more, or a time to contact of ttc_alarm or less; --param sets these keys.  [default: "
    "expansion for the presets, spikes for sets and models]",
)


def overrides(pairs: Iterable[str] = ()) -> dict[str, Value]:
    """What --param and --alarm change."""
    rule = click.get_current_context().meta.get("alarm")
    return presets.parse_overrides(pairs) | ({"alarm": rule} if rule else {})


formulation_option = click.option(
    "--formulation",
    type=click.Choice([*presets.FORMULATIONS]),
    help="Whose version of the D-LGMD: ours, that of the authors' code of 2021 or of 2020, or that "
    "of the equations. The page 'The model' of the documentation "
    "compares them.  [default: default]",
)
engine_option = click.option(
    "--engine",
    type=click.Choice(presets.ENGINES),
    help="Library that computes the D-LGMD; numba needs dlgmd[fast].  "
    "[default: numba for large frames if installed, else opencv]",
)


def _naming_options(*, many: bool) -> list[Option]:
    """The options --set, --config and --model; they may be repeated if there can be `many`."""
    plural, note = ("s", " Repeatable.") if many else ("", "")
    option = partial(click.option, multiple=True, callback=None if many else _only_one)
    return [
        option(
            "--set",
            f"set_name{plural}",
            type=_SET,
            metavar="N",
            help=f"The paper's set N, 1 to 9; like --config and --model, it takes every name that "
            f"'dlgmd sets' lists.{note}",
        ),
        option(
            "--config",
            f"config{plural}",
            type=click.Path(path_type=Path),
            metavar="FILE",
            shell_complete=complete_config,
            help="YAML file of parameters, or the name of a preset. The run.yaml of a result "
            f"repeats its run.{note}  [default: {presets.PRESETS[0]}]",
        ),
        option(
            "--model",
            f"model{plural}",
            type=MODEL,
            metavar=f"[{'|'.join(presets.MODELS)}|MODULE:CLASS]",
            help="A model with its published parameters; dlgmd means set 9. A custom one is "
            f"package.module:Class.{note}",
        ),
    ]


CHANGES = (param_option, alarm_option, formulation_option)
ONE_MODEL = (*_naming_options(many=False), *CHANGES)


def named_model(
    set_name: str | None, config: str | os.PathLike[str] | None, model: str | None
) -> presets.Config | None:
    """What --set, --config and --model name together; raises ParameterError.

    A custom --model may have the values of a file, or of a set if it is a D-LGMD.
    """
    if set_name is not None and config is not None:
        raise ParameterError("", "--set and --config exclude each other", "Give one of them.")
    option, name = ("set", set_name) if set_name is not None else ("config", config)
    if name is None:
        with in_argument("model"):
            return None if model is None else presets.config_of(model)
    with in_argument(option):
        # What has no suffix can be a name.
        file = presets.config_of(name if Path(name).suffix else os.fspath(name))
    if model is None:
        return file
    with in_argument("model"):
        kind = presets.find_model(model)
    if set_name is not None and not issubclass(kind, presets.DlgmdParameters):
        hint = f"Leave out --set or --model {model}."
        raise ParameterError("", "--set works only with the D-LGMD model", hint)
    return replace(file, kind=kind)


def setup_of(
    set_name: str | None,
    config: Path | None,
    pairs: tuple[str, ...],
    model: str | None,
    formulation: str | None,
    engine: str | None = None,
) -> "Setup":
    """The model that the options of `ONE_MODEL` name."""
    from dlgmd_cli.tasks.call import choose  # brings in NumPy

    return choose(named_model(set_name, config, model), overrides(pairs), formulation, engine)


model_options = option_group("model", setup_of, *ONE_MODEL, engine_option)
parameter_options = option_group("model", setup_of, *ONE_MODEL)


def named_models(
    set_names: Iterable[str], configs: Iterable[Path], models: tuple[str, ...]
) -> list[Any]:
    """What --set, --config and --model name, in this order, each once.

    A custom --model belongs to a file that names it, which could not import it by itself.
    """
    files = {path: named_model(None, path, None) for path in dict.fromkeys(configs)}
    named = {path: file.model if file else None for path, file in files.items()}
    by_config = {
        path: name if name in models and ":" in name else None for path, name in named.items()
    }
    return [
        *(named_model(name, None, None) for name in dict.fromkeys(set_names)),
        *(named_model(None, path, name) for path, name in by_config.items()),
        *(named_model(None, None, n) for n in dict.fromkeys(models) if n not in by_config.values()),
    ]


def setup_options(collect: Callable[..., Any], *more: Option) -> Option:
    """Options for several models: --set, --config and --model are repeatable.

    `collect` gets `set_names`, `configs`, `models` and the values of the options `more`.
    """
    return option_group("model", collect, *_naming_options(many=True), *more)


# How the input is read.


def value_type(option: Declared) -> click.ParamType:
    """The type of the value of an option of `InputOptions`."""
    kind = option.kind
    if isinstance(kind, File):
        return click.Path(exists=True, dir_okay=False)
    if isinstance(kind, Spec) and kind.kind is bool:
        return click.BOOL
    if isinstance(kind, Spec) and kind.kind is str and kind.choices:
        return click.Choice(kind.choices)
    return Parsed(option.metavar or "", kind.parse)


def input_option(name: str) -> Option:
    """The option for a field of `InputOptions`."""
    option = DECLARED[name]
    return click.option(
        option.flags or f"--{name.replace('_', '-')}",
        name,
        type=value_type(option),
        metavar=option.metavar,
        default=None,
        help=option.help,
    )


INPUT = tuple(input_option(name) for name, option in DECLARED.items() if option.common)
input_options = option_group("", dict, *INPUT)
_LIVE = tuple(input_option(name) for name, option in DECLARED.items() if option.live)
live_input_options = option_group("given", dict, *_LIVE)

# How a drone stops at an alarm.


_stopping_option = partial(click.option, cls=SectionOption, section="Stop")
stopping_options = option_group(
    "",
    dict,
    _stopping_option(
        "--react",
        type=numeric(high=10),
        default=0.1,
        show_default=True,
        metavar="S",
        help="Time from an alarm to the first command.",
    ),
    _stopping_option(
        "--brake",
        type=numeric(low=0.1, high=100),
        metavar="M/S²",
        help="Deceleration at once, 0.1 to 100, in place of --tilt and --jerk.",
    ),
    _stopping_option(
        "--tilt",
        type=numeric(low=5, high=45),
        metavar="DEG",
        help="How far a stabilised drone tilts, 5 to 45 degrees.  [default: 25]",
    ),
    _stopping_option(
        "--jerk",
        type=numeric(low=0.1, high=1000),
        metavar="M/S³",
        help="How fast the deceleration of a stabilised drone grows.  [default: 8]",
    ),
)

# Output.


with_default = partial(click.option, show_default=True)
folder_option = partial(
    click.option,
    type=click.Path(file_okay=False, path_type=Path),
    callback=folder_name,
    metavar="DIR",
)


def _output(formats: tuple[str, ...], no_plots: bool, **more: Any) -> dict[str, Any]:
    """Where the results go, and their figures, by the arguments of a task."""
    return {"formats": () if no_plots else formats, **more}


out_option = with_default(
    "-o",
    "--out",
    default="dlgmd-out",
    callback=folder_name,
    metavar="DIR",
    shell_complete=complete_folder,
    help="Folder for the results.",
)
format_option = with_default(
    "--format",
    "formats",
    type=click.Choice(FORMATS),
    multiple=True,
    default=["png"],
    help="Format of the figures; repeatable.",
)
dpi_option = with_default(
    "--dpi",
    type=numeric(int, 50, 1200),
    default=200,
    help="Resolution of PNG figures, in dots per inch.",
)
no_plots_option = click.option("--no-plots", is_flag=True, help="Draw no figures.")
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace earlier results.")
clips_option = folder_option(
    "--clips",
    help="Write a clip of each alarm into DIR, from 2 s before its begin to 1 s after, such as "
    "flight-alarm1-3.97s.mp4. It is copied where a key frame allows that, and then begins up to "
    "1 s earlier; otherwise it is encoded.",
)
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object instead of tables."
)
jobs_option = click.option(
    "--jobs",
    type=numeric(int, 1, 512),
    help="Number of processes that share the work.  [default: all processors]",
)
width_option = with_default(
    "--width",
    type=click.Choice(["one", "two"]),
    default="one",
    help="Width of the figures, in columns of a paper.",
)
_OUTPUT = (out_option, format_option, dpi_option, no_plots_option)
place_options = option_group("", _output, *_OUTPUT)
output_options = option_group("", _output, *_OUTPUT, overwrite_option)
report_options = option_group("", _output, *_OUTPUT, overwrite_option, width_option)
