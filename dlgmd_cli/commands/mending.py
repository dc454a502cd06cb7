"""Wrong calls, and the call that was meant."""

import os
import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import takewhile, zip_longest
from pathlib import Path

import click

from dlgmd_cli.commands.options import only_one
from dlgmd_cli.parameters.checks import meant_number, nearest

# Typographic dashes, and quotes with the plain ones that are meant.
_DASHES = "‐‑‒–—―−﹣－"
_QUOTES = str.maketrans({**dict.fromkeys("“”„‟«»″", '"'), **dict.fromkeys("‘’‚‛′", "'")})
_A_QUOTE = re.compile("^[“”„‟«»″‘’‚‛′]")
# The first value of each command's argument, for a call without any.
_EXAMPLES = {
    "INPUT": "flight.mp4",
    "INPUT...": "flight.mp4",
    "SOURCE": "0",
    "FOLDER...": "flights",
    "LABELS.csv": "labels.csv",
    "RESULT...": "dlgmd-out/flight",
    "SCENE": "looming-cube",
    "KIND": "mp dlgmd-out/flight",
    "MODULE:CLASS": "fast:Fast",
    "NAME": "9",
}
# Of these, the arguments that are files or folders.
_FILES = ("INPUT", "INPUT...", "[INPUT]...", "FOLDER...", "LABELS.csv", "RESULT...", "SOURCE")
# Fewer names than this are meant to be several inputs.
_MAX_NAMES = 3
# The option that takes the numbers that are given to another one.
_OF_NUMBERS = {"--alarm": "--threshold", "--size": "--scale", "--model": "--set"}


_NO_COMMAND = "'dlgmd --help' lists the commands."
# Command -> words of other tools for it.
_OTHER_WORDS = {
    "run": "analyze analyse process detect predict start test exec video file",
    "live": "camera webcam cam stream watch rtsp record monitor",
    "batch": "folder dir directory all many",
    "info": "probe inspect stat describe check",
    "view": "show open page web gui ui display",
    "compare": "diff versus vs",
    "evaluate": "score validate benchmark eval",
    "plot": "draw figure graph chart",
    "sets": "list ls models presets config params parameters",
    "calibrate": "train fit tune learn optimize optimise",
    "export": "convert build compile c",
    "synth": "generate render simulate",
    "--help": "help h man usage ? /?",
    "--version": "version v",
}


def meant_command(words: Sequence[str], commands: Sequence[str]) -> str:
    """The call that is meant by words that do not begin with one of the commands."""
    first, *others = words
    named = next((word for word in others if word in commands), "")
    if named and first in _OTHER_WORDS["--help"].split():
        return f"Did you mean 'dlgmd {named} --help'?"
    if named:
        others = [word for word in words if word != named]
    elif named := next(
        filter(None, map(_command_for, words)) if _is_input(first) else iter(()), ""
    ):
        others = [*words]
    else:
        word = first.lower()
        meant = [name for name, known in _OTHER_WORDS.items() if word.lstrip("-") in known.split()]
        named = next(iter(meant), nearest(word, commands) or "")
    others = [] if named.startswith("-") else others
    return f"Did you mean 'dlgmd {shlex.join([named, *others])}'?" if named else _NO_COMMAND


def _is_input(word: str) -> bool:
    return word.startswith("--") or bool(_command_for(word))


def _command_for(word: str) -> str:
    """The command for an input: a camera or a stream, a folder, a table, or a video."""
    if word.isdecimal() or re.match("(rtsp|rtmp|udp|tcp|https?)://", word):
        return "live"
    if Path(word).is_dir():
        return "batch"
    return ("evaluate" if word.endswith(".csv") else "run") if is_path(word) else ""


def call(ctx: click.Context, words: Iterable[str]) -> str:
    """A question that proposes a whole call of the command."""
    return f"Did you mean '{ctx.command_path} {shlex.join(words)}'?"


