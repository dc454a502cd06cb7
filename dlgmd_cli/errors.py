"""Errors and warnings that fit on one line: what is at fault, why, and how to fix it.

Texts name the arguments of functions by `argument`. While a command runs, they are its options.
"""

import logging
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

# Programs that do not configure logging see nothing.
_log = logging.getLogger("dlgmd_cli")
_log.addHandler(logging.NullHandler())

# What a command that is running calls the arguments: name -> option. Empty in a Python program.
_options: Mapping[str, str] = {}


def printable(text: str) -> str:
    """`text` on one line, with control characters escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def counted(n: int, noun: str) -> str:
    """A number with its noun: 0 videos, 1 video, 2 videos."""
    return f"{n} {noun}{'s' * (n != 1)}"


def argument(name: str, value: bool | int | float | str | None = None) -> str:
    """An argument as the user writes it, for a text: `overwrite=True`, or a command's option.

    `value` is one that the text proposes.
    """
    option = _options.get(name)
    if option is None:
        return name if value is None else f"{name}={value!r}"
    return option if value is None or value is True else f"{option} {value}"


def argument_names() -> Mapping[str, str]:
    """What arguments are called now, for `name_arguments` in another process."""
    return _options


def name_arguments(options: Mapping[str, str]) -> None:
    """Let texts call arguments by other names: those of a command's options."""
    global _options
    _options = options


@contextmanager
def naming_arguments(options: Mapping[str, str]) -> Iterator[None]:
    """Do so in a context, while a command runs."""
    before = _options
    name_arguments(options)
    try:
        yield
    finally:
        name_arguments(before)


class DlgmdWarning(UserWarning):
    """What a user should know about an input or a result, although it could be computed."""


def warn(text: str) -> None:
    """Log a warning, and issue it as a `DlgmdWarning` of the line that called this package."""
    _log.warning("%s", text)
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("dlgmd_cli"):
        level, frame = level + 1, frame.f_back
    warnings.warn(text, DlgmdWarning, stacklevel=level)


class Once:
    """Tells which reasons are new, for messages that are given once for each."""

    def __init__(self) -> None:
        self._known: set[str] = set()

    def is_new(self, reason: str) -> bool:
        """Whether a reason comes for the first time."""
        is_new = reason not in self._known
        self._known.add(reason)
        return is_new


class DlgmdError(Exception):
    """Base of every error that a user can cause or fix.

    Parameters
    ----------
    what : str
        The thing at fault: a file, a parameter; may be empty.
    why : str
        What is wrong with it.
    hint : str, optional
        What to do about it.
    argument : str, optional
        The argument whose value is at fault.
    """

    def __init__(self, what: str, why: str, hint: str = "", argument: str = "") -> None:
        super().__init__(what, why, hint, argument)
        self.what, self.why, self.hint, self.argument = what, why, hint, argument

    def __str__(self) -> str:
        places = (argument(self.argument), self.what, self.why)
        return f"{': '.join(filter(None, places))}. {self.hint}".strip()


class ParameterError(DlgmdError):
    """A parameter, a preset or a configuration file that cannot be used."""


class SourceError(DlgmdError):
    """An input from which no result can be computed.

    Attributes
    ----------
    results : tuple of Result
        Of images in memory, the results of the models up to the image at fault.
    """

    results: tuple[object, ...] = ()


# The extras, and the packages that each installs.
_EXTRAS = {
    "cluster": ("distributed",),
    "fast": ("av", "numba"),
    "lab": ("mujoco",),
    "live": ("pymavlink", "starlette", "uvicorn"),
    "pandas": ("pandas",),
    "ros": ("rosbags",),
    "view": ("jinja2", "plotly"),
}
NOT_INSTALLED = "is not installed"


class MissingExtraError(DlgmdError):
    """An optional package that is needed but not installed."""

    @classmethod
    def of(
        cls, what: str, package: str | None, why: str = NOT_INSTALLED, instead: str = ""
    ) -> "MissingExtraError":
        """The error for what needs a package, or `instead` of it another option."""
        name = str(package).partition(".")[0]
        extras = (f"'dlgmd[{extra}]'" for extra, names in _EXTRAS.items() if name in names)
        hint = f"Install it with: pip install {next(extras, name)}{instead and ', or '}{instead}."
        return cls(what, f"the package {name!r} {why}", hint)


class WorkerError(DlgmdError):
    """A worker process died, or a cluster cannot do the work."""


class ModelError(DlgmdError):
    """A custom model that raises an exception or returns something else."""


class FrameError(DlgmdError):
    """A frame of the wrong shape or type for the model."""


class ResultError(DlgmdError):
    """A stored result that cannot be read."""


class OutputError(DlgmdError):
    """A result that cannot be written."""


class OutputExistsError(OutputError):
    """A result already exists and may not be replaced."""


def overwrite_hint(what: str = "it", named_by: str = "out") -> str:
    """The hint that something may be replaced, or another place chosen by an argument."""
    add = f"Add {argument('overwrite', True)} to replace {what}"
    return f"{add}, or choose another {argument(named_by)}."
