"""`Bench`: how long a model takes, in the form of the paper's Table IV."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from dlgmd_cli.results.outcome import Outcome, Shown

# Title of a column in a terminal: key of the row, format.
_SHOWN = {
    "r": ("radius", "d"),
    "scale": ("scale", "g"),
    "size": ("size", ""),
    "engine": ("engine", ""),
    "frames/s": ("frames_per_s", ".0f"),
    "core ms": ("core_ms", ".3f"),
    "decode ms": ("decode_ms", ".3f"),
    "whole ms": ("whole_ms", ".3f"),
    "120 frames s": ("whole_s", ".2f"),
    "paper s": ("paper_s", ".2f"),
    "ratio": ("ratio", ".1f"),
    "paper DA": ("paper_da", ".6g"),
}


@dataclass(eq=False, repr=False)
class Bench(Outcome):
    """How long a model takes.

    `measured` has `frames`, `decoder`, `decoding_alone_ms`, `input_wh`, `warnings`, and `rows`, one
    for each radius and scale.
    """

    TABLES = ("bench.csv",)

    measured: dict[str, Any]

    def __repr__(self) -> str:
        first = self.rows[0]
        return f"<Bench of {len(self.rows)} models: {first['frames_per_s']:.0f} frames/s at first>"

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The rows of the table."""
        return self.measured["rows"]

    def cells(self) -> dict[str, Any]:
        """The rows: radius, scale, size, engine, times, and what the paper states."""
        return {"bench.csv": ([*self.rows[0]], [[*row.values()] for row in self.rows])}

    def facts(self) -> dict[str, Any]:
        """What --json prints."""
        return {k: v for k, v in self.measured.items() if k not in ("input_wh", "warnings")}

    def shown(self) -> Iterator[Shown]:
        """The table, and how long the whole pipeline takes compared with decoding alone."""
        rows, alone_ms = self.rows, self.measured["decoding_alone_ms"]
        cells, shares = [], []
        for row in rows:
            size = f"{row['width']}x{row['height']}"
            shown = [({**row, "size": size}[key], form) for key, form in _SHOWN.values()]
            cells.append(tuple("" if v is None else format(v, form) for v, form in shown))
            if row["radius"] == rows[0]["radius"]:
                shares.append(f"{row['whole_ms'] / alone_ms:.2f} times as long at {size}")
        yield tuple(_SHOWN), cells
        yield (
            "Decoding {frames} frames of {}x{} alone takes {decoding_alone_ms:.3f} ms per frame "
            "({decoder}). ".format(*self.measured["input_wh"], **self.measured)
            + f"With r = {rows[0]['radius']}, the whole pipeline takes {', '.join(shares)}."
        )
        yield from self.paths
