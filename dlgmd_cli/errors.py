"""Errors that fit on one line: what is at fault, why, and how to fix it."""

import logging
import re


def printable(text: str) -> str:
    """`text` on one line, with control characters escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def counted(n: int, noun: str) -> str:
    """A number with its noun: 0 videos, 1 video, 2 videos."""
    return f"{n} {noun}{'s' * (n != 1)}"


# An option, and commands that are quoted, whose options stay.
_OPTION = re.compile(
    r"('dlgmd [^']*')|(Invalid value for ')?(?<![\w./-])--([a-z][a-z-]*[a-z]|[xy])('?)"
)
# Arguments of the functions whose options have other names, and those that are either on or off.
_ARGUMENTS = {"format": "formats", "video": "film", "radius": "radii"}
_SWITCHES = ("overwrite", "force")


def as_arguments(text: str) -> str:
    """A text that names options, such as ``--input-fps``, with Python's arguments instead."""

    def argument(match: re.Match[str]) -> str:
        command, _, option, quote = match.groups()
        if command:
            return command
        name = _ARGUMENTS.get(option, option).replace("-", "_")
        return (f"{name}=True" if name in _SWITCHES else name) + quote * (not match[2])

    return _OPTION.sub(argument, text)


class _ForPrograms(logging.NullHandler):
    """Names arguments, not options, in messages on their way from here to a program's handlers.

    While a command runs, messages go no further than to the command's own handlers. Programs that
    do not configure logging see nothing.
    """

    def handle(self, record: logging.LogRecord) -> bool:
        """Rewrite a message in place."""
        if _LOG.propagate:
            record.msg, record.args = as_arguments(record.getMessage()), ()
        return True


_LOG = logging.getLogger("dlgmd_cli")
_LOG.addHandler(_ForPrograms())


class DlgmdError(Exception):
    """Base of every error that a user can cause or fix.

    Its texts name options as the command line writes them, and so does its `line`, which only
    commands show. As text, it names the arguments of functions.

    Parameters
    ----------
    what : str
        The thing at fault: a file, an option, a parameter.
    why : str
        What is wrong with it.
    hint : str, optional
        What to do about it.
    """

    def __init__(self, what: str, why: str, hint: str = "") -> None:
        self.what, self.why, self.hint = what, why, hint
        self.line = f"{what}: {why}. {hint}".strip() if what else f"{why}. {hint}".strip()
        super().__init__(self.line)

    def __str__(self) -> str:
        # A file may have any name.
        is_option = self.what.startswith(("--", "Invalid value for "))
        what = as_arguments(self.what) if is_option else self.what
        said = f"{what}: " if what else ""
        return f"{said}{as_arguments(f'{self.why}. {self.hint}')}".strip()

    def __reduce__(self) -> tuple[type["DlgmdError"], tuple[str, str, str]]:
        return type(self), (self.what, self.why, self.hint)


class ParameterError(DlgmdError):
    """A parameter, a preset or a configuration file that cannot be used."""


class SourceError(DlgmdError):
    """An input from which no result can be computed."""


# The extras, and the packages that each installs.
_EXTRAS = {
    "calibrate": ("optuna",),
    "cluster": ("distributed",),
    "fast": ("av", "numba"),
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