def expanded(words: Iterable[str]) -> list[str]:
    """The words with the home folder in place of `~`, which no shell expands in quotes."""
    found = []
    for word in words:
        name, equals, value = word.rpartition("=") if word.startswith("--") else ("", "", word)
        is_home = value.startswith("~") and not os.path.exists(value)  # noqa: PTH110, any length
        found.append(f"{name}{equals}{Path(value).expanduser()}" if is_home else word)
    return found


def plain(words: Sequence[str]) -> list[str]:
    """The words with plain dashes and quotes in place of typographic ones at their beginning."""
    if any(map(_A_QUOTE.match, words)):
        line = " ".join(shlex.quote(word) if word.isascii() else word for word in words)
        try:
            words = shlex.split(line.translate(_QUOTES))
        except ValueError:  # a quote is missing
            words = [word.translate(_QUOTES).strip("\"'") for word in words]
    return [_plain_dash(word) for word in words]


def _plain_dash(word: str) -> str:
    rest = word.lstrip(f"-{_DASHES}")
    if word[:2].strip(_DASHES) == word[:2] or not rest[:1].isalnum() or is_there(word):
        return word
    is_short = rest[0].isdigit() or len(rest.partition("=")[0]) == 1
    return f"{'-' if is_short else '--'}{rest}"


def is_there(word: str) -> bool:
    """Whether a word names a file or a folder."""
    return os.path.exists(word)  # noqa: PTH110, any length


def is_path(word: str) -> bool:
    """Whether a word names a file or folder, or ends as the name of a file does."""
    return bool(Path(word).suffix) or is_there(word)


def similar_path(word: str) -> str:
    """The existing path that a missing one differs from by case, suffix or a typo; or empty."""
    found = Path(word).parent if Path(word).is_absolute() else Path()
    found = Path(found.anchor) if found.anchor else found
    for part in Path(word).parts[bool(found.anchor) :]:
        if not (found / part).exists():
            if not found.is_dir():
                return ""
            names = {one.name.casefold(): one.name for one in sorted(found.iterdir())}
            stems = {Path(name).stem: name for name in names}
            name = names.get(part.casefold()) or names.get(stems.get(part.casefold(), ""))
            name = name or names.get(nearest(part.casefold(), names, 0.8) or "")
            if name is None:
                return ""
            part = name
        found /= part
    return str(found)


def split_name(words: Sequence[str]) -> list[str]:
    """The words with the parts of a file's name joined where the shell split it; or empty."""
    for first in range(len(words)):
        for last in range(first + 2, min(first + 6, len(words)) + 1):
            name = " ".join(words[first:last])
            if is_there(name) and not any(map(is_there, words[first:last])):
                return [*words[:first], name, *words[last:]]
    return []


def of_missing_file(ctx: click.Context, words: Sequence[str], message: str) -> str:
    """The correction if a word that `message` quotes is a missing file; or empty."""
    if joined := split_name(words):
        return call(ctx, joined)
    inputs = _inputs(ctx)
    for at, word in enumerate(words):
        option, equals, name = word.rpartition("=") if word.startswith("-") else ("", "", word)
        is_input = name in inputs
        is_file = is_input or Path(name).suffix or os.sep in name
        if not (name and is_file and name in message) or is_there(name) or "://" in name:
            continue
        if is_input and name.isdecimal() and ctx.info_name != "live":
            return f"A camera is for 'dlgmd live {name}'."
        if is_input and name == "help":
            return f"Did you mean '{ctx.command_path} --help'?"
        if not name.isdecimal() and (path := similar_path(name)):
            return call(ctx, [*words[:at], f"{option}{equals}{path}", *words[at + 1 :]])
    return ""


def _inputs(ctx: click.Context) -> set[str]:
    """The files and folders that the command was given as arguments, not as options."""
    names = [param.name for param in ctx.command.params if param.metavar in _FILES]
    values = [ctx.params.get(str(name)) for name in names]
    return {
        str(one) for value in values for one in (value if isinstance(value, tuple) else [value])
    }


