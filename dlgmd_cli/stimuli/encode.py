"""A scene as a video with its ground truth beside it; both appear whole or not at all."""

import csv
from collections.abc import Iterable
from dataclasses import fields
from fractions import Fraction
from pathlib import Path
from typing import Any

from dlgmd_cli.results.cells import cell, text_cell
from dlgmd_cli.results.files import appearing, refuse_existing
from dlgmd_cli.results.video import MAX_TICKS_PER_S, check_arrived, encode
from dlgmd_cli.sources.count import count_frames
from dlgmd_cli.stimuli.base import (
    ClipOptions,
    OptionsT,
    Scene,
    invalid,
)


def write_clip(
    scene: Scene[OptionsT],
    options: OptionsT,
    folder: Path,
    *,
    lossless: bool = False,
    overwrite: bool = False,
) -> tuple[Path, Path]:
    """Render a scene to ``folder/NAME.mp4`` and its ground truth to ``folder/NAME.csv``.

    Parameters
    ----------
    scene : Scene
        What to render.
    options : ClipOptions
        Options of that scene.
    folder : Path
        Where to; made if need be.
    lossless : bool
        Write ``NAME.avi`` in FFV1 instead, which keeps every grey level. MPEG-4 smooths noise.
    overwrite : bool
        Replace earlier files.

    Returns
    -------
    (Path, Path)
        The video and the truth.

    Raises
    ------
    ParameterError
        If the scene cannot be had with these options, or no video can hold it.
    OutputExistsError
        If a file stands there already and may not be replaced.
    OutputError
        If the files cannot be written.
    """
    n_frames = scene.n_frames(options)
    check_encodable(options, lossless=lossless)
    video = folder / f"{scene.name}{'.avi' if lossless else '.mp4'}"
    truth = folder / f"{scene.name}.csv"
    for path in (video, truth):
        refuse_existing(path, overwrite=overwrite)
    with appearing(video, truth) as (new_video, new_truth):
        encode(new_video, scene.frames(options), options.shape, options.fps, lossless=lossless)
        check_arrived(video, count_frames(new_video), n_frames)
        write_truth(new_truth, scene.truth_type, scene.truth(options))
    return video, truth


def write_truth(path: Path, columns: type, rows: Iterable[Any]) -> None:
    """Write ground truth as CSV; OSError passes through.

    Parameters
    ----------
    path : Path
        The file.
    columns : type
        The dataclass that the rows are of; its fields are the columns.
    rows : iterable
        One a frame. NaN becomes an empty cell.
    """
    names = [field.name for field in fields(columns)]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows([_cell(getattr(row, name)) for name in names] for row in rows)


def _cell(value: Any) -> str:
    """A number or text as it stands in a CSV."""
    return text_cell(value) if isinstance(value, str) else cell(value)


def check_encodable(options: ClipOptions, *, lossless: bool) -> None:
    """Raise ParameterError if a video would not keep the size or the frame rate as they are."""
    height, width = options.shape
    if height % 2 or width % 2:  # OpenCV would cut off a row or a column, silently
        raise invalid(
            "--size",
            f"{width}x{height} is odd, and a video needs an even width and height",
            f"Choose {width + width % 2}x{height + height % 2}.",
        )
    rounded = round(options.fps, 3)
    if rounded != options.fps:
        raise invalid(
            "--fps",
            f"{options.fps!r} has more than three decimals, which a video file does not keep",
            f"Choose {rounded:g}.",
        )
    if not lossless and Fraction(str(rounded)).numerator > MAX_TICKS_PER_S:
        raise invalid(
            "--fps", f"MPEG-4 cannot hold {rounded:g}", "Choose fewer decimals, or --lossless."
        )
