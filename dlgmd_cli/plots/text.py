"""Text that others wrote, made fit for a figure."""

from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

from dlgmd_cli.errors import printable

_ELLIPSIS = "…"


def plain(text: str) -> str:
    """`text` as it is to be drawn, on one line: its dollar signs start no formula."""
    return printable(text).replace("$", r"\$")


def text_width_in(text: str, size_pt: float) -> float:
    """Width of `text` as a figure shows it, in inches."""
    properties = FontProperties(size=size_pt)
    width_pt, _, _ = text_to_path.get_text_width_height_descent(text, properties, ismath=False)
    return float(width_pt) / 72


def shortened(text: str, width_in: float, size_pt: float) -> str:
    """As much of both ends of `text` as is no wider than `width_in`; all of it where it fits."""
    text = printable(text)
    # No character of note is narrower than a fortieth of an inch; long texts need no measuring.
    kept = min(len(text), max(2, int(width_in * 40)))
    candidate = text
    while kept < len(text) or text_width_in(candidate, size_pt) > width_in:
        candidate = text[: kept - kept // 2] + _ELLIPSIS + text[len(text) - kept // 2 :]
        if kept <= 2 or text_width_in(candidate, size_pt) <= width_in:
            break
        kept -= 1
    return candidate