def mended(
    ctx: click.Context, words: Sequence[str], error: click.UsageError, rest: Sequence[str] = ()
) -> str:
    """The correction of the words of a command that cannot be parsed; or empty.

    `rest` are unexpected arguments.
    """
    params = [*ctx.command.params, *ctx.find_root().command.params]
    names = {name for param in params for name in param.opts}
    for word, value in zip_longest(words, words[1:], fillvalue=""):
        name = word.partition("=")[0]
        if len(name) > 2 and not name.startswith("--") and f"-{name}" in names:
            return f"Did you mean '-{word}'?"
        if name == "--param" and name in names and "=" not in value and len(rest) == 1:
            return f"--param takes KEY=VALUE. Did you mean '--param {value}={rest[0]}'?"
        if len(word) > 1 and word.startswith("-") and name not in names and is_there(word):
            return call(ctx, [f"./{one}" if one == word else one for one in words])
    param = getattr(error, "param", None)
    if isinstance(error, click.NoSuchOption):
        return of_option(ctx, words, error.option_name)
    if isinstance(error, click.MissingParameter):
        kind = str(ctx.params.get("kind", ""))
        if kind and is_path(kind):
            return f"KIND is missing. Did you mean 'dlgmd plot overview {kind}'?"
        example = _EXAMPLES.get(str(getattr(param, "metavar", "")))
        return (
            f"Write '{ctx.command_path} {shlex.join([*example.split(), *words])}'."
            if example
            else ""
        )
    for option, value, more in _values(ctx, words):
        if option is param and (meant := of_value(ctx, option, value)):
            return meant
        extra = [word for word in more if word in {*rest, *_inputs(ctx)} and not is_there(word)]
        if rest and extra and (meant := of_value(ctx, option, " ".join([value, *extra]))):
            return meant
    return of_missing_file(ctx, words, error.format_message()) or _of_names(ctx, rest)


def _of_names(ctx: click.Context, rest: Sequence[str]) -> str:
    """The correction of several names where one is taken; or empty."""
    first = next(iter(_inputs(ctx)), "")
    if not (first and 0 < len(rest) < _MAX_NAMES and all(map(is_path, rest))):
        return ""
    if not is_path(first):
        name = shlex.quote(" ".join([first, *rest]))
        return f"Quote a name with spaces: '{ctx.command_path} {name}'."
    several = f"Did you mean 'dlgmd batch {shlex.join([first, *rest])}'?"
    return f"run takes one INPUT. {several}" if ctx.info_name == "run" else ""


def _values(
    ctx: click.Context, words: Sequence[str]
) -> Iterator[tuple[click.Option, str, list[str]]]:
    """Each option with its value, and the words after it up to the next option."""
    options = {
        name: param
        for param in ctx.command.params
        if isinstance(param, click.Option) and not param.is_flag
        for name in param.opts
    }
    for at, word in enumerate(words):
        name, equals, value = word.partition("=")
        after = words[at + 1 :] if equals else words[at + 2 :]
        value = value if equals else "".join(words[at + 1 : at + 2])
        if name in options:
            yield options[name], value, [*takewhile(lambda one: one[:1] != "-", after)]


def of_option(ctx: click.Context, words: Sequence[str], name: str) -> str:
    """The correction of an option that the command does not have; or empty."""
    params = [*ctx.command.params, *ctx.find_root().command.params]
    known = {option for param in params for option in param.opts if option.startswith("--")}
    key = name.lstrip("-").replace("-", "_")
    options = [param for param in ctx.command.params if "--param" in param.opts]
    if f"{key}=" in {item.value for one in options for item in one.shell_complete(ctx, key)}:
        value = re.search(rf"{re.escape(name)}[ =]+([^\s-]\S*)?", f"{' '.join(words)} ")
        return f"Did you mean '--param {key}={(value and value[1]) or 'VALUE'}'?"
    plain_name = name.lower().replace("_", "-")
    if plain_name in known:
        return f"Did you mean {plain_name!r}?"
    glued = [one for one in known if name.startswith(one)]
    if glued:
        option = max(glued, key=len)
        return f"Did you mean '{option} {name.removeprefix(option).lstrip(':=') or 'VALUE'}'?"
    group = ctx.find_root().command
    assert isinstance(group, click.Group)
    others = [group.get_command(ctx, other) for other in group.list_commands(ctx)]
    owners = [
        f"'dlgmd {other.name}'"
        for other in others
        if other and any(name in param.opts for param in other.params)
    ]
    return f"It is an option of {', '.join(owners)}." if owners else ""


