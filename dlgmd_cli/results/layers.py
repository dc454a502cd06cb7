"""The layers of a model at selected frames, for figures and for NumPy."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

FloatImage = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class LayerSheet:
    """The layers of one model at n frames of one input.

    `frame` holds the frames' numbers in the input, from 0, and `time_s` their times. `luminance`,
    `p`, `s` and `g` have shape (n, H, W): the processed frames, 0 to 1, and the model's layers in
    its `units`. A layer that is not defined yet is all NaN. `label` names the input and the model
    in the figure.
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
    # Given a name instead of a file, NumPy would append .npz to the name of a temporary file.
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays, units=np.array(sheet.units))
