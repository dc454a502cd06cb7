"""`dlgmd kernels`: the model's connections as a figure and as CSV."""

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dlgmd_cli.commands._console import Command, print_path
from dlgmd_cli.commands._model import ModelChoice, model_options
from dlgmd_cli.commands._types import Output, output_options

if TYPE_CHECKING:
    from dlgmd_cli.models.kernels import Connections


@click.command(cls=Command, epilog="Example: dlgmd kernels --set 9 --format pdf")
@model_options
@output_options
def kernels(choice: ModelChoice, output: Output) -> None:
    """Write what a cell is connected to: excitation, inhibition, latency.

    Makes OUT/kernels-NAME.csv and a figure. The CSV has a row a tap: its place in px, its latency
    in frames, and its strengths.
    """
    params = choice.dlgmd_params()
    from dlgmd_cli.models.kernels import connect
    from dlgmd_cli.results.files import appearing, fitting, refuse_existing

    connections = connect(params)
    stem = f"kernels-{fitting(choice.label)}"
    if params.formulation != "default":
        stem += f"-{params.formulation}"
    suffixes = ("csv", *output.formats)
    paths = [output.out / f"{stem}.{suffix}" for suffix in suffixes]
    for path in paths:
        refuse_existing(path, overwrite=output.overwrite)
    with appearing(*paths) as files:
        _write_csv(files[0], connections)
        if len(files) > 1:
            from dlgmd_cli.plots.kernels import plot_kernels
            from dlgmd_cli.plots.style import save_figure

            figure = plot_kernels(
                connections.excitation, connections.inhibition, connections.latency
            )
            for file in files[1:]:
                save_figure(figure, file)
    for path in paths:
        print_path(path)


def _write_csv(path: Path, connections: "Connections") -> None:
    from dlgmd_cli.results.cells import cell

    radius = connections.latency.shape[0] // 2
    delays = sorted(connections.inhibition)
    with path.open("w", newline="", encoding="ascii") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(
            ["x_px", "y_px", "latency_frames", "k_e", *(f"k_{delay}" for delay in delays)]
        )
        for y in range(-radius, radius + 1):
            for x in range(-radius, radius + 1):
                tap = (y + radius, x + radius)
                strengths = [connections.excitation[tap]]
                strengths += [connections.inhibition[delay][tap] for delay in delays]
                numbers = [connections.latency[tap], *strengths]
                writer.writerow([x, y, *(cell(number) for number in numbers)])