def of_value(ctx: click.Context, param: click.Option, value: str) -> str:
    """The correction of a value that an option does not take; or empty."""

    def takes(option: click.Parameter, text: str) -> bool:
        try:
            option.type.convert(text, option, ctx)
        except click.UsageError:
            return False
        return True

    name, is_text = max(param.opts, key=len), param.type is click.STRING
    if is_there(value) and not isinstance(param.type, click.Path):
        return f"{name} needs a value: '{name} {param.make_metavar(ctx)} {value}'."
    if name == "--start" and (ends := re.fullmatch(r"([\d.:]+)\s*[-–,]\s*([\d.:]+)", value)):
        return f"Did you mean '--start {ends[1]} --end {ends[2]}'?"
    for meant in () if is_text else _similar_values(value):
        if takes(param, meant):
            return f"Did you mean '{name} {meant}'?"
    parts = _parts(value)
    if len(parts) > 1 and all(takes(param, part) for part in parts):
        each = " ".join(f"{name} {part}" for part in parts)
        if param.callback is only_one:
            return f"{name} takes one value here; 'dlgmd compare INPUT {each}' takes several."
        if param.multiple:
            return f"Did you mean '{each}'?"
        return f"{name} takes one value, such as {name} {parts[0]}."
    others = [other for other in ctx.command.params if isinstance(other, click.Option)]
    is_number = re.fullmatch(r"\d*\.?\d+", value) is not None
    for other in others:
        option = max(other.opts, key=len)
        if option == _OF_NUMBERS.get(name) if is_number else value in _words(other):
            return f"Did you mean '{option} {value}'?" if takes(other, value) else ""
        is_shape = getattr(other.type, "name", "") in ("WxH", "WxH+X+Y", "FROM:TO")
        if is_shape and other is not param and takes(other, value):
            return f"Did you mean '{option} {value}'?"
    return ""


def _words(option: click.Parameter) -> tuple[str, ...]:
    """The words that an option takes."""
    if isinstance(option.type, click.Choice):
        return tuple(option.type.choices)
    names: Callable[[], Iterable[str]] = getattr(option.type, "names", tuple)
    return tuple(names())


def _similar_values(value: str) -> Iterator[str]:
    """What a value may have been meant to be."""
    if (number := meant_number(value)) is not None:
        yield f"{number:.12g}"
    yield value.lower()
    yield re.sub(r"\s*[,;]\s*", ",", value)
    yield ",".join(_parts(value))
    numbers = re.findall(r"\d+", value)
    if len(numbers) > 1 and not re.search("[a-wyz.]", value, re.IGNORECASE):
        yield "x".join(numbers)
        yield "+".join(["x".join(numbers[:2]), *(numbers[2:] or "00")])
    yield re.sub(r"^\s*(-?[\d.]+)\s*(?:,|\.\.|-|–|to)\s*", r"\1:", value)


def _parts(value: str) -> list[str]:
    """`3-6` -> 3, 4, 5, 6; `png,pdf` -> png, pdf."""
    ends = re.fullmatch(r"(\d{1,6})\s*(?:-|–|\.\.+|:|to)\s*(\d{1,6})", value)
    if ends and 0 < int(ends[2]) - int(ends[1]) < 100:
        return [str(number) for number in range(int(ends[1]), int(ends[2]) + 1)]
    return [part for part in re.split(r"[\s,;+&]+", value) if part]
