"""Wrong calls, and the call that was meant."""

import os
import re
import shlex
from collections.abc import Iterable, Iterator, Sequence
from itertools import takewhile, zip_longest
from pathlib import Path

import click

from dlgmd_cli.commands.options import only_one
from dlgmd_cli.parameters.checks import meant_number, nearest

# Typographic dashes, and quotes with the plain ones that are meant.
_DASHES = "‐‑‒–—―−﹣－"
_QUOTES = str.maketrans({**dict.fromkeys("“”„‟«»″", '"'), **dict.fromkeys("‘’‚‛′", "'")})
# The arguments that are files or folders.
_FILES = ("INPUT", "INPUT...", "[INPUT]...", "FOLDER...", "LABELS.csv", "RESULT...", "SOURCE")
# Fewer names than this are meant to be several inputs.
_MAX_NAMES = 3
# The option that takes the numbers that are given to another one.
_OF_NUMBERS = {"--alarm": "--threshold", "--size": "--scale", "--model": "--set"}
# The types of options whose values have a shape.
_SHAPES = ("WxH", "WxH+X+Y", "FROM:TO")
# Command -> words of other tools for it.
_OTHER_WORDS = {
    "run": "analyze analyse process detect predict start test",
    "live": "camera webcam stream watch record",
    "batch": "folder dir all",
    "info": "probe inspect stat",
    "view": "show open page gui",
    "evaluate": "score validate benchmark",
    "sets": "list ls models presets config",
    "calibrate": "train fit tune",
    "--help": "help h man usage ? /?",
    "--version": "version v",
}


def call(ctx: click.Context, words: Iterable[str]) -> str:
    """A question that proposes a whole call of the command."""
    return f"Did you mean '{ctx.command_path} {shlex.join(words)}'?"


def is_there(word: str) -> bool:
    """Whether a word names a file or a folder."""
    return os.path.exists(word)  # noqa: PTH110, any length


def is_path(word: str) -> bool:
    """Whether a word names a file or folder, or ends as the name of a file does."""
    return bool(Path(word).suffix) or is_there(word)


# Before a command is known.


def expanded(words: Iterable[str]) -> list[str]:
    """The words with the home folder in place of `~`, which no shell expands in quotes."""
    return [
        word if is_there(word) else re.sub(r"^(--[\w-]+=)?(~[^/]*)", _home, word) for word in words
    ]


def _home(match: re.Match[str]) -> str:
    return f"{match[1] or ''}{os.path.expanduser(match[2])}"  # noqa: PTH111, of any text


def plain(words: Sequence[str]) -> list[str]:
    """The words with plain dashes and quotes in place of typographic ones at their beginning."""
    if any(word[:1].translate(_QUOTES) != word[:1] for word in words):
        line = " ".join(shlex.quote(word) if word.isascii() else word for word in words)
        try:
            words = shlex.split(line.translate(_QUOTES))
        except ValueError:  # a quote is missing
            words = [word.translate(_QUOTES).strip("\"'") for word in words]
    return [re.sub(rf"^-?[{_DASHES}][-{_DASHES}]*(?=\w)(.*)", _dashed, word) for word in words]


def _dashed(match: re.Match[str]) -> str:
    is_short = match[1][0].isdigit() or len(match[1].partition("=")[0]) == 1
    return f"{'-' if is_short else '--'}{match[1]}"


def meant_command(words: Sequence[str], commands: Sequence[str]) -> str:
    """The call that is meant by words that do not begin with one of the commands."""
    first, *others = words
    for_inputs = [_command_for(word) for word in words if word == first or not word.isdecimal()]
    for_inputs = [*filter(None, for_inputs)]
    named = next((word for word in (first.lstrip("-"), *others) if word in commands), "")
    if named and first in _OTHER_WORDS["--help"].split():
        return f"Did you mean 'dlgmd {named} --help'?"
    if named:
        others = [word for word in words if word.lstrip("-") != named]
    elif for_inputs and (first.startswith("--") or _command_for(first)):
        named, others = for_inputs[0], [*words]
    else:
        word = nearest(first.lstrip("-"), (*commands, "help", "version")) or first
        known = (name for name, known in _OTHER_WORDS.items() if {word, first} & {*known.split()})
        named = next(known, word if word in commands else "")
    others = [] if named.startswith("-") else others
    meant = f"Did you mean 'dlgmd {shlex.join([named, *others])}'?"
    return meant if named else "'dlgmd --help' lists the commands."


