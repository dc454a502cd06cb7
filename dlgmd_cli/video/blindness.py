"""Blindness: images that show nothing, because they are black or always the same."""

import math

import numpy as np

from dlgmd_cli.frame import Image

# How long black or equal images must last. A cut to black, or a frame sent twice, is shorter.
BLIND_S = 0.7
# So many rows of an image are compared first.
_N_ROWS = 16
# Number of blind spans that a warning names.
_N_SHOWN = 3


class BlindSpans:
    """The times at which the images of a file show nothing, found in constant memory.

    An image is black if no sample exceeds the level of black, and frozen if every sample equals
    that of the image before. The noise of a camera prevents both, by night as well. Either must
    last for 0.7 s. Whole images are compared only while 16 of their rows are equal.

    Attributes
    ----------
    throughout : str
        `black` or `frozen` if that is so from the first image to the latest, else empty.
    """

    def __init__(self) -> None:
        self._rows: Image | None = None
        self._whole: Image | None = None
        self._first_s = self._last_s = self._since_s = math.nan
        self.throughout = self._suspected = ""
        self._spans: dict[tuple[str, float], float] = {}

    def step(self, picture: Image, time_s: float, black: int = 0) -> None:
        """Judge the next image.

        `picture` is (H, W) grey or (H, W, 3) BGR as it was decoded: reduced images may lose their
        noise. The caller may reuse the array afterwards. `time_s` is its time in seconds, and
        `black` the level of black.
        """
        rows = picture[:: max(1, len(picture) // _N_ROWS)]
        is_equal = self._is_equal(picture, rows)
        is_black = rows.max() <= black and picture.max() <= black
        suspected = "black" if is_black else "frozen" if is_equal else ""
        if suspected != self._suspected:
            # The image before the first equal one is part of the run.
            self._since_s = self._last_s if suspected == "frozen" else time_s
            self._suspected = suspected
        self._last_s = time_s
        if math.isnan(self._first_s):
            self._first_s = time_s
        self.throughout = suspected if self._since_s == self._first_s < time_s else ""
        if suspected and time_s - self._since_s >= BLIND_S:
            self._spans[suspected, self._since_s] = time_s

    @property
    def spans_s(self) -> list[tuple[float, float]]:
        """First and last time of every span, in seconds."""
        return [(since_s, end_s) for (_, since_s), end_s in self._spans.items()]

    def report(self) -> str:
        """The warning; empty if there is nothing to tell."""
        if self.throughout:
            alike = "black" if self.throughout == "black" else "the same"
            return f"nothing can be seen: all frames are {alike}"
        spans = [
            f"{kind} from {since_s:.2f} to {end_s:.2f} s"
            for (kind, since_s), end_s in self._spans.items()
        ]
        shown = spans[:_N_SHOWN] + [f"and {len(spans) - _N_SHOWN} more"] * (len(spans) > _N_SHOWN)
        return f"{', '.join(shown)}: nothing can be seen there" if spans else ""

    def _is_equal(self, picture: Image, rows: Image) -> bool:
        """Whether an image equals the one before; a change beyond its rows is seen one late."""
        if self._rows is None:
            self._rows, self._whole = rows.copy(), picture.copy()
            return False
        if not np.array_equal(rows, self._rows):
            self._rows, self._whole = rows.copy(), None
            return False
        if self._whole is None:
            self._whole = picture.copy()
        elif not np.array_equal(picture, self._whole):
            self._whole = picture.copy()
            return False
        return True
