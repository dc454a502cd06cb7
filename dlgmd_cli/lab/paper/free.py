"""The constants of measures that the paper leaves open: one value decides, two others are tried."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple


class Free(NamedTuple):
    """A free constant: the value that decides, two others, what it is, and where it matters.

    `words` has {n} for a value, and {frames} for the noun that goes with it. What `is_reading` is
    another reading of the sentence, whose values are shown.
    """

    value: float
    others: tuple[float, float]
    words: str
    exhibits: tuple[str, ...]
    is_reading: bool = False

    def text(self, value: float) -> str:
        """One of the values in words."""
        number = f"{value:g}".replace("-", "−")
        return self.words.format(n=number, frames="frame" if value == 1 else "frames")


_FLIGHTS = ("fig13", "fig14", "fig15", "fig16", "fig17")
_ON_GROUP_1 = ("fig1", "table4-da", "ablation")
_HELD = "level held for {n} {frames}"
FREE = {
    # How long a level is held that is visible, and one that raises an alarm.
    "seen": Free(1, (2, 3), _HELD, ("fig1", *_FLIGHTS), is_reading=True),
    "alarm": Free(2, (1, 3), _HELD, ("fig1", *_FLIGHTS, "lateral"), is_reading=True),
    "approach": Free(
        30, (20, 45), "{n} {frames} of the approach", (*_ON_GROUP_1, *_FLIGHTS, "lateral")
    ),
    "contact": Free(15, (10, 20), "{n} {frames} before contact", (*_FLIGHTS, "ablation")),
    "brake": Free(10, (7, 13), "{n} {frames} before and after braking begins", ("fig14",)),
    "to_drop": Free(0.05, (0.02, 0.1), "least level of {n} before braking", ("fig14",)),
    "to_compare": Free(0.001, (0.0003, 0.003), "least level of {n} to compare", ("fig14",)),
    "t_ffi": Free(25, (15, 40), "an FFI that silences the cell from {n} grey levels", ("fig13",)),
    "onset": Free(
        0.05, (0.02, 0.1), "a response from {n} of the level", ("fig9", "fig15", "fig16")
    ),
    "silent": Free(1e-4, (1e-5, 1e-3), "silence up to {n} of the peak", ("fig9",)),
    "initial": Free(6, (4, 8), "{n} {frames} of the initial period", ("fig10",)),
    "final": Free(5, (3, 8), "{n} {frames} near the collision", ("fig10",)),
    "rise": Free(5, (3, 8), "{n} {frames} over which K rises", ("fig12",)),
    "suppressed": Free(-10, (-6, -20), "a speed suppressed from {n} dB", ("fig11",)),
    "free": Free(-3, (-1, -6), "a speed free from {n} dB", ("fig11",)),
    "active": Free(0.01, (0.005, 0.02), "a cell active from a luminance of {n}", ("fig8",)),
    "sparse": Free(4, (2, 6), "a sparse cell among at most {n} active ones", ("fig8",)),
    "looming": Free(10, (5, 15), "{n} {frames} of the looming object", ("fig8", "fig9")),
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
