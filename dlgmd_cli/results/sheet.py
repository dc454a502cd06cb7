"""`LayerSheet`: the layers of a model at some frames, for figures and files."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import FloatImage

# The arrays of a sheet, by the names of its attributes.
ARRAYS = ("frame", "time_s", "luminance", "p", "s", "g")


@dataclass(frozen=True, eq=False)
class LayerSheet:
    """The layers of one model at n frames of one input.

    `frame` holds the frames' numbers in the input, from 0, and `time_s` their times in seconds.
    `luminance`, `p`, `s` and `g` have shape (n, H, W): the processed frames, 0 to 1, and the
    model's layers in the given `units`. A layer that is not defined yet is all NaN. `label` names
    the input and the model in the figure.
    """

    frame: npt.NDArray[np.int64]
    time_s: npt.NDArray[np.float64]
    luminance: FloatImage
    p: FloatImage
    s: FloatImage
    g: FloatImage
    units: tuple[str, str, str]
    label: str

    def write(self, path: Path) -> None:
        """Write the arrays under their own names, as .npz; an OSError passes through."""
        arrays = {name: getattr(self, name) for name in ARRAYS}
        # An open file, since NumPy appends .npz to a name, such as the name of a temporary file.
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays, units=np.array(self.units))
