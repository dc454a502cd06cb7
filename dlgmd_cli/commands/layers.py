"""`dlgmd layers`: what a model's layers hold, as a contact sheet, as arrays, or as a film."""

import math
import re
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli import cancel
from dlgmd_cli.commands.console import Command, print_path, say, warn
from dlgmd_cli.commands.options import Output, input_options, model_options, output_options
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.errors import SourceError

if TYPE_CHECKING:
    from dlgmd_cli.models.base import Model, Response
    from dlgmd_cli.results.layers import LayerSheet
    from dlgmd_cli.results.store import Write
    from dlgmd_cli.runs.layers import LayerPass
    from dlgmd_cli.runs.run import Setup
    from dlgmd_cli.video.frames import Frame, InputOptions, Video

# What is readable at the width of two columns of a paper.
MAX_FRAMES = 12


class FrameNumbers(click.ParamType):
    """Numbers of frames, as 1,50,65: each once, in order."""

    name = "N,N,…"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, ...]:
        """`65, 1,50` -> (1, 50, 65)."""
        if isinstance(value, tuple):
            return value
        parts = [part.strip() for part in str(value).split(",")]
        for part in parts:
            if re.fullmatch(r"\d{1,9}", part, re.ASCII) is None:
                self.fail(f"{part[:40]!r} is not a frame number. Write 1,50,65.", param, ctx)
        frames = tuple(sorted({int(part) for part in parts}))
        if len(frames) > MAX_FRAMES:
            line = f"{len(frames)} frames are too many for one sheet. Choose up to {MAX_FRAMES}."
            self.fail(line, param, ctx)
        return frames


