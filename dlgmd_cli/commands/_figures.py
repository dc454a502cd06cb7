"""Figures that have names in them that users gave."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from dlgmd_cli.commands._console import warn


@contextmanager
def letters_checked() -> Iterator[None]:
    """Say in one line, rather than letter by letter, that the font lacks some."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    if any(_is_of_letter(warning) for warning in caught):
        warn("the figure's font lacks some letters of the texts, and shows boxes in their place")
    for warning in caught:
        if not _is_of_letter(warning):
            warnings.warn_explicit(
                warning.message, warning.category, warning.filename, warning.lineno
            )


def _is_of_letter(warning: warnings.WarningMessage) -> bool:
    text = str(warning.message)
    return text.startswith("Glyph") or "missing from" in text
