"""`dlgmd layers`: show a model's layers as a contact sheet, as arrays, or as a film."""

import math
import os
import re
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli import cancel
from dlgmd_cli.commands.console import Command, print_path, say, warn
from dlgmd_cli.commands.frame import job
from dlgmd_cli.commands.options import (
    FRAME,
    Output,
    collisions_option,
    file_ending,
    input_argument,
    input_options,
    model_options,
    output_options,
)
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.errors import SourceError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from dlgmd_cli.frame import Frame
    from dlgmd_cli.models.base import Response
    from dlgmd_cli.plots.film import Film
    from dlgmd_cli.plots.overlay import Overlay
    from dlgmd_cli.results.layers import LayerSheet
    from dlgmd_cli.results.result import Result
    from dlgmd_cli.results.store import Write
    from dlgmd_cli.runs.layers import LayerRun
    from dlgmd_cli.runs.setup import Setup
    from dlgmd_cli.video.source import Video

    Steps = Iterator[tuple[Frame, list[Response]]]

# More frames are not readable at the width of two columns of a paper.
MAX_FRAMES = 12


def _frame_numbers(value: str) -> tuple[int, ...]:
    """`65, 1,50` -> (1, 50, 65)."""
    parts = [part.strip() for part in value.split(",")]
    for part in parts:
        if re.fullmatch(r"\d{1,9}", part, re.ASCII) is None:
            raise click.BadParameter(f"{part[:40]!r} is not a frame number. Write 1,50,65.")
    frames = tuple(sorted({int(part) for part in parts}))
    if len(frames) > MAX_FRAMES:
        raise click.BadParameter(
            f"{len(frames)} frames are too many for one sheet. Choose up to {MAX_FRAMES}."
        )
    return frames


@click.command(
    cls=Command,
    short_help="Show the layers P, S and G of a model.",
    epilog="Example: dlgmd layers flight.mp4 --frames 1,50,65,75,80 --video layers.mp4",
)
@input_argument
@click.option(
    "--frames",
    "wanted",
    type=_frame_numbers,
    metavar="N,N,…",
    help="Frames to show, counted from 0.  [default, without --video: those with the strongest "
    "responses, spread out, none after a known collision]",
)
@click.option(
    "--collision-frame",
    type=FRAME,
    metavar="N",
    help="Frame of the true collision.  [default: that of a rendered flight, from its YAML]",
)
@collisions_option
@click.option("--npz", is_flag=True, help="Also write the layers of these frames as NumPy arrays.")
@click.option(
    "--video",
    "film_path",
    type=file_ending("film.mp4"),
    metavar="FILE",
    help="Write an .mp4 of the input, S, G and the membrane potential.",
)
@click.option(
    "--overlay",
    is_flag=True,
    help="With --video: show the input at full size, with the active cells of G tinted, MP as a "
    "bar and alarms as a banner.",
)
@model_options
@input_options
@output_options
def layers(
    input_path: str,
    wanted: tuple[int, ...] | None,
    collision_frame: int | None,
    labels_path: Path | None,
    npz: bool,
    film_path: Path | None,
    overlay: bool,
    setup: "Setup",
    given: dict[str, Any],
    output: Output,
) -> None:
    """Show the layers of a model: photoreceptors P, summation S and grouping G.

    INPUT is as in 'dlgmd run'.

    Unless --frames is given, the strongest responses are shown, but none after a collision that
    --collision-frame, --collisions or the YAML of a rendered flight tells, and none where the
    pictures are black or frozen.

    Writes OUT/NAME/ with a figure of heat maps and layers.yaml; --npz adds layers.npz. --video
    writes a film of the input, S and G above the membrane potential; the heat maps are left out
    then, unless --frames is given.
    """
    if overlay and film_path is None:
        raise click.UsageError("--overlay works only with --video. Add --video film.mp4.")
    if not wanted and film_path is not None and npz:
        raise click.UsageError("--npz writes the layers of --frames. Give --frames 1,50,65.")
    if labels_path and collision_frame is not None:
        raise click.UsageError("Give --collisions or --collision-frame, not both.")
    from dlgmd_cli.results import store
    from dlgmd_cli.runs import run as runs
    from dlgmd_cli.runs.layers import absent, run_layers
    from dlgmd_cli.runs.setup import input_options as recorded

    options = recorded(setup, given)
    makes_sheet = bool(wanted) or film_path is None
    record = store.LAYERS if makes_sheet else None
    with job(input_path, [setup], options, output, record) as one:
        video, folder = one.video, one.folder
        if film_path is not None:
            sheet_folder = folder if makes_sheet else None
            _check_film(film_path, sheet_folder, video.info.path, overwrite=output.overwrite)
        frames = wanted or ()
        if makes_sheet and not frames:
            contact = _contact(input_path, collision_frame, labels_path)
            frames = _strongest(input_path, setup, options, contact)
        n_wanted = math.inf if film_path else max(frames) + 1
        with one.progress(n_wanted) as on_frame:
            whole = film_path is not None
            ran = run_layers(video, setup, options, frames, whole=whole, on_frame=on_frame)
        result, sheet = ran.result, ran.sheet
        if not cancel.requested():
            why_not = absent(sorted({*frames} - {*result.record["frames"]}), video, options.end)
            if frames and sheet is None:
                raise SourceError(input_path, why_not, "Choose other frames.")
            result.warnings.extend([why_not] if why_not else [])
            result.warnings.extend(result.doubts() if film_path else [])
        one.warn(result.warnings)
        if sheet is not None:
            one.commit(_files(result, sheet, output, npz))
            print_path(folder)
    if makes_sheet and cancel.requested():
        n_kept = f"{len(result.record['frames'])} of {len(frames)} frames"
        unmade = f", no frame of {film_path} was rendered" if film_path else ""
        say(f"Interrupted. {folder} holds {n_kept}{unmade}.")
        raise click.exceptions.Exit(cancel.EXIT_INTERRUPTED)
    if film_path is None:
        return
    if not result.n_valid:
        raise runs.too_short(video, setup.label, ran.model.first_valid_frame + 1, options)
    with runs.open_input(input_path, [setup], options) as again:
        film = _film(ran, again, setup.label, overlay=overlay)
        steps = partial(runs.responses, again, [runs.stepper_on(again, setup, options)])
        _render(film, again, steps, len(result), film_path)


