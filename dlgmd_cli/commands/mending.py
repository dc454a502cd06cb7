"""Wrong calls, and the call that was meant.

A wrong call is changed in a few ways; the first changed call that can be parsed is proposed.
"""

import os
import re
import shlex
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import click

from dlgmd_cli.parameters.checks import nearest

# The most words that a name with spaces is put together from.
_MOST_WORDS = 6
_HELP = ("help", "version")


def is_there(word: str) -> bool:
    """Whether a word names a file or a folder."""
    return os.path.exists(word)  # noqa: PTH110, any length


def plain(words: Sequence[str]) -> list[str]:
    """The words with the home folder in place of a quoted `~`, and plain dashes before options."""
    return [word if is_there(word) else _plain(word) for word in words]


def _plain(word: str) -> str:
    word = re.sub("^-?[‐‑‒–—―]+(?=[a-z]{2})", "--", word)
    word = re.sub("^[‐‑‒–—―](?=[a-z])", "-", word)
    at_home = re.fullmatch(r"(--[\w-]+=)?(~(?:/.*)?)", word)
    return f"{at_home[1] or ''}{Path(at_home[2]).expanduser()}" if at_home else word


def meant_command(words: Sequence[str], commands: Sequence[str]) -> str:
    """The call that is meant by words that do not begin with one of the commands."""
    first = words[0].lstrip("-").lower()
    is_input = bool(_command_for(words[0]))
    known = () if is_input else _HELP if words[0].startswith("-") else (*commands, *_HELP)
    near = nearest(first, known)
    named = next((word for word in (first, *words) if word in commands), "")
    paths = [word for word in words if not word.isdecimal()]
    by_input = next(filter(None, map(_command_for, [*paths, *words])), "")
    if near in _HELP:
        meant = [*filter(None, [named]), f"--{near}"]
    elif named:
        meant = [named, *(words[1:] if first == named else (w for w in words if w != named))]
    elif near:
        meant = [near, *words[1:]]
    elif by_input:
        meant = [by_input, *(words if is_input or words[0].startswith("-") else words[1:])]
    else:
        return "Write 'dlgmd run flight.mp4'; 'dlgmd --help' lists the commands."
    return f"Did you mean 'dlgmd {shlex.join(meant)}'?"


def _command_for(word: str) -> str:
    """The command for an input: a camera or a stream, a folder, or a file; empty for others."""
    if word.isdecimal() or re.match(r"(rtsp|rtmp|udp|tcp|https?)://", word):
        return "live"
    if Path(word).is_dir():
        return "batch"
    return "run" if Path(word).suffix or is_there(word) else ""


def meant_call(ctx: click.Context, words: Sequence[str], wrong: Collection[str]) -> str:
    """The call of a command that `words` mean, of which some are `wrong`; empty if none is found.

    Options that the command does not have are wrong, too.
    """
    params = [*ctx.command.params, *ctx.find_root().command.params]
    options = {name: one for one in params if isinstance(one, click.Option) for name in one.opts}
    for at, word in enumerate(words):
        changed: Iterable[list[str]] = ()
        if word.startswith("-") and word.partition("=")[0] not in options:
            changed = _for_option(ctx, words, at, options)
        elif word in wrong:
            changed = _for_word(words, at, options)
        for call in changed:
            if _can_be_parsed(ctx, call):
                return f"Did you mean '{ctx.command_path} {shlex.join(call)}'?"
    return ""


def _can_be_parsed(ctx: click.Context, words: Sequence[str]) -> bool:
    if {*words} & {*ctx.help_option_names}:
        return True
    trial = click.Context(ctx.command, ctx.parent, ctx.info_name, allow_extra_args=True)
    with trial.scope(cleanup=False):
        try:
            return not click.Command.parse_args(ctx.command, trial, [*words])
        except click.UsageError:
            return False


def _for_option(
    ctx: click.Context, words: Sequence[str], at: int, options: Mapping[str, click.Option]
) -> Iterator[list[str]]:
    """The words with others in place of an unknown option: `-set`, `--set9`, `-dash.mp4`."""
    before, word, after = words[:at], words[at], words[at + 1 :]
    name, equals, value = word.partition("=")
    if is_there(word):
        yield [*before, f"./{word}", *after]
    key = name.lstrip("-").replace("-", "_")
    param = options.get("--param")
    if param and f"{key}=" in {item.value for item in param.shell_complete(ctx, key)}:
        values = [value, *after] if equals else after
        yield [*before, "--param", f"{key}={values[0] if values else 'VALUE'}", *values[1:]]
    for option in sorted(options, key=len, reverse=True):
        if name.startswith(option) and len(option) > 2:
            yield [*before, option, word.removeprefix(option).lstrip(":="), *after]
    if near := nearest(f"--{name.lstrip('-')}", options):
        yield [*before, f"{near}{equals}{value}", *after]


def _for_word(
    words: Sequence[str], at: int, options: Mapping[str, click.Option]
) -> Iterator[list[str]]:
    """The words with others in place of a wrong one: `my flight.mp4`, `fov=90`, `--set 3 9`."""
    before, word, after = words[:at], words[at], words[at + 1 :]
    for first in range(at + 1):
        for end in range(at + 1, min(first + _MOST_WORDS, len(words)) + 1):
            if end - first > 1 and is_there(name := " ".join(words[first:end])):
                yield [*words[:first], name, *words[end:]]
    if f"--{word.partition('=')[0]}" in (*options, "--help"):
        yield [*before, f"--{word}", *after]
    name = before[-1] if before else ""
    if name in options and options[name].multiple:  # the value of an option
        each = [(name, part) for part in word.split(",")]
        yield [*before[:-1], *(text for pair in each for text in pair), *after]
    name = before[-2] if at > 1 else ""
    if name in options and options[name].multiple:  # after the value of an option
        is_assigned = "=" in str(options[name].metavar)
        more = [f"{before[-1]}={word}"] if is_assigned else [before[-1], name, word]
        yield [*before[:-1], *more, *after]
    yield [*before, "--set", word, *after]
