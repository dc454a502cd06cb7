"""`dlgmd bench`: the computing times of the paper's Table IV, measured on this machine."""

from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands.console import Command, print_json, print_path, print_table, tell, warn
from dlgmd_cli.commands.options import (
    decoder_option,
    engine_option,
    json_option,
    numeric,
    optional_input_argument,
    overwrite_option,
)
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.parameters import load_set

# Title of a column: key of the row, format.
_COLUMNS = {
    "r": ("radius", "d"),
    "scale": ("scale", "g"),
    "size": ("size", ""),
    "engine": ("engine", ""),
    "frames/s": ("frames_per_s", ".0f"),
    "core ms": ("core_ms", ".3f"),
    "decode ms": ("decode_ms", ".3f"),
    "whole ms": ("whole_ms", ".3f"),
    "120 frames s": ("whole_s", ".2f"),
    "paper s": ("paper_s", ".2f"),
    "ratio": ("ratio", ".1f"),
    "paper DA": ("paper_da", ".6g"),
}


@click.command(cls=Command, epilog="Example: dlgmd bench --radius 6 --scale 1 --scale 0.25")
@optional_input_argument
@click.option(
    "--radius",
    "radii",
    type=numeric(int, 1, 32),
    multiple=True,
    metavar="R",
    help="Radius of the kernels in px; repeatable.  [default: 6, 4, 3, 2]",
)
@click.option(
    "--scale",
    "scales",
    type=numeric(low_open=True, high=1),
    multiple=True,
    metavar="S",
    help="Scale of the processed frames; repeatable.  [default: 1, 0.5, 0.25, 0.1, 0.02]",
)
@click.option(
    "--frames",
    "n_frames",
    type=numeric(int, 12, 100_000),
    default=120,
    show_default=True,
    metavar="N",
    help="Number of frames to process.",
)
@click.option(
    "--repeat",
    "repeats",
    type=numeric(int, 1, 1000),
    default=3,
    show_default=True,
    metavar="N",
    help="How often each measurement is repeated; medians are shown.",
)
@engine_option
@decoder_option
@click.option(
    "--csv",
    "csv_path",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Also write the table to a CSV file.",
)
@overwrite_option
@json_option
def bench(
    input_path: str | None,
    radii: tuple[int, ...],
    scales: tuple[float, ...],
    n_frames: int,
    repeats: int,
    engine: str | None,
    decoder: str | None,
    csv_path: Path | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Measure how long the model takes, as in the paper's Table IV.

    Runs set 7 with each radius at each scale over INPUT, or over a rendered 1080p clip of a panning
    camera. Shows the time per frame of the core (the model alone), of decoding (with conversion to
    grey and scaling), and of the whole pipeline, in which both run in parallel.
    """
    from dlgmd_cli.lab import benchmark as paper
    from dlgmd_cli.results.csv import write_values
    from dlgmd_cli.results.store import refuse_existing, replacing
    from dlgmd_cli.video.base import DEFAULT_DECODER
    from dlgmd_cli.video.opening import open_video

    radii = tuple(dict.fromkeys(radii)) or paper.RADII
    scales = tuple(dict.fromkeys(scales)) or paper.SCALES
    with ExitStack() as opened:
        if csv_path is not None:  # an unwritable folder fails at once, not after minutes
            refuse_existing(csv_path, overwrite=overwrite, option="--csv")
            stage = opened.enter_context(replacing(csv_path.parent, option="--csv"))
        clip = input_path
        if clip is None:
            tell("Rendering {} frames of {}x{}.".format(n_frames, *paper.PAPER_SIZE_WH))
            clip = opened.enter_context(paper.rendered_pan(n_frames))
        with progress("bench", repeats * len(radii) * len(scales), "step") as on_step:
            measured = paper.measure(
                partial(open_video, clip, max_frames=n_frames, decoder=decoder or DEFAULT_DECODER),
                load_set(paper.TABLE_IV_SET),
                radii=radii,
                scales=scales,
                repeats=repeats,
                engine=engine or "auto",
                on_step=on_step,
            )
        for warning in measured["warnings"]:
            warn(f"{input_path or 'the clip'}: {warning}")
        if as_json:
            print_json({k: v for k, v in measured.items() if k not in ("input_wh", "warnings")})
        else:
            _show(measured)
        rows = measured["rows"]
        if csv_path is not None:
            write_values(stage / csv_path.name, [*rows[0]], ([*row.values()] for row in rows))
    if csv_path is not None and not as_json:
        print_path(csv_path)


def _show(measured: dict[str, Any]) -> None:
    """Print the table, and how long the whole pipeline takes compared with decoding alone."""
    rows, alone_ms = measured["rows"], measured["decoding_alone_ms"]
    cells, shares = [], []
    for row in rows:
        size = f"{row['width']}x{row['height']}"
        shown = [({**row, "size": size}[key], form) for key, form in _COLUMNS.values()]
        cells.append(tuple("" if value is None else format(value, form) for value, form in shown))
        if row["radius"] == rows[0]["radius"]:
            shares.append(f"{row['whole_ms'] / alone_ms:.2f} times as long at {size}")
    print_table(tuple(_COLUMNS), cells)
    width, height = measured["input_wh"]
    click.echo(
        f"Decoding {measured['frames']} frames of {width}x{height} alone takes {alone_ms:.3f} ms "
        f"per frame ({measured['decoder']}). With r = {rows[0]['radius']}, the whole pipeline "
        f"takes {', '.join(shares)}."
    )
