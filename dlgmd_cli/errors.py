"""Errors and warnings of one line: what is at fault, why, and how to fix it.

Texts name a function's arguments by `argument`; while a command runs, they name its options.
"""

import logging
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

# Programs that do not configure logging see nothing.
_log = logging.getLogger("dlgmd_cli")
_log.addHandler(logging.NullHandler())

# Argument -> option of the command that is running. Empty in a Python program.
_options: Mapping[str, str] = {}


def printable(text: str) -> str:
    """`text` on one line, with control characters escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def counted(n: int, noun: str) -> str:
    """A number with its noun: 0 videos, 1 video, 2 videos."""
    return f"{n} {noun}{'s' * (n != 1)}"


def argument(name: str, value: bool | int | float | str | None = None) -> str:
    """An argument as the user writes it: `overwrite=True` in Python, `--overwrite` in a command.

    `value` is the value that the text proposes.
    """
    option = _options.get(name)
    if option is None:
        return name if value is None else f"{name}={value!r}"
    return option if value is None or value is True else f"{option} {value}"


def argument_names() -> Mapping[str, str]:
    """The current names, argument -> option, for `name_arguments` in another process."""
    return _options


def name_arguments(options: Mapping[str, str]) -> None:
    """Make texts name the options of a command instead of arguments: argument -> option."""
    global _options
    _options = options


@contextmanager
def naming_arguments(options: Mapping[str, str]) -> Iterator[None]:
    """Apply `name_arguments` inside the context, while a command runs."""
    before = _options
    name_arguments(options)
    try:
        yield
    finally:
        name_arguments(before)


class DlgmdWarning(UserWarning):
    """Something that a user should know about an input or a result that could be computed."""


def warn(text: str) -> None:
    """Log a warning, and issue a `DlgmdWarning` at the user's line that called this package."""
    _log.warning("%s", text)
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("dlgmd_cli"):
        level, frame = level + 1, frame.f_back
    warnings.warn(text, DlgmdWarning, stacklevel=level)


class Once:
    """Tells which reasons are new, for messages that appear once per reason."""

    def __init__(self) -> None:
        self._known: set[str] = set()

    def is_new(self, reason: str) -> bool:
        """Whether `reason` is given for the first time."""
        is_new = reason not in self._known
        self._known.add(reason)
        return is_new


class DlgmdError(Exception):
    """Base of every error that a user can cause or fix.

    Parameters
    ----------
    what : str
        What is at fault: a file, a parameter; may be empty.
    why : str
        What is wrong.
    hint : str, optional
        How to fix the fault.
    argument : str, optional
        The argument whose value is at fault.
    """

    def __init__(self, what: str, why: str, hint: str = "", argument: str = "") -> None:
        super().__init__(what, why, hint, argument)
        self.what, self.why, self.hint, self.argument = what, why, hint, argument

    def __str__(self) -> str:
        places = (argument(self.argument), self.what, self.why)
        return f"{': '.join(filter(None, places))}. {self.hint}".strip()

    @property
    def reason(self) -> str:
        """The error without the name of what is at fault, for a line that begins with a video."""
        return f"{self.why}. {self.hint}".strip()


class ParameterError(DlgmdError):
    """A parameter, a preset or a configuration file that cannot be used."""


class SourceError(DlgmdError):
    """An input from which no result can be computed.

    Attributes
    ----------
    results : tuple of Result
        If the input is images in memory: the models' results up to the image at fault.
    """

    results: tuple[object, ...] = ()


# Extra -> the packages that the extra installs.
_EXTRAS = {
    "cluster": ("distributed",),
    "fast": ("av",),
    "lab": ("mujoco",),
    "live": ("pymavlink", "starlette", "uvicorn"),
    "pandas": ("pandas",),
    "ros": ("rosbags",),
    "view": ("jinja2", "plotly"),
}
NOT_INSTALLED = "is not installed"
# Nothing is on a package index: extras are installed from the clone.
INSTALL_EXTRA = "Install it from the clone: pip install '.[{}]'"


class MissingExtraError(DlgmdError):
    """An optional package that is needed but not installed."""

    @classmethod
    def of(
        cls, what: str, package: str | None, why: str = NOT_INSTALLED, instead: str = ""
    ) -> "MissingExtraError":
        """The error that `what` needs a package; `instead` names an option without the package."""
        name = str(package).partition(".")[0]
        extras = (INSTALL_EXTRA.format(one) for one, names in _EXTRAS.items() if name in names)
        install = next(extras, f"Install it with: pip install {name}")
        hint = f"{install}{instead and ', or '}{instead}."
        return cls(what, f"the package {name!r} {why}", hint)


class WorkerError(DlgmdError):
    """A worker process that died, or a cluster that cannot do the work."""


class ModelError(DlgmdError):
    """A custom model or rule that raises an exception or returns an invalid value."""

    @property
    def reason(self) -> str:
        """The whole error: it names the class, the method and the frame, and no video."""
        return str(self)


class FrameError(DlgmdError):
    """A frame of the wrong shape or type for the model."""


class ResultError(DlgmdError):
    """A stored result that cannot be read."""


class OutputError(DlgmdError):
    """A result that cannot be written."""


class OutputExistsError(OutputError):
    """A result that already exists and may not be replaced."""


def overwrite_hint(what: str = "it", named_by: str = "out") -> str:
    """The hint to replace `what`, or to choose another place by the argument `named_by`."""
    add = f"Add {argument('overwrite', True)} to replace {what}"
    return f"{add}, or choose another {argument(named_by)}."
