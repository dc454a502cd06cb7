"""`dlgmd kernels`: the model's connections as a figure and as CSV."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from dlgmd_cli.commands.console import Command, print_path
from dlgmd_cli.commands.options import Output, output_options, parameter_options
from dlgmd_cli.parameters import DlgmdParameters

if TYPE_CHECKING:
    from dlgmd_cli.models.kernels import Connections
    from dlgmd_cli.runs.run import Setup


@click.command(cls=Command, epilog="Example: dlgmd kernels --set 9 --format pdf")
@parameter_options
@output_options
def kernels(setup: "Setup", output: Output) -> None:
    """Write what a cell is connected to: excitation, inhibition, latency.

    Makes OUT/kernels-NAME.csv and a figure. The CSV has one row per tap: its place in px, its
    latency in frames, and its strengths.
    """
    params = setup.params
    if not isinstance(params, DlgmdParameters):
        raise click.UsageError(f"only the D-LGMD model has kernels, not {params.model}.")
    from dlgmd_cli.models.kernels import connect
    from dlgmd_cli.results.csv import write_rows
    from dlgmd_cli.results.store import appearing, fitting, refuse_existing

    connections = connect(params)
    stem = f"kernels-{fitting(setup.label)}"
    if params.formulation != "default":
        stem += f"-{params.formulation}"
    paths = [output.out / f"{stem}.{suffix}" for suffix in ("csv", *output.formats)]
    for path in paths:
        refuse_existing(path, overwrite=output.overwrite)
    header = ["x_px", "y_px", "latency_frames", "k_e"]
    header += [f"k_{delay}" for delay in sorted(connections.inhibition)]
    with appearing(*paths) as files:
        write_rows(files[0], header, _rows(connections))
        if output.formats:
            from dlgmd_cli.plots.kernels import plot_kernels
            from dlgmd_cli.plots.style import save_figure

            figure = plot_kernels(
                connections.excitation, connections.inhibition, connections.latency
            )
            for file in files[1:]:
                save_figure(figure, file)
    for path in paths:
        print_path(path)


def _rows(connections: "Connections") -> Iterator[list[str]]:
    """Place, latency and strengths of every tap."""
    from dlgmd_cli.results.csv import cell

    radius = connections.radius_px
    strengths = [connections.inhibition[delay] for delay in sorted(connections.inhibition)]
    for y in range(-radius, radius + 1):
        for x in range(-radius, radius + 1):
            tap = (y + radius, x + radius)
            numbers = [kernel[tap] for kernel in (connections.excitation, *strengths)]
            yield [str(x), str(y), *map(cell, [connections.latency[tap], *numbers])]
