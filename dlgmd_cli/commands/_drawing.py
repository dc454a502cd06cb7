"""Drawing the plots of a result, which a Ctrl-C may spare."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from dlgmd_cli.commands._interrupts import Interrupts

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save_plots(
    folder: Path,
    plots: "Mapping[str, Callable[[], Figure]]",
    formats: tuple[str, ...],
    interrupts: Interrupts,
) -> None:
    """Draw and save every plot, by its file name without suffix, until a Ctrl-C comes."""
    from dlgmd_cli.plots.style import save_figure

    allowed = interrupts.count
    for name, plot in plots.items():
        if interrupts.count > allowed:
            break
        figure = plot()
        for suffix in formats:
            save_figure(figure, folder / f"{name}.{suffix}")
