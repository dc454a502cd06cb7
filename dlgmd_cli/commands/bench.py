"""`dlgmd bench`: the paper's Table IV, the time the model takes, on this machine."""

import csv
import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands._console import (
    Command,
    print_json,
    print_path,
    print_table,
    progress,
    say,
    warn,
)
from dlgmd_cli.commands._input import decoder_option
from dlgmd_cli.commands._model import engine_option
from dlgmd_cli.commands._types import FiniteRange

if TYPE_CHECKING:
    from dlgmd_cli.paper.speed import Measurement, Timing

TABLE_IV_SET = 7
COLUMNS = (
    *("radius", "scale", "width", "height", "engine", "frames_per_s"),
    *("core_ms", "decode_ms", "whole_ms", "whole_s", "paper_s", "ratio"),
)


@click.command(cls=Command, epilog="Example: dlgmd bench --radius 6 --scale 1 --scale 0.25")
@click.argument("input_path", metavar="[INPUT]", required=False)
@click.option(
    "--radius",
    "radii",
    type=click.IntRange(1, 32),
    multiple=True,
    metavar="R",
    help="Radius of the kernels in px; repeatable.  [default: 6, 4, 3, 2]",
)
@click.option(
    "--scale",
    "scales",
    type=FiniteRange(min=0, min_open=True, max=1),
    multiple=True,
    metavar="S",
    help="Linear scale; repeatable.  [default: 1, 0.5, 0.25, 0.1, 0.02]",
)
@click.option(
    "--frames",
    "n_frames",
    type=click.IntRange(12, 100_000),
    default=120,
    show_default=True,
    help="How many frames to run.",
)
@click.option(
    "--repeat",
    "repeats",
    type=click.IntRange(1, 1000),
    default=3,
    show_default=True,
    help="Times that all is measured; medians are shown.",
)
@engine_option
@decoder_option
@click.option(
    "--csv",
    "csv_path",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Write the table as CSV, too.",
)
@click.option("--overwrite", is_flag=True, help="Replace an earlier CSV.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object in place of a table.")
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
    """Time the model, as the paper's Table IV does, on this machine.

    Runs set 7 with each radius at each scale over INPUT, or over a 1080p clip of a panning camera
    that it renders. Shows what a frame takes: the core (the model alone), decoding (with grey and
    resizing), and the whole, in which both go on at once.
    """
    from dlgmd_cli.paper.speed import RADII, SCALES, measure
    from dlgmd_cli.parameters import load_set

    chosen_radii = tuple(dict.fromkeys(radii)) or RADII
    chosen_scales = tuple(dict.fromkeys(scales)) or SCALES
    with _room_for(csv_path, overwrite=overwrite) as file:
        with (
            _clip(input_path, n_frames) as path,
            progress(
                "bench", repeats * len(chosen_radii) * len(chosen_scales), unit="step"
            ) as on_step,
        ):
            from dlgmd_cli.video.frames import open_video

            measured = measure(
                lambda scale: open_video(
                    path, scale=scale, max_frames=n_frames, decoder=decoder or "opencv"
                ),
                load_set(TABLE_IV_SET),
                radii=chosen_radii,
                scales=chosen_scales,
                repeats=repeats,
                engine=engine or "auto",
                on_step=on_step,
                tell=say,
            )
        for warning in measured.warnings:
            warn(f"{input_path or 'the clip'}: {warning}")
        rows = [_row(timing) for timing in measured.timings]
        _show(measured, rows, as_json=as_json)
        if file is not None:  # last, so that a full disk takes nothing but the file
            _write_csv(file, rows)
    if csv_path is not None and not as_json:
        print_path(csv_path)


@contextmanager
def _room_for(path: Path | None, *, overwrite: bool) -> Iterator[Path | None]:
    """A stand-in for the CSV, refused at once if it cannot be had."""
    if path is None:
        yield None
        return
    from dlgmd_cli.results.files import appearing, refuse_existing

    refuse_existing(path, overwrite=overwrite)
    with appearing(path, option="--csv") as (file,):
        file.touch()
        yield file


@contextmanager
def _clip(given: str | None, n_frames: int) -> Iterator[str]:
    """The input, rendered into a temporary folder unless it is given."""
    if given is not None:
        yield given
        return
    from dlgmd_cli.paper.speed import PAPER_SIZE_WH
    from dlgmd_cli.stimuli.pan import pan_frames
    from dlgmd_cli.video.writer import write_video

    with tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
        path = Path(folder) / "pan.mp4"
        shape = PAPER_SIZE_WH[1], PAPER_SIZE_WH[0]
        say(f"Rendering {n_frames} frames of {PAPER_SIZE_WH[0]}x{PAPER_SIZE_WH[1]}.")
        write_video(path, pan_frames(shape, n_frames), shape, 30.0)
        yield str(path)


def _row(timing: "Timing") -> dict[str, Any]:
    """A timing by the columns of the CSV."""
    derived = {name: getattr(timing, name) for name in ("frames_per_s", "whole_s", "ratio")}
    values = {**asdict(timing), **derived}
    return {name: values[name] for name in COLUMNS}


def _write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    from dlgmd_cli.results.cells import cell

    with path.open("w", newline="", encoding="ascii") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for row in rows:
            writer.writerow(
                value if isinstance(value, str) else cell(math.nan if value is None else value)
                for value in row.values()
            )


def _show(measured: "Measurement", rows: list[dict[str, Any]], *, as_json: bool) -> None:
    """The table, and what the whole comes to beside decoding alone."""
    alone_ms = measured.decoding_alone_ms
    if as_json:
        facts = {
            "frames": measured.n_frames,
            "decoder": measured.decoder,
            "decoding_alone_ms": alone_ms,
        }
        print_json({**facts, "rows": rows})
        return
    print_table(
        (
            *("r", "scale", "size", "engine", "frames/s", "core ms", "decode ms", "whole ms"),
            *("120 frames s", "paper s", "ratio"),
        ),
        [
            (
                str(row["radius"]),
                f"{row['scale']:g}",
                f"{row['width']}x{row['height']}",
                row["engine"],
                f"{row['frames_per_s']:.0f}",
                *(f"{row[name]:.3f}" for name in ("core_ms", "decode_ms", "whole_ms")),
                f"{row['whole_s']:.2f}",
                "" if row["paper_s"] is None else f"{row['paper_s']:.2f}",
                "" if row["ratio"] is None else f"{row['ratio']:.1f}",
            )
            for row in rows
        ],
    )
    shares = ", ".join(
        f"{row['whole_ms'] / alone_ms:.2f} at {row['width']}x{row['height']}"
        for row in rows
        if row["radius"] == rows[0]["radius"]
    )
    width, height = measured.input_wh
    click.echo(
        f"Decoding {measured.n_frames} frames of {width}x{height} alone takes {alone_ms:.3f} ms "
        f"a frame ({measured.decoder}). Beside it the whole takes, with r = {rows[0]['radius']}: "
        f"{shares}."
    )
