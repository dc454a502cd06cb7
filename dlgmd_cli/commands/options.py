"""Options that several commands share, and the types of their values."""

import math
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters import keys, presets
from dlgmd_cli.parameters.checks import Spec, in_argument, listed, meant_number, require_known
from dlgmd_cli.parameters.facts import Value
from dlgmd_cli.results.files import FIGURE_FORMATS, FILES, RUN, formats_of
from dlgmd_cli.video.base import parse_crop, parse_size
from dlgmd_cli.video.input_options import SPECS, parse_time

if TYPE_CHECKING:
    from dlgmd_cli.tasks.call import Setup as Setup


class Parsed(click.ParamType):
    """A value that the library parses; a ParameterError becomes click's error.

    `names` returns the words that the shell completes.
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
        """The name unchanged; click would write WXH."""
        return self.name

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """The names that begin with `incomplete`."""
        return [CompletionItem(name) for name in self.names() if name.startswith(incomplete)]


def numeric(kind: type = float, low: float = 0, high: float = math.inf, **facts: Any) -> Parsed:
    """The type of a number that is an option of the command line only."""
    return Parsed("N" if kind is int else "float", Spec(kind, low, high, **facts).parse)


def _model_names() -> tuple[str, ...]:
    return (*presets.MODELS, *presets.installed_models())


def _named_as(option: str) -> Callable[[str], str]:
    """The type of --set, --config or --model: each option takes one kind of name."""

    def parse(text: str) -> str:
        if option == "model" and (script := re.fullmatch(r"([\w./]+)\.py(?::(\w+))?", text)):
            module = script[1].removeprefix("./").replace("/", ".")
            hint = f"Write --model {module}:{script[2] or 'CLASS'}."
            raise ParameterError("", f"{text[:80]!r} is a file", hint)
        other, what = presets.kind_of_name(text)
        if other == "config" != option and not text.lower().endswith((".yaml", ".yml")):
            raise ParameterError("", f"{text[:80]!r} is a file, not a name")
        if other not in ("", option):
            raise ParameterError("", f"{text[:80]!r} is {what}", f"Write --{other} {text[:80]}.")
        if option == "model" and ":" in text:
            keys.find_modules_here()
        elif option == "model":
            require_known("model", text, _model_names())
        if option == "set":
            presets.require_preset(text)
        return text

    return parse


SIZE, FRAME = Parsed("WxH", parse_size), numeric(int, 0, 999_999_999)


def _set_names() -> tuple[str, ...]:
    return (*presets.preset_names(), *presets.PRESETS)


_SETS = Parsed("N|NAME", lambda text: [*map(_named_as("set"), listed(text))], _set_names)
_CONFIG = Parsed("FILE", _named_as("config"))
MODEL = Parsed("model", _named_as("model"), _model_names)
# Where several models may be named, "all" stands for every model of the package.
_MODELS = Parsed(
    "model",
    lambda text: [*presets.MODELS] if text == "all" else [_named_as("model")(text)],
    lambda: (*_model_names(), "all"),
)
NO_FIGURES = "none"

# Suffixes of files: a path with one of them is not a folder for results.
_ENDINGS = """
    avi bmp csv eps gif htm html jpeg jpg json mkv mov mp4 npy npz pdf png ps svg tif tiff txt webm
    webp yaml yml
"""
_OF_FILES = frozenset(f".{ending}" for ending in _ENDINGS.split())


def is_file_name(path: Path) -> bool:
    """Whether a path for results names a file, by its suffix; all others name folders."""
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
        Name of the command's argument; empty if `collect` returns arguments by name.
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
    """Keys of parameters with an equals sign; if a model is named, only the model's keys."""
    kinds = list(presets.MODELS.values())
    with suppress(ParameterError):  # no model, several models, or a model that cannot be imported
        kinds = [presets.find_model(ctx.params.get("model"))]
    specs = {key: spec for kind in kinds for key, spec in kind.specs().items()}
    return [
        CompletionItem(f"{key}=", help=spec.meaning)
        for key, spec in specs.items()
        if key.startswith(incomplete)
    ]


