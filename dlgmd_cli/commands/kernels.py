"""`dlgmd kernels`: draw the model's kernels, and write them as CSV."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands.console import Command, print_path
from dlgmd_cli.commands.frame import write_files
from dlgmd_cli.commands.options import Output, output_options, parameter_options
from dlgmd_cli.parameters import DistributedParameters

if TYPE_CHECKING:
    from dlgmd_cli.models.kernels import Connections
    from dlgmd_cli.results.store import Write
    from dlgmd_cli.runs.setup import Setup


@click.command(
    cls=Command,
    short_help="Show the kernels of a D-LGMD.",
    epilog="Example: dlgmd kernels --set 9 --format pdf",
)
@parameter_options
@output_options
def kernels(setup: "Setup", output: Output) -> None:
    """Show the kernels of a D-LGMD: excitation, inhibition and latency.

    Writes OUT/kernels-NAME.csv and a figure. The CSV has one row per connection: its offset in px,
    its latency in frames, and its strengths.
    """
    params = setup.params
    if not isinstance(params, DistributedParameters):
        raise click.UsageError(f"only the D-LGMD model has kernels, not {params.model}.")
    from dlgmd_cli.models.kernels import connect
    from dlgmd_cli.results import store

    connections = connect(params)
    stem = f"kernels-{store.fitting(setup.label)}"
    version = params.latency if params.formulation == "default" else params.formulation
    if version != "bands":
        stem += f"-{version}"
    files: dict[str, Write] = {f"{stem}.csv": partial(_write_csv, connections)}
    if output.formats:
        from dlgmd_cli.plots.kernels import plot_kernels
        from dlgmd_cli.plots.style import figure_files

        kernels = connections.excitation, connections.inhibition, connections.latency
        figures = {stem: partial(plot_kernels, *kernels)}
        files |= figure_files(figures, output.formats, output.dpi)
    paths = {output.out / name: write for name, write in files.items()}
    for path in write_files(paths, overwrite=output.overwrite, locks=True):
        print_path(path)


def _write_csv(connections: "Connections", path: Path) -> None:
    import numpy as np

    from dlgmd_cli.results.csv import write_columns

    y, x = np.indices(connections.latency.shape) - connections.radius_px
    columns: dict[str, Any] = {
        "x_px": x,
        "y_px": y,
        "latency_frames": connections.latency,
        "k_e": connections.excitation,
        **{f"k_{delay}": kernel for delay, kernel in sorted(connections.inhibition.items())},
    }
    write_columns(path, {name: values.ravel() for name, values in columns.items()})
