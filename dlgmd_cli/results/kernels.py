"""`Kernels`: excitation, inhibition and latency of a D-LGMD."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.kernels import Connections
from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import Table, table_from, write_columns
from dlgmd_cli.results.outcome import Outcome


@dataclass(frozen=True, eq=False, repr=False)
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

    FIGURES = {"kernels": "kernels.plot_kernels"}  # noqa: RUF012

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

    @property
    def columns(self) -> dict[str, npt.NDArray[Any]]:
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
        return {name: values.ravel() for name, values in columns.items()}

    @property
    def table(self) -> Table:
        """The columns of the CSV."""
        return table_from(self.columns)

    def tables(self) -> dict[str, store.Write]:
        """The function that writes the CSV."""
        return {f"{self.stem}.csv": partial(write_columns, columns=self.columns)}

    def own_files(self, formats: Any = ()) -> list[str]:  # type: ignore[override]
        """The CSV, and the figure in these formats."""
        return [f"{self.stem}.{suffix}" for suffix in ("csv", *formats)]

    def figure_names(self) -> dict[str, str]:  # type: ignore[override]
        """The figure's name, which is that of the CSV."""
        return {"kernels": self.stem}

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """Excitation, inhibition and latency."""
        return self.connections.excitation, self.connections.inhibition, self.connections.latency