input_argument = click.argument("input_path", metavar="INPUT", shell_complete=complete_file)
collisions_option = click.option(
    "--collisions",
    "--labels",
    "collisions",
    type=click.Path(path_type=Path),
    metavar="LABELS.csv",
    shell_complete=complete_file,
    help="Table of the videos' collisions, as for 'dlgmd evaluate'.",
)
results_argument = click.argument(
    "paths", metavar="RESULT...", nargs=-1, required=True, type=click.Path(path_type=Path)
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
physical_option = click.option(
    "--physical", is_flag=True, help="The D-LGMD in degrees and ms; takes each frame as it is."
)

RULES_TEXT = "; ".join(f"{name}: {rule.words}" for name, rule in keys.RULES.items())


def _rule(text: str) -> str:
    """The name of a rule; `own_rule` imports that of MODULE:CLASS."""
    if meant_number(text) is not None:
        raise ParameterError("", f"{text!r} is a number", f"Write --threshold {text}.")
    if ":" not in text:
        return str(Spec(str, choices=keys.RULES).check(text))
    keys.find_modules_here()
    return text


alarm_option = click.option(
    "--alarm",
    type=Parsed(f"{'|'.join(keys.RULES)}|MODULE:CLASS", _rule, lambda: keys.RULES),
    help=f"Rule that raises an alarm. {RULES_TEXT}; --param sets these keys. MODULE:CLASS is a "
    "rule of your own.  [default: expansion for the presets, spikes for sets and models]",
)
threshold_option = click.option(
    "--threshold",
    type=numeric(low=-math.inf),
    metavar="X",
    help="Threshold of the alarm rule: expansion rate in 1/s, time to contact in s, or normalised "
    "MP of a spike.  [default: that of the model]",
)


def overrides(pairs: Iterable[str] = (), *, physical: bool = False) -> dict[str, Value]:
    """The parameters that --param and --physical change; a rule of one's own is imported."""
    values = presets.parse_overrides(pairs)
    if physical:
        values["units"] = keys.DEGREES
    if ":" in str(rule := values.get("alarm")):
        from dlgmd_cli.models.own_rules import own_rule  # imports NumPy, which is slow

        values["alarm"] = own_rule(_rule(str(rule)))
    return values


def _joined(ctx: click.Context, param: click.Parameter, values: tuple[list[str], ...]) -> Any:
    """`3,6` and `9` -> ("3", "6", "9")."""
    return tuple(name for names in values for name in names)


def _only_one_set(ctx: click.Context, param: click.Parameter, values: tuple[list[str], ...]) -> Any:
    return _only_one(ctx, param, _joined(ctx, param, values))


def _naming_options(*, many: bool) -> tuple[Option, ...]:
    """The options --set, --config and --model; with `many`, they may be repeated."""
    plural, note = ("s", " Repeatable.") if many else ("", "")
    option = partial(click.option, multiple=True, callback=None if many else _only_one)
    several = " Several as 3,6,7, or repeatable." if many else ""
    return (
        click.option(
            "--set",
            f"set_name{plural}",
            type=_SETS,
            multiple=True,
            callback=_joined if many else _only_one_set,
            metavar="N|NAME",
            help=f"The paper's set N, 1 to 9, or the preset {' or '.join(presets.PRESETS)}."
            f"{several}  [default: {presets.PRESETS[0]}]",
        ),
        option(
            "--config",
            f"config{plural}",
            type=_CONFIG,
            metavar="FILE",
            shell_complete=complete_file,
            help="YAML file: a preset of your own, or the run.yaml of a result, to repeat that "
            f"run.{note}",
        ),
        option(
            "--model",
            f"model{plural}",
            type=_MODELS if many else MODEL,
            callback=_joined if many else _only_one,
            metavar=f"[{'|'.join(presets.MODELS)}{'|all' * many}|MODULE:CLASS]",
            help="A model with its published parameters; dlgmd means set 9. A custom one is "
            f"package.module:Class.{note}{' all means every model.' if many else ''}",
        ),
    )


# The options that name one model and change single parameters.
ONE_MODEL = (*_naming_options(many=False), param_option)


def named_model(
    set_name: str | None, config: str | None, model: str | None
) -> presets.Config | None:
    """The model that --set, --config and --model name together; raises ParameterError.

    --model with a class may take its values from a file, or, for a D-LGMD, from a set.
    """
    if set_name is not None and config is not None:
        raise ParameterError("", "--set and --config exclude each other", "Give one of them.")
    if set_name is None and config is None:
        if model is None:
            return None
        with in_argument("model"):
            presets.find_model(model)
            return presets.config_of(model)
    with in_argument("config" if set_name is None else "set"):
        load = presets.load_config if set_name is None else presets.load_preset
        file = load(set_name or config or "")
    if model is None:
        return file
    with in_argument("model"):
        kind = presets.find_model(model)
    if set_name is not None and not issubclass(kind, presets.DlgmdParameters):
        hint = f"Leave out --set or --model {model}."
        raise ParameterError("", "--set works only with the D-LGMD model", hint)
    return replace(file, kind=kind)


def _model_and_param(pairs: Iterable[str], physical: bool = False, **names: Any) -> dict[str, Any]:
    return {"model": named_model(**names), "param": overrides(pairs, physical=physical)}


# The options that name one model, as the command's arguments `model` and `param`.
model_options = option_group("", _model_and_param, *ONE_MODEL, physical_option)
model_in_pixels_options = option_group("", _model_and_param, *ONE_MODEL)


def named_models(
    set_names: Iterable[str], configs: Iterable[str], models: tuple[str, ...]
) -> list[Any]:
    """The models that --set, --config and --model name, in this order, each once.

    A custom --model is joined with the file that names the model: a file alone may not import it.
    A --model that is one of the sets, as dlgmd is set 9, is named already.
    """
    sets = [named_model(name, None, None) for name in dict.fromkeys(set_names)]
    files = {path: named_model(None, path, None) for path in dict.fromkeys(configs)}
    named = {path: file.model if file else None for path, file in files.items()}
    by_config = {
        path: name if name in models and ":" in name else None for path, name in named.items()
    }
    alone = dict.fromkeys(name for name in models if name not in by_config.values())
    by_model = (named_model(None, None, name) for name in alone)
    return [
        *sets,
        *(named_model(None, path, name) for path, name in by_config.items()),
        *(model for model in by_model if model not in sets),
    ]


def setup_options(collect: Callable[..., Any], *more: Option) -> Option:
    """Options for several models: --set, --config and --model are repeatable.

    `collect` gets `set_names`, `configs`, `models` and the values of the options `more`.
    """
    return option_group("model", collect, *_naming_options(many=True), *more)


# How the input is read.


def _choice(name: str) -> click.Choice[str]:
    return click.Choice([*SPECS[name].choices], case_sensitive=False)


_IMAGE_FILE = click.Path(exists=True, dir_okay=False)
# Name of an option -> its type, the word for its value, and its help.
_INPUT: dict[str, tuple[click.ParamType, str | None, str]] = {
    "size": (SIZE, "WxH", "Scale frames to this size in px, at most that of the input, before the "
        "model gets them.  [default: the width that the model is made for, "
        f"{presets.DEFAULT_WIDTH_PX} px for the paper's sets]"),
    "scale": (Parsed("S", SPECS["scale"].parse), "S", "Scale frames by S, at most 1, in "
        "place of --size."),
    "fps": (Parsed("F", SPECS["fps"].parse), "F|all", "Process at most F frames a second, by "
        "taking every k-th frame; frames keep their times.  [default: the model's model_fps, "
        f"{presets.DEFAULT_MODEL_FPS:g}, for videos; all for images. With several models, the "
        "highest model_fps is used for all.]"),
    "start": (Parsed("TIME", parse_time), "TIME", "Start here: seconds, or HH:MM:SS.mmm."),
    "end": (Parsed("TIME", parse_time), "TIME", "Stop before this time: seconds, or HH:MM:SS.mmm."),
    "crop": (Parsed("WxH+X+Y", parse_crop), "WxH+X+Y", "Use only this part of the image; X and Y "
        "are its upper left corner in px."),
    "mask": (_IMAGE_FILE, "FILE", "Ignore the pixels that are black in this image. A mask of the "
        "input's size is cropped as the input is; other masks are scaled to the crop, or to the "
        "input."),
    "repeats": (_choice("repeats"), None, "Skip duplicate frames, or keep them.  [default: skip; "
        "keep for arrays, PNG, TIFF and lossless codecs]"),
    "input_fps": (Parsed("F", SPECS["input_fps"].parse), "F", "True frame rate of images, or of a "
        "video that states no rate, or only the rate of its playback.  [default: as stated; 30 for "
        "images]"),
    "times": (_IMAGE_FILE, "FILE", "Table with the time of each frame, one row per frame, in a "
        "column whose name or format says the unit, such as time_s, timestamp_us or hh:mm:ss."),
    "bit_depth": (Parsed("N", SPECS["bit_depth"].parse), "N", "Bits that samples really have, "
        "such as 12, in 16-bit video, images, arrays and bags.  [default: as stated]"),
    "topic": (click.STRING, "NAME", "Topic of the images in a ROS bag or MCAP file; needed if "
        "there are several."),
    "decoder": (_choice("decoder"), None, "Library that decodes videos; pyav needs the extra fast. "
        "Images are read by OpenCV, interlaced video by PyAV.  [default: opencv]"),
    "normalise": (_choice("normalise"), None, "Normalised membrane potential (MP) that the spikes "
        "follow: absolute (mp_abs), on a fixed scale; or sequence (mp_seq), the per-video min–max "
        "of the paper's figures, known only at the end.  [default: absolute]"),
    "fov": (Parsed("DEG", SPECS["fov"].parse), "DEG", "Horizontal field of view of the camera's "
        "whole image, in degrees, 1 to 170.  [default: 80]"),
    "camera_tilt": (Parsed("DEG", SPECS["camera_tilt"].parse), "DEG", "Angle of the optical "
        "axis above the direction of flight, in degrees, -45 to 45: the angle at which the camera "
        "is mounted, plus the pitch in flight (negative with the nose down). If an autopilot "
        "reports the pitch, the angle at which the camera is mounted.  [default: 0]"),
    "heading": (_IMAGE_FILE, "FILE", "Table of the direction of flight: frame,right_deg,up_deg, "
        "in degrees from the optical axis (empty for the default); for the rule corridor also "
        "speed_m_s,roll_deg,pitch_deg,yaw_deg.  [default: level with the drone]"),
}  # fmt: skip


def input_option(name: str, text: str = "") -> Option:
    """The option for a field of `InputOptions`; `text` replaces the usual help."""
    kind, metavar, usual = _INPUT[name]
    return click.option(
        f"--{name.replace('_', '-')}", name, type=kind, metavar=metavar, help=text or usual
    )


def input_options(*names: str, argument: str = "") -> Option:
    """Options for fields of `InputOptions`: one argument each, or a dict named `argument`."""
    return option_group(argument, dict, *map(input_option, names))


# How a drone stops at an alarm.


_stopping_option = partial(click.option, cls=SectionOption, section="Stop")
brake_option = _stopping_option(
    "--brake",
    metavar="HOW",
    help="Who brakes, with which distance: 'arducopter' in its mode BRAKE as it comes; "
    "'arducopter:20' with this PSC_JERK_XY; 'px4' in Hold, by its source; 'tilt' of your own "
    "controller; '1.7s', the distance over the speed; '4.6', a constant deceleration in m/s².  "
    "[default: arducopter:20]",
)
speed_option = click.option(
    "--speed-m-s",
    metavar="M/S",
    help="With the rule expansion, corridor or ttc: alarm as early as a stop from this speed by "
    "--brake needs, after a reaction of 0.1 s, but not later than at the rule's threshold.",
)
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
    brake_option,
    _stopping_option(
        "--tilt",
        type=numeric(low=5, high=45),
        metavar="DEG",
        help="Greatest tilt of your own controller, 5 to 45 degrees.  [default with tilt: 25]",
    ),
    _stopping_option(
        "--jerk",
        type=numeric(low=0.1, high=1000),
        metavar="M/S³",
        help="Growth of the deceleration of your own controller.  [default with tilt: 8]",
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


out_option = with_default(
    "-o",
    "--out",
    default="dlgmd-out",
    callback=folder_name,
    metavar="DIR",
    shell_complete=complete_folder,
    help="Folder for the results.",
)


def _formats(ctx: click.Context, param: click.Parameter, values: tuple[str, ...]) -> Any:
    """Callback: the formats; empty if one of them is `none`."""
    return () if NO_FIGURES in values else values


def _format_option(record: str = "") -> Option:
    """The option for the formats of figures, and of the other files of a record."""
    others = [one for one in FILES.get(record, ()) if {*one.formats} - {*FIGURE_FORMATS}]
    more = "".join(f" {'|'.join(one.formats)}: {one.meaning}." for one in others)
    return with_default(
        "--format",
        "formats",
        type=click.Choice([*formats_of(record), NO_FIGURES]),
        multiple=True,
        default=["png"],
        callback=_formats,
        help=f"Format of the figures, or none of them; repeatable.{more}",
    )


overwrite_option = click.option("--overwrite", is_flag=True, help="Replace earlier results.")
clips_option = folder_option(
    "--clips",
    help="Write a clip of each alarm into DIR, from 2 s before its begin to 1 s after it, such as "
    "flight-alarm1-3.97s.mp4. A clip is copied where a key frame allows that, and then begins up "
    "to 1 s earlier; otherwise the clip is encoded.",
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
# The options of what is written.
output_options = option_group("", dict, out_option, _format_option(), overwrite_option)
run_output_options = option_group("", dict, out_option, _format_option(RUN), overwrite_option)