def _command_for(word: str) -> str:
    """The command for an input: a camera or a stream, a folder, a table, or a video."""
    if word.isdecimal() or re.match("(rtsp|rtmp|udp|tcp|https?)://", word):
        return "live"
    if Path(word).is_dir():
        return "batch"
    return ("evaluate" if word.endswith(".csv") else "run") if is_path(word) else ""


# Once the words of a command cannot be parsed.


def mended(
    ctx: click.Context, words: Sequence[str], error: click.UsageError, rest: Sequence[str] = ()
) -> str:
    """The correction of the words of a command; or empty. `rest` are unexpected arguments."""
    params = [*ctx.command.params, *ctx.find_root().command.params]
    names = {name for param in params for name in param.opts}
    for word, value in zip_longest(words, words[1:], fillvalue=""):
        name = word.partition("=")[0]
        if len(name) > 2 and not name.startswith("--") and f"-{name}" in names:
            return f"Did you mean '-{word}'?"
        if name == "--param" in names and "=" not in value and len(rest) == 1:
            return f"--param takes KEY=VALUE. Did you mean '--param {value}={rest[0]}'?"
        if len(word) > 1 and word.startswith("-") and name not in names and is_there(word):
            return call(ctx, [f"./{one}" if one == word else one for one in words])
    if isinstance(error, click.NoSuchOption):
        return _of_option(ctx, words, error.option_name)
    if isinstance(error, click.MissingParameter) and "Choose" not in error.format_message():
        if is_path(kind := str(ctx.params.get("kind", ""))):
            return f"KIND is missing. Did you mean 'dlgmd plot overview {kind}'?"
        example = re.search(rf"^ *({ctx.command_path} .*?) *(#|$)", str(ctx.command.help), re.M)
        return f"Write '{example[1]}'." if example else ""
    if isinstance(error, click.BadOptionUsage):
        metavar = next(p.make_metavar(ctx) for p in params if error.option_name in p.opts)
        return f"Write '{error.option_name} {metavar}'."
    for option, value, more in _values(ctx, words):
        if option is getattr(error, "param", None) and (meant := _of_value(ctx, option, value)):
            return meant
        extra = [word for word in more if word in {*rest, *_inputs(ctx)} and not is_there(word)]
        if rest and extra and (meant := _of_value(ctx, option, " ".join([value, *extra]))):
            return meant
    meant = of_missing_file(ctx, words, error.format_message()) or _of_names(ctx, rest)
    return meant or (_of_word(ctx, rest[0]) if len(rest) == 1 else "")


def _values(
    ctx: click.Context, words: Sequence[str]
) -> Iterator[tuple[click.Option, str, list[str]]]:
    """Each option with its value, and the words after it up to the next option."""
    for at, word in enumerate(words):
        name, equals, value = word.partition("=")
        value, *after = [value, *words[at + 1 :]] if equals else [*words[at + 1 :], ""]
        for param in ctx.command.params:
            if isinstance(param, click.Option) and name in param.opts and not param.is_flag:
                yield param, value, [*takewhile(lambda one: one[:1] not in ("-", ""), after)]


