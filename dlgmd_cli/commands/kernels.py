"""`dlgmd kernels`: draw the model's kernels, and write them as CSV."""

from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, show


@click.command(cls=Command, short_help="Show the kernels of a D-LGMD.")
@options.parameter_options
@options.output_options
def kernels(**arguments: Any) -> None:
    """Show the kernels of a D-LGMD: excitation, inhibition and latency.

    \b
    Examples:
      dlgmd kernels                         # of the preset flight
      dlgmd kernels --set 9 --format pdf    # of the paper's set 9, as PDF
      dlgmd kernels --set 9 --param r=4     # with another radius

    Writes OUT/kernels-NAME.csv and a figure. The CSV has one row per connection: its offset in px,
    its latency in frames, and its strengths.
    """
    from dlgmd_cli.tasks import kernels as task

    show(task.kernels(**arguments))
