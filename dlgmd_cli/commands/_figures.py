"""Saving figures: a Ctrl-C may spare them, and letters may be missing from their font."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dlgmd_cli.commands._console import warn
from dlgmd_cli.commands._interrupts import Interrupts


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


def save_plots(
    folder: Path,
    plots: Mapping[str, Callable[[], Any]],
    formats: tuple[str, ...],
    interrupts: Interrupts,
) -> None:
    """Draw and save every plot, by its file name without suffix, until a Ctrl-C comes."""
    from dlgmd_cli.plots.style import save_figure

    allowed = interrupts.count
    with letters_checked():
        for name, plot in plots.items():
            if interrupts.count > allowed:
                interrupts.spared_plots = True
                break
            figure = plot()
            for suffix in formats:
                save_figure(figure, folder / f"{name}.{suffix}")