def _of_option(ctx: click.Context, words: Sequence[str], name: str) -> str:
    """The correction of an option that the command does not have; or empty."""
    key = name.lstrip("-").replace("-", "_")
    options = [param for param in ctx.command.params if "--param" in param.opts]
    if f"{key}=" in {item.value for one in options for item in one.shell_complete(ctx, key)}:
        value = re.search(rf"{re.escape(name)}[ =]+([^\s-]\S*)?", f"{' '.join(words)} ")
        return f"Did you mean '--param {key}={(value and value[1]) or 'VALUE'}'?"
    params = [*ctx.command.params, *ctx.find_root().command.params]
    if name.lower() in {one for param in params for one in param.opts}:
        return f"Did you mean {name.lower()!r}?"
    known = [one for param in params for one in param.opts if len(one) > 2]
    for option in sorted(known, key=len, reverse=True):
        glued = name.removeprefix(option).lstrip(":=")
        if name.startswith(option) and not glued[:1].isalpha():
            return f"Did you mean '{option} {glued}'?"
    if len(begun := [one for one in known if one.startswith(name) and len(name) > 3]) == 1:
        return f"Did you mean {begun[0]!r}?"
    group = ctx.find_root().command
    assert isinstance(group, click.Group)
    others = [group.get_command(ctx, other) for other in group.list_commands(ctx)]
    owners = [
        f"'dlgmd {other.name}'"
        for other in others
        if other and any(name in param.opts for param in other.params)
    ]
    if owners:
        return f"It is an option of {', '.join(owners)}."
    near = nearest(name, known, 0.7) if len(name) > 3 else None
    return f"Did you mean {near!r}?" if near else ""


def _of_value(ctx: click.Context, param: click.Option, value: str) -> str:
    """The correction of a value that an option does not take; or empty."""

    def takes(option: click.Parameter, text: str) -> bool:
        try:
            option.type.convert(text, option, ctx)
        except click.UsageError:
            return False
        return True

    name = max(param.opts, key=len)
    if is_there(value) and not isinstance(param.type, click.Path):
        return f"{name} needs a value: '{name} {param.make_metavar(ctx)} {value}'."
    if name == "--start" and (ends := re.fullmatch(r"([\d.:]+)\s*[-–,]\s*([\d.:]+)", value)):
        return f"Did you mean '--start {ends[1]} --end {ends[2]}'?"
    for meant in _similar_values(value) if param.type is not click.STRING else ():
        if meant != value and takes(param, meant):
            return f"Did you mean '{name} {meant}'?"
    parts = _parts(value if any(takes(param, part) for part in _parts(value)) else value.lower())
    if len(parts) > 1 and all(takes(param, part) for part in parts):
        each = " ".join(f"{name} {part}" for part in parts)
        if param.callback is only_one:
            return f"{name} takes one value here; 'dlgmd compare INPUT {each}' takes several."
        one = f"{name} takes one value, such as {name} {parts[0]}."
        return f"Did you mean '{each}'?" if param.multiple else one
    if re.fullmatch(r"\d*\.?\d+", value):
        others = [other for other in ctx.command.params if _OF_NUMBERS.get(name) in other.opts]
        return f"Did you mean '{_OF_NUMBERS[name]} {value}'?" if others else ""
    shaped = [other for other in ctx.command.params if getattr(other.type, "name", "") in _SHAPES]
    option = next((other.opts[0] for other in shaped if takes(other, value)), "")
    return f"Did you mean '{option} {value}'?" if option else _of_word(ctx, value)


def _of_word(ctx: click.Context, word: str) -> str:
    """The option that takes a word; or empty."""
    if word in ("yes", "true", "on", "no", "false", "off"):
        return "A flag takes no value: leave it out, or write --no-… where there is one."
    for param in ctx.command.params:
        kind = param.type
        names = kind.choices if isinstance(kind, click.Choice) else getattr(kind, "names", tuple)()
        if isinstance(param, click.Option) and word in names:
            return f"Did you mean '{max(param.opts, key=len)} {word}'?"
    return ""


def _similar_values(value: str) -> Iterator[str]:
    """What a value may have been meant to be."""
    if (number := meant_number(value)) is not None:
        yield f"{number:.12g}"
    yield from (value.lower(), re.sub(r"\s", "", value))
    yield ",".join(_parts(value))
    numbers = re.findall(r"\d+", value)
    if len(numbers) > 1 and not re.search("[a-wyz.]", value, re.IGNORECASE):
        yield "x".join(numbers)
        yield "+".join(["x".join(numbers[:2]), *(numbers[2:] or "00")])
    yield re.sub(r"^\s*(-?[\d.]+)\s*(?:,|\.\.|-|–|to)\s*", r"\1:", value)


