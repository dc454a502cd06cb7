"""The kernels of a D-LGMD."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.kernels import Connections
from dlgmd_cli.parameters.facts import Value
from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import Cells
from dlgmd_cli.results.outcome import Outcome
from dlgmd_cli.tasks.call import ModelName, choose, input_options


def kernels(
    model: ModelName | None = None,
    *,
    formulation: str | None = None,
    param: Mapping[str, Value] | None = None,
    out: str | os.PathLike[str] | None = None,
    formats: Iterable[str] = (),
    dpi: int = 200,
    overwrite: bool = False,
    **options: Any,
) -> Kernels:
    """The kernels of a D-LGMD: excitation, inhibition and latency.

    Parameters
    ----------
    model, formulation, param
        The model, as in `run`.
    out : str or path, optional
        Write what `dlgmd kernels` writes into this folder, with a figure in `formats` (PNG with
        `dpi`); `overwrite` replaces earlier files.

    Returns
    -------
    Kernels
        `connections` has the arrays, `table` a row a connection; `plot` draws.

    Raises
    ------
    ParameterError
        If a parameter is not valid, or the model has no kernels.
    OutputError, OutputExistsError
        If a file cannot be written, or may not be replaced.

    Examples
    --------
    >>> kernels(9).connections.latency.shape
    (9, 9)
    """
    input_options(None, options)  # there are none: raises ParameterError
    setup = choose(model, param, formulation)
    connections = getattr(create_model(setup.params), "connections", None)
    if not isinstance(setup.params, DlgmdParameters) or connections is None:
        raise ParameterError("", f"only the D-LGMD model has kernels, not {setup.params.model}")
    result = Kernels(connections, setup.params, setup.label)
    if out is not None:
        result.save(out, formats, dpi, overwrite=overwrite)
    return result


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

    def cells(self) -> Cells:
        """The columns of the CSV, with a row a connection: offset, latency, strengths."""
        taps = self.connections
        y, x = np.indices(taps.latency.shape) - taps.radius_px
        columns = {
            "x_px": np.asarray(x),
            "y_px": np.asarray(y),
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
