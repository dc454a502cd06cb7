"""Errors that fit on one line: what is at fault, why, and how to fix it."""

import logging

# Programs that do not configure logging see nothing of ours.
logging.getLogger("dlgmd_cli").addHandler(logging.NullHandler())


def printable(text: str) -> str:
    """`text` on one line, with control characters escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class DlgmdError(Exception):
    """Base of every error that a user can cause or fix.

    Parameters
    ----------
    what : str
        The thing at fault: a file, an option, a parameter.
    why : str
        What is wrong with it.
    mend : str, optional
        What to do about it.
    """

    def __init__(self, what: str, why: str, mend: str = "") -> None:
        self.what, self.why, self.mend = what, why, mend
        line = f"{what}: {why}." if what else f"{why}."
        super().__init__(f"{line} {mend}".strip())

    def __reduce__(self) -> tuple[type["DlgmdError"], tuple[str, str, str]]:
        return type(self), (self.what, self.why, self.mend)


class ParameterError(DlgmdError):
    """A parameter, a preset or a configuration file that cannot be used."""


class SourceError(DlgmdError):
    """An input from which no result can be computed."""


# What installs a package, if that is not its own name.
_EXTRAS = {
    "distributed": "'dlgmd[cluster]'",
    "jinja2": "'dlgmd[view]'",
    "numba": "'dlgmd[fast]'",
    "optuna": "'dlgmd[calibrate]'",
    "plotly": "'dlgmd[view]'",
    "pymavlink": "'dlgmd[live]'",
    "starlette": "'dlgmd[live]'",
    "uvicorn": "'dlgmd[live]'",
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
        mend = (
            f"Install it with: pip install {_EXTRAS.get(name, name)}{instead and ', or '}{instead}."
        )
        return cls(what, f"the package {name!r} {why}", mend)


class WorkerError(DlgmdError):
    """A worker process died, or a cluster cannot do the work."""


class ModelError(DlgmdError):
    """A model of one's own that raises an exception or returns something else."""


class FrameError(DlgmdError):
    """A frame of the wrong shape or type for the model."""


class ResultError(DlgmdError):
    """A stored result that cannot be read."""


class OutputError(DlgmdError):
    """A result that cannot be written."""


class OutputExistsError(OutputError):
    """A result already exists and may not be replaced."""
