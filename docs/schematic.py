"""Draw the schematic of the model, light and dark: `python docs/schematic.py [FOLDER]`."""

import sys
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

FOLDER = Path(__file__).parent / "_static"


class Look(NamedTuple):
    """Colours: ground, text, arrows, and the boxes of the input, neuron, expansion and alarm."""

    ground: str
    text: str
    arrow: str
    shared: str
    neuron: str
    expansion: str
    alarm: str


LOOKS = {
    "light": Look("#ffffff", "#111111", "#555555", "#eeeeee", "#d9ecf7", "#fbeccd", "#f9dccb"),
    "dark": Look("#131416", "#eeeeee", "#aaaaaa", "#303236", "#12415c", "#5a4208", "#6d2f08"),
}
# A box: centre x, centre y and width in tenths of a width of 560 px, the role, title and meaning.
BOXES = {
    "frame": (50, 124, 46, "shared", "frame", "grey image, one at a time"),
    "p": (25, 106, 46, "neuron", "P", "change since the last frame"),
    "e": (13, 88, 22, "neuron", "E", "excitation:\nat once, near"),
    "i": (37, 88, 22, "neuron", "I", "inhibition:\nafter a latency τ"),
    "s": (25, 70, 46, "neuron", "S", "summation: E − a · I, at least 0"),
    "g": (25, 54, 46, "neuron", "G", "grouping, 4 × 4 cells"),
    "mp": (25, 38, 46, "neuron", "MP", "membrane potential: sum of G"),
    "spikes": (25, 22, 46, "neuron", "spikes", "MP at the threshold or above"),
    "points": (76, 100, 42, "expansion", "window", "points around the\ndirection of flight"),
    "rate": (76, 74, 42, "expansion", "expansion", "rate of growth,\nand its quality q"),
    "ttc": (76, 46, 42, "expansion", "time to contact", "1 / expansion"),
    "rule": (38, 5, 48, "alarm", "rule", "one: expansion, spikes or ttc"),
    "alarm": (84, 5, 26, "alarm", "alarm", "begin, region"),
}
HEIGHT = 10
# Corners that an arrow passes, from the edge of a box to the edge of the next.
ARROWS = (
    ((38, 119), (38, 111)),
    ((68, 119), (68, 107)),
    ((13, 101), (13, 95)),
    ((37, 101), (37, 95)),
    ((13, 81), (13, 75)),
    ((37, 81), (37, 75)),
    ((25, 65), (25, 59)),
    ((25, 49), (25, 43)),
    ((25, 33), (25, 27)),
    ((25, 17), (25, 10)),
    ((76, 93), (76, 81)),
    ((76, 67), (76, 51)),
    ((58, 67), (58, 60), (51, 60), (51, 10)),
    ((76, 41), (76, 14), (57, 14), (57, 10)),
    ((62, 5), (71, 5)),
)
TALL = ("e", "i", "points", "rate")


def draw(look: Look) -> Figure:
    """The schematic in the colours of `look`."""
    figure = Figure(figsize=(5.6, 7.3), facecolor=look.ground)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, 100), ylim=(-2, 131))
    axes.axis("off")
    for corners in ARROWS:
        *_, before, end = corners
        axes.plot(*zip(*corners[:-1], strict=True), color=look.arrow, linewidth=1.4)
        arrow = {"arrowstyle": "-|>", "color": look.arrow, "linewidth": 1.4, "shrinkA": 0}
        axes.annotate("", end, before, arrowprops={**arrow, "shrinkB": 0})
    for name, (x, y, width, role, title, meaning) in BOXES.items():
        height = HEIGHT + 4 * (name in TALL)
        corner = (x - width / 2, y - height / 2)
        style = "round,pad=0,rounding_size=1.5"
        colour = getattr(look, role)
        axes.add_patch(FancyBboxPatch(corner, width, height, style, fc=colour, ec=look.arrow))
        top = y + height / 2
        axes.text(x, top - 3, title, ha="center", va="center", weight="bold", color=look.text)
        axes.text(x, top - 5, meaning, ha="center", va="top", size=10, color=look.text)
    return figure


def main(folder: Path) -> None:
    """Write model-light.svg and model-dark.svg; the same bytes each time."""
    mpl.rcParams.update({"svg.hashsalt": "dlgmd", "font.size": 11})
    for name, look in LOOKS.items():
        draw(look).savefig(folder / f"model-{name}.svg", metadata={"Date": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
