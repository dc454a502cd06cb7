"""The layers of a model at chosen frames: what a contact sheet shows and what NumPy reads."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

FloatImage = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class LayerSheet:
    """The layers of one model at n frames of one input.

    Attributes
    ----------
    frame : ndarray, shape (n,), int64
        Numbers of the frames in the input, from 0.
    time_s : ndarray, shape (n,), float64
        Their times, in seconds.
    luminance : ndarray, shape (n, H, W), float32
        The frames as the model took them, 0 to 1.
    p, s, g : ndarray, shape (n, H, W), float32
        The layers P, S and G, in the model's units of them; NaN throughout a frame where one is
        not defined yet.
    units : (str, str, str)
        Units of P, S and G, in words.
    label : str
        What the figure says of its origin.
    """

    frame: npt.NDArray[np.int64]
    time_s: npt.NDArray[np.float64]
    luminance: FloatImage
    p: FloatImage
    s: FloatImage
    g: FloatImage
    units: tuple[str, str, str]
    label: str


def write_npz(path: Path, sheet: LayerSheet) -> None:
    """Write the arrays of `sheet` under their own names; an OSError passes through."""
    arrays = {name: getattr(sheet, name) for name in ("frame", "time_s", "luminance", *"psg")}
    # Not by name: NumPy would add .npz to that of a temporary file.
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays, units=np.array(sheet.units))
