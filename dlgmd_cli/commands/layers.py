"""`dlgmd layers`: what a model's layers hold, as a contact sheet, as arrays, or as a video."""

import math
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands._ahead import import_ahead
from dlgmd_cli.commands._console import EXIT_INTERRUPTED, Command, print_path, say
from dlgmd_cli.commands._figures import save_plots
from dlgmd_cli.commands._film import render_film, reserved
from dlgmd_cli.commands._input import choose_input, input_options
from dlgmd_cli.commands._interrupts import Interrupts
from dlgmd_cli.commands._layer_job import LayerJob
from dlgmd_cli.commands._model import ModelChoice, engine_option, model_options
from dlgmd_cli.commands._types import FrameNumbers, Output, VideoFile, output_options

if TYPE_CHECKING:
    from dlgmd_cli.results.folder import ResultFolder
    from dlgmd_cli.results.layers import LayerSheet
    from dlgmd_cli.runs.layers import LayerRecording

# What is readable at the width of two columns of a paper.
MAX_FRAMES = 12

_NEEDED_LATER = (
    "dlgmd_cli.models.engines.opencv",
    "dlgmd_cli.runs.layers",
    "dlgmd_cli.results.folder",
    "dlgmd_cli.plots.layers",
    "matplotlib.backends.backend_agg",
)


@click.command(
    cls=Command,
    epilog="Example: dlgmd layers flight.mp4 --frames 1,50,65,75,80 --video layers.mp4",
)
@click.argument("input_path", metavar="INPUT")
@click.option(
    "--frames",
    type=FrameNumbers(MAX_FRAMES),
    help="Frames of the sheet, numbers from 0 in the input.",
)
@click.option("--npz", is_flag=True, help="Write those frames' layers as arrays, too.")
@click.option("--video", type=VideoFile(), help="Render input, S, G and MP as an .mp4.")
@model_options
@engine_option
@input_options
@output_options
def layers(
    input_path: str,
    frames: tuple[int, ...] | None,
    npz: bool,
    video: Path | None,
    choice: ModelChoice,
    engine: str | None,
    given: dict[str, Any],
    output: Output,
) -> None:
    """Show the input, P, S and G as heat maps.

    INPUT is a video, a folder of pictures, or a pattern of pictures such as 'frames/%04d.png'.

    --frames writes OUT/NAME/ with a contact sheet and layers.yaml, with --npz also layers.npz.
    --video writes a film of input, S and G above the running membrane potential.
    """
    if frames is None and video is None:
        raise click.UsageError(
            "nothing to make. Give --frames 1,50,65 for a sheet, --video film.mp4 for a video."
        )
    if frames is None and npz:
        raise click.UsageError("--npz writes the layers of --frames. Give --frames 1,50,65.")
    options = choose_input(given, choice.recorded_options, choice.origin)
    detector = choice.create(engine, tell=say)
    import_ahead(_NEEDED_LATER)
    with (
        Interrupts() as interrupts,
        _printed_at_the_end() as made,
        options.open(input_path) as source,
        _folder(output, source.info.name, frames, video) as folder,
        reserved(video, source.info.path, overwrite=output.overwrite) as film_file,
    ):
        job = LayerJob(input_path, source, detector, choice, options)
        job.compute(frames or (), interrupts, whole=video is not None)
        interrupts.hold()
        job.draw_conclusions()
        if folder is not None:
            folder.save(partial(_write, job.sheet(), job.record(), output.formats, npz, interrupts))
            made.append(folder.target)
        if not job.complete or interrupts.count:
            _say_what_is_kept(job.recording, folder, video)
            raise click.exceptions.Exit(EXIT_INTERRUPTED)
        if video is None or film_file is None:
            return
        facts_of_film = job.film()
        with options.open(input_path) as again:
            fps = min(options.fps or math.inf, again.info.fps)
            n_rendered = render_film(
                facts_of_film, again, detector, fps, film_file, video, interrupts
            )
    print_path(video)
    n_frames = len(job.recording.responses)
    if n_rendered < n_frames and interrupts.count:
        say(f"Interrupted; {video} holds the first {n_rendered} of {n_frames} frames.")
        raise click.exceptions.Exit(EXIT_INTERRUPTED)


@contextmanager
def _printed_at_the_end() -> Iterator[list[Path]]:
    """Paths for stdout, whatever comes; by then nothing else is being written that could fail."""
    paths: list[Path] = []
    try:
        yield paths
    finally:
        for path in paths:
            print_path(path)


def _folder(
    output: Output, name: str, frames: tuple[int, ...] | None, video: Path | None
) -> "AbstractContextManager[ResultFolder | None]":
    """Where the sheet goes, refused at once if it may not; None if there is to be none."""
    if frames is None:
        return nullcontext()
    from dlgmd_cli.results.folder import LAYERS, ResultFolder

    folder = ResultFolder(output.out, name, LAYERS, overwrite=output.overwrite)
    if video is not None and video.resolve().parent == folder.target.resolve():
        raise click.UsageError(
            f"--video lies in {folder.target}, where the sheet goes. Choose another place."
        )
    return folder


def _write(
    sheet: "LayerSheet",
    record: dict[str, Any],
    formats: tuple[str, ...],
    npz: bool,
    interrupts: Interrupts,
    folder: Path,
) -> None:
    """Fill `folder` with the files of a sheet; a Ctrl-C meanwhile only spares the picture."""
    from dlgmd_cli.results.folder import LAYERS
    from dlgmd_cli.results.layers import write_npz
    from dlgmd_cli.results.record import write_record

    write_record(folder, record, LAYERS, engines=[record["engine"]])
    if npz:
        write_npz(folder / "layers.npz", sheet)
    if formats:
        from dlgmd_cli.plots.layers import plot_layers

        save_plots(folder, {"layers": partial(plot_layers, sheet)}, formats, interrupts)


def _say_what_is_kept(
    recording: "LayerRecording", folder: "ResultFolder | None", video: Path | None
) -> None:
    """What an interrupt before the film left behind."""
    kept = []
    if folder is not None:
        kept.append(
            f"{folder.target} holds {len(recording.shots)} of {len(recording.wanted)} frames"
        )
    if video is not None:
        kept.append(f"no frame of {video} was rendered")
    say(f"Interrupted; {', '.join(kept)}.")
