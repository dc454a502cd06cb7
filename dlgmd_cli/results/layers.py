"""The layers of a model at chosen frames: what a contact sheet shows and what NumPy reads."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

FloatImage = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Shot:
    """One frame and the layers that a model made of it.

    Attributes
    ----------
    frame : int
        Number of the frame in the input, from 0.
    time_s : float
        Its time, in seconds.
    luminance : ndarray, shape (H, W), float32
        The frame as the model took it, 0 to 1.
    p, s, g : ndarray, shape (H, W), float32, or None
        The layers, in the model's units of them; None before they are defined.
    """

    frame: int
    time_s: float
    luminance: FloatImage
    p: FloatImage | None
    s: FloatImage | None
    g: FloatImage | None


@dataclass(frozen=True)
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
        The layers P, S and G; NaN throughout a frame where one is not defined yet.
    units : (str, str, str)
        Units of P, S and G, in words.
    label : str
        What the figure says of its origin; may be empty.
    """

    frame: npt.NDArray[np.int64]
    time_s: npt.NDArray[np.float64]
    luminance: FloatImage
    p: FloatImage
    s: FloatImage
    g: FloatImage
    units: tuple[str, str, str]
    label: str = ""

    @classmethod
    def of(
        cls, shots: Sequence[Shot], units: tuple[str, str, str], label: str = ""
    ) -> "LayerSheet":
        """The sheet of `shots`, at least one, all of the same size."""
        shape = shots[0].luminance.shape
        undefined = np.full(shape, np.nan, dtype=np.float32)

        def stack(images: list[FloatImage | None]) -> FloatImage:
            return np.stack([undefined if image is None else image for image in images])

        return cls(
            np.array([shot.frame for shot in shots], dtype=np.int64),
            np.array([shot.time_s for shot in shots], dtype=np.float64),
            stack([shot.luminance for shot in shots]),
            stack([shot.p for shot in shots]),
            stack([shot.s for shot in shots]),
            stack([shot.g for shot in shots]),
            units,
            label,
        )


def write_npz(path: Path, sheet: LayerSheet) -> None:
    """Write the arrays of `sheet` under their own names, `units` as three strings.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    np.savez_compressed(
        path,
        frame=sheet.frame,
        time_s=sheet.time_s,
        luminance=sheet.luminance,
        p=sheet.p,
        s=sheet.s,
        g=sheet.g,
        units=np.array(sheet.units),
    )
