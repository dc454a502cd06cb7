"""The kernels of a D-LGMD."""

import os
from collections.abc import Iterable, Mapping
from typing import Any

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.models.kernels import connect
from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.results.layers import Kernels
from dlgmd_cli.tasks.call import ModelName, choose, input_options


def kernels(
    model: ModelName | None = None,
    *,
    formulation: str | None = None,
    param: Mapping[str, Any] | None = None,
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
    if not isinstance(setup.params, DlgmdParameters):
        raise ParameterError("", f"only the D-LGMD model has kernels, not {setup.params.model}")
    result = Kernels(connect(setup.params), setup.params, setup.label)
    if out is not None:
        result.save(out, formats, dpi, overwrite=overwrite)
    return result