def _parts(value: str) -> list[str]:
    """`3-6` -> 3, 4, 5, 6; `png,pdf` -> png, pdf."""
    ends = re.fullmatch(r"(\d{1,6})\s*(?:-|–|\.\.+|to)\s*(\d{1,6})", value)
    if ends and 0 < int(ends[2]) - int(ends[1]) < 100:
        return [str(number) for number in range(int(ends[1]), int(ends[2]) + 1)]
    return [part for part in re.split(r"[\s,;+&]+", value) if part]


# Once a file is missing, or there are too many.


def _of_names(ctx: click.Context, rest: Sequence[str]) -> str:
    """The correction of several names where one is taken; or empty."""
    names = [*_inputs(ctx), *rest]
    if not (len(rest) < len(names) and 0 < len(rest) < _MAX_NAMES and all(map(is_path, rest))):
        return ""
    if not is_path(names[0]):
        return f"Quote a name with spaces: '{ctx.command_path} {shlex.quote(' '.join(names))}'."
    several = f"Did you mean 'dlgmd batch {shlex.join(names)}'?"
    return f"run takes one INPUT. {several}" if ctx.info_name == "run" else ""


def _inputs(ctx: click.Context) -> list[str]:
    """The files and folders that the command was given as arguments, not as options."""
    names = [str(param.name) for param in ctx.command.params if param.metavar in _FILES]
    values = [ctx.params.get(name) or () for name in names]
    every = [value if isinstance(value, tuple) else (value,) for value in values]
    return [str(one) for value in every for one in value]


def of_missing_file(ctx: click.Context, words: Sequence[str], message: str) -> str:
    """The correction if a word that `message` quotes is a missing file; or empty."""
    for first in range(len(words)):
        for last in range(first + 2, min(first + 6, len(words)) + 1):
            name = " ".join(words[first:last])  # the shell may have split it
            if is_there(name) and not any(map(is_there, words[first:last])):
                return call(ctx, [*words[:first], name, *words[last:]])
    inputs = _inputs(ctx)
    for at, word in enumerate(words):
        option, equals, name = word.rpartition("=") if word.startswith("-") else ("", "", word)
        is_file = name in inputs or Path(name).suffix or os.sep in name
        is_quoted = name and re.search(rf"(^|'){re.escape(str(Path(name)))}[:']", message)
        if not (is_file and is_quoted) or is_there(name) or "://" in name:
            continue
        for param, value, more in _values(ctx, words):
            values = [value, *(one for one in more if not is_there(one))]
            if name in values[1:] and (meant := _of_value(ctx, param, " ".join(values))):
                return meant
        if name in inputs and name.isdecimal() and ctx.info_name != "live":
            return f"A camera is for 'dlgmd live {name}'."
        if is_there(str(ctx.params.get("kind"))):  # plot's KIND comes first
            return call(ctx, [name, *(one for one in words if one != name)])
        if name in inputs and name == "help":
            return f"Did you mean '{ctx.command_path} --help'?"
        if not name.isdecimal() and (path := _similar_path(name)):
            return call(ctx, [*words[:at], f"{option}{equals}{path}", *words[at + 1 :]])
    return ""


def _similar_path(word: str) -> str:
    """The existing path that a missing one differs from by case, suffix or a typo; or empty."""
    root, *parts = [Path(word).anchor, *Path(word).relative_to(Path(word).anchor).parts]
    found = Path(root)
    for part in parts:
        if not (found / part).exists():
            if not found.is_dir():
                return ""
            names = {one.name.casefold(): one.name for one in sorted(found.iterdir())}
            stems = {Path(name).stem: name for name in names}
            near = stems.get(part.casefold()) or nearest(part.casefold(), names, 0.8) or ""
            part = names.get(part.casefold()) or names.get(near, "")
            if not part:
                return ""
        found /= part
    return str(found)
