"""The constants of measures that the paper leaves open: one value decides, two others are tried."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple


class Free(NamedTuple):
    """A free constant: the value that decides, two others, its meaning, and where it matters."""

    value: float
    others: tuple[float, float]
    meaning: str
    exhibits: tuple[str, ...]

    def text(self, value: float) -> str:
        """One of the values in words."""
        words = self.meaning.replace("frames that hold", "frame that holds")
        return f"{value:g} {words if value == 1 else self.meaning}".replace("-", "−")


_FLIGHTS = ("fig13", "fig14", "fig15", "fig16", "fig17")
_SEEN = ("fig9", "fig15", "fig16")
# What several frames hold: of a level that is visible, and of one that raises an alarm.
HELD = "frames that hold the level"
FREE = {
    "seen": Free(1, (2, 3), HELD, ("fig1", *_FLIGHTS)),
    "alarm": Free(2, (1, 3), HELD, ("fig1", *_FLIGHTS, "lateral")),
    "approach": Free(30, (20, 45), "frames of the approach", ("fig1", *_FLIGHTS, "table4-da")),
    "contact": Free(15, (10, 20), "frames before contact", _FLIGHTS),
    "brake": Free(10, (7, 13), "frames before and after braking begins", ("fig14",)),
    "to_drop": Free(0.05, (0.02, 0.1), "least level before braking", ("fig14",)),
    "to_compare": Free(0.001, (0.0003, 0.003), "least level that is compared", ("fig14",)),
    "t_ffi": Free(25, (15, 40), "grey levels at which the FFI silences the cell", ("fig13",)),
    "onset": Free(
        0.05, (0.02, 0.1), "share of the level that is a response", ("fig9", "fig15", "fig16")
    ),
    "silent": Free(1e-4, (1e-5, 1e-3), "share of the peak that is silence", ("fig9",)),
    "initial": Free(6, (4, 8), "frames of the initial period", ("fig10",)),
    "final": Free(5, (3, 8), "frames near the collision", ("fig10",)),
    "rise": Free(5, (3, 8), "frames over which K rises", ("fig12",)),
    "suppressed": Free(-10, (-6, -20), "dB at which a speed is suppressed", ("fig11",)),
    "free": Free(-3, (-1, -6), "dB at which a speed is free", ("fig11",)),
    "active": Free(0.01, (0.005, 0.02), "luminance at which a cell is active", ("fig8",)),
    "sparse": Free(4, (2, 6), "active cells around a sparse one, at most", ("fig8",)),
    "ball": Free(10, (5, 15), "frames of the ball before contact", ("fig8",)),
}
_TRIED: dict[str, float] = {}


def free(name: str) -> float:
    """A free constant: its value, or the one that is tried at the moment."""
    return _TRIED.get(name, FREE[name].value)


def frames(name: str) -> int:
    """A free constant that counts frames or cells."""
    return int(free(name))


@contextmanager
def trying(name: str, value: float) -> Iterator[None]:
    """Replace a free constant for a while; without a name, nothing is replaced."""
    if name:
        _TRIED[name] = value
    try:
        yield
    finally:
        _TRIED.pop(name, None)
