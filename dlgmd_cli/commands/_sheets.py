"""Contact sheets of clips, drawn by whichever process renders the clip."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dlgmd_cli.results.clip_sheet import ClipSheet


def draw_sheet(sheet: "ClipSheet", path: Path) -> None:
    """Draw a sheet as PNG; OSError passes through."""
    from dlgmd_cli.plots.clip_sheet import plot_clip_sheet
    from dlgmd_cli.plots.style import save_figure

    save_figure(plot_clip_sheet(sheet), path)