def _contact(input_path: str, frame: int | None, labels_path: Path | None) -> int | None:
    """The first collision: the one given, that of a table, or that of a rendered flight."""
    from dlgmd_cli.results.labels import labelled_frames, read_collisions
    from dlgmd_cli.results.record import read_record

    if labels_path:
        frames = labelled_frames(read_collisions(labels_path), os.path.abspath(input_path))
        if frames is None:
            warn(f"{labels_path} does not list {input_path}")
        return min(frames or (), default=None)
    if frame is None and Path(input_path).is_file():
        truth = read_record(Path(input_path).with_suffix(".yaml"))
        frame = truth.get("collision_frame") if "scene" in truth else None
    return frame if isinstance(frame, int) else None


def _strongest(
    input_path: str, setup: "Setup", options: Any, contact: int | None
) -> tuple[int, ...]:
    """Choose the frames of a sheet, by running the model over the whole input."""
    from dlgmd_cli.runs import run as runs
    from dlgmd_cli.runs.layers import strongest_frames

    with runs.open_input(input_path, [setup], options) as video:
        with progress(video.info.name, options.n_expected(video.info)) as on_frame:
            results = runs.run_models(video, [setup], options, on_frame=on_frame)
        if cancel.requested():
            raise cancel.Interrupted
        runs.require_response(video, [setup], results, options)
        blind_s = video.progress.blind_s
    return strongest_frames(results[0], contact=contact, blind_s=blind_s)


def _check_film(film: Path, folder: Path | None, input_path: str, *, overwrite: bool) -> None:
    """Raise now if the film could not be written at the end."""
    from dlgmd_cli.results.store import refuse_existing, unwritable

    if folder is not None and film.resolve().parent == folder.resolve():
        raise click.UsageError(
            f"--video lies in {folder}, where the sheet goes. Choose another place."
        )
    refuse_existing(film, overwrite=overwrite, option="--video")
    if film.exists() and Path(input_path).exists() and film.samefile(input_path):
        raise click.UsageError("--video would replace INPUT. Choose another file.")
    try:
        film.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(film, error, "--video") from None


def _files(result: "Result", sheet: "LayerSheet", output: Output, npz: bool) -> "dict[str, Write]":
    """The function that writes each file of a sheet, by name."""
    from dlgmd_cli.plots.layers import plot_layers
    from dlgmd_cli.plots.style import figure_files
    from dlgmd_cli.results.layers import write_npz
    from dlgmd_cli.results.record import record_text
    from dlgmd_cli.results.store import LAYERS, file_of

    text = record_text(result.record, [result.record["engine"]])
    return {
        **({"layers.npz": partial(write_npz, sheet=sheet)} if npz else {}),
        **figure_files({"layers": partial(plot_layers, sheet)}, output.formats, output.dpi),
        LAYERS: file_of(text),
    }


def _film(ran: "LayerRun", video: "Video", label: str, *, overlay: bool) -> "Film | Overlay":
    """The film of a run over the whole video."""
    from dlgmd_cli.plots.film import Film
    from dlgmd_cli.plots.heat import Scale
    from dlgmd_cli.plots.overlay import Overlay

    scales = Scale.over(*ran.ranges["s"]), Scale.over(*ran.ranges["g"])
    if overlay:
        return Overlay(ran.result, video.source_wh[::-1], scales[1].high)
    label = f"{video.info.name} · {label}"
    return Film(ran.result, video.size_wh[::-1], scales, ran.model.layer_units[1:], label)


def _render(
    film: "Film | Overlay", video: "Video", steps: "Callable[..., Steps]", n_frames: int, path: Path
) -> None:
    """Write the film while the model runs over the input again; an interruption cuts it short."""
    from dlgmd_cli.plots.film import Film
    from dlgmd_cli.video.writer import best_codec, playable_fps, video_writer

    fps = playable_fps(video.rate_fps)
    if abs(fps / video.rate_fps - 1.0) > 0.01:
        warn(f"{path} plays at {fps:g} frames a second, not at {video.rate_fps:g}")
    n_rendered = 0
    picture_wh = None if isinstance(film, Film) else video.source_wh
    look: Any = {"codec": best_codec(), "is_colour": True, "option": "--video"}
    with (
        progress(f"{video.info.name} → {path.name}", n_frames) as on_frame,
        video_writer(path, film.shape, fps, **look) as write,
    ):
        found = steps(layers=lambda frame: True, picture_wh=picture_wh)
        for n_rendered, (frame, (response,)) in zip(range(1, n_frames + 1), found, strict=False):
            layers: Any = response.layers
            picture: Any = frame.picture
            if isinstance(film, Film):
                write(film.picture(n_rendered - 1, frame.luminance, layers.s, layers.g))
            else:
                write(film.picture(n_rendered - 1, picture, layers.g))
            on_frame(n_rendered)
    print_path(path)
    if cancel.requested() and n_rendered < n_frames:
        say(f"Interrupted. {path} holds the first {n_rendered} of {n_frames} frames.")
        raise click.exceptions.Exit(cancel.EXIT_INTERRUPTED)
