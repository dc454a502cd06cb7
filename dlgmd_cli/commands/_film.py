"""Rendering the video of `dlgmd layers`: a second pass, on scales that the first one found."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dlgmd_cli.commands._console import progress, warn
from dlgmd_cli.commands._interrupts import Interrupts
from dlgmd_cli.errors import SourceError

if TYPE_CHECKING:
    from dlgmd_cli.models.base import Model, Response
    from dlgmd_cli.plots.film import FilmFacts
    from dlgmd_cli.video.frames import Frame, Video


@contextmanager
def reserved(video: Path | None, input_path: str, *, overwrite: bool) -> Iterator[Path | None]:
    """A file to write instead of `video`, which it becomes at the end; None if there is none.

    Found out at once: whether it may be written, and can.
    """
    from dlgmd_cli.results.files import appearing, refuse_existing

    if video is None:
        yield None
        return
    refuse_existing(video, overwrite=overwrite, option="--video")
    if video.exists() and Path(input_path).exists() and video.samefile(input_path):
        raise click.UsageError("--video would replace INPUT. Choose another file.")
    with appearing(video, option="--video") as (file,):
        file.touch()
        yield file


def render_film(
    facts: "FilmFacts",
    source: "Video",
    model: "Model",
    nominal_fps: float,
    file: Path,
    video: Path,
    interrupts: Interrupts,
) -> int:
    """Write the film to `file`, which is to become `video`; the number of its frames.

    An interrupt ends it after a whole frame, with the frames before it in a whole file.
    """
    from dlgmd_cli.plots.film import HEIGHT, WIDTH, Film
    from dlgmd_cli.runs.single import watch
    from dlgmd_cli.video.writer import best_codec, playable_fps, video_writer

    film, numbers = Film(facts), facts.result.frame
    fps = playable_fps(nominal_fps)
    if abs(fps / nominal_fps - 1.0) > 0.01:
        warn(f"{video} plays at {fps:g} frames a second, not at {nominal_fps:g}")
    n_frames, n_rendered, shape = len(numbers), 0, (HEIGHT, WIDTH)
    with (
        progress(f"{source.info.name} → {video.name}", n_frames) as on_frame,
        video_writer(
            file, shape, fps, codec=best_codec(), is_colour=True, target=video, option="--video"
        ) as write,
    ):

        def visit(frame: "Frame", response: "Response") -> bool:
            nonlocal n_rendered
            if interrupts.count or frame.index != numbers[n_rendered]:
                return False
            layers = response.layers
            s, g = (layers.s, layers.g) if layers else (None, None)
            write(film.picture(n_rendered, frame.luminance, s, g))
            n_rendered += 1
            on_frame(n_rendered)
            return n_rendered < n_frames

        watch(source, model, visit)
    if n_rendered == 0 and interrupts.count:
        raise KeyboardInterrupt
    if n_rendered < n_frames and not interrupts.count:
        line = f"read a second time, it gives only {n_rendered} of {n_frames} frames"
        if n_rendered == 0:
            raise SourceError(source.info.path, line)
        warn(f"{source.info.path}: {line}; {video} ends there")
    return n_rendered
