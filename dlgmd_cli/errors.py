"""What can go wrong, said in one line: what, why, and how to mend it."""


def printable(text: str) -> str:
    """`text` on one line, with what a terminal would act on shown as an escape."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class DlgmdError(Exception):
    """Base of every error that a user can cause or mend.

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


class MissingExtraError(DlgmdError):
    """A package that is asked for and not installed."""


class WorkerError(DlgmdError):
    """A process that was to share the work and died."""


class FrameError(DlgmdError):
    """A frame that the model cannot take: wrong shape or type."""


class ResultError(DlgmdError):
    """A stored result that cannot be read."""


class OutputError(DlgmdError):
    """A result that cannot be written."""


class OutputExistsError(OutputError):
    """A result that stands already and may not be replaced."""