class VideoFile(click.ParamType):
    """Where a video is to be written."""

    name = "FILE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """A path that ends in .mp4."""
        path = Path(value)
        if path.suffix.lower() != ".mp4":
            self.fail(f"{str(value)[:80]!r} does not end in .mp4. Write film.mp4.", param, ctx)
        return path


@click.command(
    cls=Command,
    epilog="Example: dlgmd layers flight.mp4 --frames 1,50,65,75,80 --video layers.mp4",
)
@click.argument("input_path", metavar="INPUT")
@click.option(
    "--frames", type=FrameNumbers(), help="Frames of the sheet, numbers from 0 in the input."
)
@click.option("--npz", is_flag=True, help="Write those frames' layers as arrays, too.")
@click.option("--video", "film", type=VideoFile(), help="Render input, S, G and MP as an .mp4.")
@model_options
@input_options
@output_options
def layers(
    input_path: str,
    frames: tuple[int, ...] | None,
    npz: bool,
    film: Path | None,
    setup: "Setup",
    given: dict[str, Any],
    output: Output,
) -> None:
    """Show the input, P, S and G as heat maps.

    INPUT is a video, a folder of pictures, or a pattern of pictures such as 'frames/%04d.png'.

    --frames writes OUT/NAME/ with a contact sheet and layers.yaml, with --npz also layers.npz.
    --video writes a film of input, S and G above the running membrane potential.
    """
    if frames is None and film is None:
        raise click.UsageError(
            "nothing to make. Give --frames 1,50,65 for a sheet, --video film.mp4 for a video."
        )
    if frames is None and npz:
        raise click.UsageError("--npz writes the layers of --frames. Give --frames 1,50,65.")
    from dlgmd_cli.models.base import create_model
    from dlgmd_cli.results import store
    from dlgmd_cli.runs import run as runs

    options = runs.input_options(setup, given)
    with options.open(input_path) as video:
        folder = store.result_folder(output.out, video.info.name) if frames else None
        if film is not None:
            _check_film(film, folder, video.info.path, overwrite=output.overwrite)
        identity, is_new = runs.input_identity(video.info, input_path), False
        if folder is not None:
            is_new = store.check(folder, store.LAYERS, identity, overwrite=output.overwrite)
        with store.locked(folder) if folder else nullcontext():
            model = create_model(setup.params, engine=setup.engine, tell=say)
            gathered = _compute(
                video, setup, model, options, frames or (), identity, whole=film is not None
            )
            _doubt(input_path, gathered, video, frames or (), options, of_film=film is not None)
            if folder is not None:
                files = _files(gathered, output, npz)
                store.commit(folder, store.LAYERS, files, is_new_input=is_new)
        try:
            if cancel.requested():
                _say_what_is_kept(gathered, frames or (), folder, film)
                raise click.exceptions.Exit(cancel.EXIT_INTERRUPTED)
            if film is not None:
                if not gathered.result.n_valid:
                    needs = model.first_valid_frame + 1
                    raise runs.too_short(input_path, video, setup.label, needs, options)
                with options.open(input_path) as again:
                    fps = min(options.fps or math.inf, again.info.fps)
                    _render(gathered, again, model, fps, film)
        finally:  # by now nothing else is being written that could fail
            if folder is not None:
                print_path(folder)


def _check_film(film: Path, folder: Path | None, input_path: str, *, overwrite: bool) -> None:
    """Refuse at once what could not be written at the end."""
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


def _compute(
    video: "Video",
    setup: "Setup",
    model: "Model",
    options: "InputOptions",
    frames: tuple[int, ...],
    identity: dict[str, Any],
    *,
    whole: bool,
) -> "LayerPass":
    """The first pass, under a progress bar."""
    from dlgmd_cli.runs.layers import run_layers

    n_expected = options.n_expected(video.info)
    if not whole:
        n_wanted = max(frames) + 1
        n_expected = n_wanted if n_expected is None else min(n_expected, n_wanted)
    with progress(video.info.name, n_expected) as on_frame:
        return run_layers(
            *(video, setup, model, options, frames),
            whole=whole,
            identity=identity,
            on_frame=on_frame,
        )


def _doubt(
    name: str,
    gathered: "LayerPass",
    video: "Video",
    frames: tuple[int, ...],
    options: "InputOptions",
    *,
    of_film: bool,
) -> None:
    """Warn of what is doubtful; raise SourceError if no frame of the sheet is there."""
    from dlgmd_cli.runs.layers import absent

    result = gathered.result
    missing = "" if cancel.requested() else absent(gathered, video, frames, options.end)
    if missing and gathered.sheet is not None:
        result.warnings.append(missing)
    if of_film and not cancel.requested():
        result.warnings.extend(result.doubts())
    for warning in result.warnings:
        warn(f"{name}: {warning}")
    if frames and gathered.sheet is None:
        raise SourceError(name, missing, "Choose other frames.")


def _files(gathered: "LayerPass", output: Output, npz: bool) -> "dict[str, Write]":
    """What writes each file of a sheet, by its name."""
    from dlgmd_cli.results.layers import write_npz
    from dlgmd_cli.results.record import record_text
    from dlgmd_cli.results.store import LAYERS

    sheet: LayerSheet = gathered.sheet  # type: ignore[assignment]
    record = gathered.result.record
    files: dict[str, Write] = {}
    if npz:
        files["layers.npz"] = partial(write_npz, sheet=sheet)
    if output.formats:
        from dlgmd_cli.plots.layers import plot_layers
        from dlgmd_cli.plots.style import figure_files

        files |= figure_files({"layers": partial(plot_layers, sheet)}, output.formats)
    text = record_text(record, [record["engine"]])
    files[LAYERS] = lambda path: path.write_text(text, encoding="utf-8")
    return files


def _say_what_is_kept(
    gathered: "LayerPass", frames: tuple[int, ...], folder: Path | None, film: Path | None
) -> None:
    """What a stop before the film left behind."""
    kept = []
    if folder is not None:
        n_kept = len(gathered.result.record["frames"])
        kept.append(f"{folder} holds {n_kept} of {len(frames)} frames")
    if film is not None:
        kept.append(f"no frame of {film} was rendered")
    say(f"Interrupted: {', '.join(kept)}.")


def _render(
    gathered: "LayerPass", video: "Video", model: "Model", nominal_fps: float, path: Path
) -> None:
    """The film, by a second pass, on scales that the first one found; a stop cuts it off."""
    from dlgmd_cli.plots.film import HEIGHT, WIDTH, Film
    from dlgmd_cli.plots.heat import Scale
    from dlgmd_cli.runs.layers import watch
    from dlgmd_cli.video.writer import best_codec, playable_fps, video_writer

    result, numbers = gathered.result, gathered.result.frame
    scales = Scale.over(*gathered.ranges["s"]), Scale.over(*gathered.ranges["g"])
    units, (width, height) = model.layer_units, video.size_wh
    film = Film(result, (height, width), scales, (units[1], units[2]), gathered.label)
    fps = playable_fps(nominal_fps)
    if abs(fps / nominal_fps - 1.0) > 0.01:
        warn(f"{path} plays at {fps:g} frames a second, not at {nominal_fps:g}")
    n_frames, n_rendered = len(numbers), 0
    with (
        progress(f"{video.info.name} → {path.name}", n_frames) as on_frame,
        video_writer(
            path, (HEIGHT, WIDTH), fps, codec=best_codec(), is_colour=True, option="--video"
        ) as write,
    ):

        def visit(frame: "Frame", response: "Response") -> bool:
            nonlocal n_rendered
            if frame.index != numbers[n_rendered]:
                return False
            layers = response.layers
            s, g = (layers.s, layers.g) if layers else (None, None)
            write(film.picture(n_rendered, frame.luminance, s, g))
            n_rendered += 1
            on_frame(n_rendered)
            return n_rendered < n_frames

        watch(video, model, visit)
        if n_rendered == 0:
            cancel.check()
            raise SourceError(video.info.path, "it could not be read a second time")
    print_path(path)
    if n_rendered == n_frames:
        return
    if cancel.requested():
        say(f"Interrupted. {path} holds the first {n_rendered} of {n_frames} frames.")
        raise click.exceptions.Exit(cancel.EXIT_INTERRUPTED)
    line = f"read a second time, it gives only {n_rendered} of {n_frames} frames"
    warn(f"{video.info.path}: {line}; {path} ends there")
