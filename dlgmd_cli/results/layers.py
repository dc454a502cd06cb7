"""`LayerResult`: the layers of a model at selected frames; and `Kernels`: its connections."""

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.frame import FloatImage
from dlgmd_cli.models.kernels import Connections
from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import Table, table_of
from dlgmd_cli.results.outcome import Outcome
from dlgmd_cli.results.record import identity_in, record_text
from dlgmd_cli.results.result import Result

_ARRAYS = ("frame", "time_s", "luminance", "p", "s", "g")


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


@dataclass(eq=False, repr=False)
class LayerResult(Outcome):
    """The layers of a model at selected frames.

    The arrays of the sheet are attributes: `frame` and `time_s`, shape (n,), and `luminance`, `p`,
    `s` and `g`, shape (n, H, W), see `LayerSheet`.

    Attributes
    ----------
    result : Result
        The response at all frames that were processed; its record lists the `frames` of the sheet.
    sheet : LayerSheet or None
        The arrays; None if no frame was asked for.
    label : str
        The model's name.
    wanted : tuple of int
        The frames that were asked for, or chosen.
    ranges : dict
        The extremes of `s` and `g` over all frames, if the whole input was run.
    renderer : callable
        Renders a film, see `film`.
    unmade : Path or None
        A film that was asked for, and is not rendered yet.
    """

    RECORD = store.LAYERS
    TABLES = store.TABLES[store.LAYERS]
    FIGURES = {"layers": "sheets.plot_layers"}  # noqa: RUF012

    result: Result
    sheet: LayerSheet | None
    label: str
    wanted: tuple[int, ...]
    ranges: dict[str, tuple[float, float]]
    renderer: Callable[..., int]
    unmade: Path | None = None

    def __getattr__(self, name: str) -> Any:
        if name not in _ARRAYS or self.sheet is None:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return getattr(self.sheet, name)

    def __repr__(self) -> str:
        shown = ", ".join(map(str, self.result.record["frames"])) or "none"
        return f"<LayerResult {self.result.name}, {self.label}: frames {shown}>"

    @property
    def warnings(self) -> list[str]:
        """Warnings about the result, one line each."""
        return self.result.warnings

    @property
    def table(self) -> Table:
        """Number and time of each frame of the sheet."""
        sheet = self._sheet()
        return table_of(_ARRAYS[:2], zip(sheet.frame, sheet.time_s, strict=True))

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """The sheet."""
        return (self._sheet(),)

    def files(
        self, formats: Iterable[str] = (), dpi: int | None = None, *, npz: bool = True, **look: Any
    ) -> dict[str, store.Write]:
        """File name -> function that writes the file: layers.npz, figures, layers.yaml."""
        arrays: dict[str, store.Write] = {"layers.npz": partial(write_npz, sheet=self._sheet())}
        return {**(arrays if npz else {}), **super().files(formats, dpi, **look)}

    def record_text(self) -> str:
        """The text of layers.yaml."""
        record = self.result.record
        return record_text(record, [record["engine"]])

    def identity(self) -> dict[str, Any]:
        """What identifies the input."""
        return identity_in(self.result.record)

    def film(
        self,
        path: str | os.PathLike[str],
        *,
        overlay: bool = False,
        overwrite: bool = False,
        progress: Any = None,
    ) -> int:
        """Write an .mp4 of the input, S, G and the MP; returns the number of frames in it.

        With `overlay`, it shows the input at full size, with the active cells tinted. The input is
        read again, and the model runs again. The stop flag cuts the film short.

        Raises
        ------
        SourceError
            If the input cannot be read again, or is too short.
        OutputError, OutputExistsError
            If the film cannot be written, or may not replace a file.
        """
        place, how = Path(path), {} if progress is None else {"progress": progress}
        n_rendered: int = self.renderer(self, place, overlay=overlay, overwrite=overwrite, **how)
        vars(self).update(paths=(*self.paths, place), n_rendered=n_rendered)
        return n_rendered

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """Whether all frames were reached, and all of a film rendered."""
        n_frames = len(self.result)
        return self.result.complete and vars(self).get("n_rendered", n_frames) == n_frames

    def kept(self) -> str:
        """What there is after an interruption."""
        if "n_rendered" in vars(self):
            of_film = f"the first {vars(self)['n_rendered']} of {len(self.result)} frames"
            return f"{self.paths[-1]} holds {of_film}"
        kept = f"{len(self.result.record['frames'])} of {len(self.wanted)} frames"
        unmade = f", no frame of {self.unmade} was rendered" if self.unmade else ""
        return f"{self.paths[0]} holds {kept}{unmade}"

    def _sheet(self) -> LayerSheet:
        if self.sheet is None:
            raise ParameterError("", "there are no layers without frames", "Give some.")
        return self.sheet


def write_npz(path: Path, sheet: LayerSheet) -> None:
    """Write the arrays of `sheet` under their own names; an OSError passes through."""
    arrays = {name: getattr(sheet, name) for name in _ARRAYS}
    # Given a name instead of a file, NumPy would append .npz to the name of a temporary file.
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays, units=np.array(sheet.units))


@dataclass(eq=False, repr=False)
class Kernels(Outcome):
    """The connections of a D-LGMD.

    Attributes
    ----------
    connections : Connections
        `excitation`, `inhibition` by delay, and `latency`, each of shape (2r + 1, 2r + 1).
    params : DlgmdParameters
        The parameters that they follow from.
    label : str
        The model's name.
    """

    FIGURES = {"kernels": "sheets.plot_kernels"}  # noqa: RUF012

    connections: Connections
    params: DlgmdParameters
    label: str

    def __repr__(self) -> str:
        side = 2 * self.connections.radius_px + 1
        return f"<Kernels of {self.label}: {side}x{side}>"

    @property
    def stem(self) -> str:
        """The name of its files without suffix."""
        stem, params = f"kernels-{store.fitting(self.label)}", self.params
        version = params.latency if params.formulation == "default" else params.formulation
        return stem if version == "bands" else f"{stem}-{version}"

    def cells(self) -> dict[str, Any]:
        """The columns of the CSV, with a row a connection: offset, latency, strengths."""
        taps = self.connections
        y, x = np.indices(taps.latency.shape) - taps.radius_px
        columns: dict[str, Any] = {
            "x_px": x,
            "y_px": y,
            "latency_frames": taps.latency,
            "k_e": taps.excitation,
            **{f"k_{delay}": kernel for delay, kernel in sorted(taps.inhibition.items())},
        }
        rows = zip(*(values.ravel().tolist() for values in columns.values()), strict=True)
        return {f"{self.stem}.csv": ([*columns], rows)}

    def figure_names(self) -> dict[str, str]:
        """The figure's name, which is that of the CSV."""
        return {"kernels": self.stem}

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """The model's name, excitation, inhibition and latency."""
        taps = self.connections
        title = self.stem.removeprefix("kernels-")
        return title, taps.excitation, taps.inhibition, taps.latency
