"""`dlgmd lab bench`: the computing times of the paper's Table IV, measured on this machine."""

from contextlib import ExitStack
from pathlib import Path

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, progress, show
from dlgmd_cli.parameters.presets import MODELS


@click.command(cls=Command)
@click.argument("video", required=False)
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
    type=click.FloatRange(0, 1, min_open=True),
    multiple=True,
    metavar="S",
    help="Scale of the processed frames; repeatable.  [default: 1, 0.5, 0.25, 0.1, 0.02]",
)
@click.option(
    "--frames",
    type=click.IntRange(12),
    default=120,
    show_default=True,
    help="Number of frames to process.",
)
@click.option(
    "--repeat",
    "repeats",
    type=click.IntRange(1),
    default=3,
    show_default=True,
    help="Number of repetitions of each measurement, whose median is shown.",
)
@click.option(
    "--share",
    "shares",
    type=click.IntRange(1, 100),
    multiple=True,
    metavar="PERCENT",
    help="Instead: play VIDEO to 'dlgmd live' on this share of one core (stopped for the rest of "
    "each 0.1 s), and compare the onset of the alarm with that of 'dlgmd run'; repeatable.",
)
@click.option(
    "--programs",
    is_flag=True,
    help="Instead: time the whole of 'dlgmd run', and of ffmpeg, OpenCV and PySceneDetect, over "
    "VIDEO, or over clips of 1920x1080, 1280x720 and 640x360, one of them of 10 minutes.",
)
@click.option(
    "--models",
    is_flag=True,
    help="Instead: time every model of the package over a texture of 432x240 and of 1280x720.",
)
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Also write DIR/bench.csv, DIR/onsets.csv, DIR/programs.csv or DIR/models.csv.",
)
@options.overwrite_option
def bench(
    video: str | None,
    radii: tuple[int, ...],
    scales: tuple[float, ...],
    frames: int,
    repeats: int,
    shares: tuple[int, ...],
    programs: bool,
    models: bool,
    out: Path | None,
    overwrite: bool,
) -> None:
    """Measure how long the model takes, as in the paper's Table IV.

    \b
    Examples:
      dlgmd lab bench                                  # on a 1080p texture
      dlgmd lab bench flight.mp4 --radius 6 --scale 1  # on your own video
      dlgmd lab bench --out speed                      # also as a CSV
      dlgmd lab bench flight.mp4 --share 25            # the alarm of a busy computer
      dlgmd lab bench --programs --repeat 5            # beside other programs
      dlgmd lab bench --models                         # every model of the package

    Runs set 7 with each radius at each scale over VIDEO, or over a texture of 1920x1080. Shows the
    time per frame of the core (the model alone), and of the whole (with decoding, conversion to
    grey and scaling).
    """
    from dlgmd_cli.lab.bench import bench as task
    from dlgmd_cli.lab.bench import every
    from dlgmd_cli.lab.bench.programs import made_clips
    from dlgmd_cli.lab.bench.programs import programs as timed_programs
    from dlgmd_cli.lab.bench.shares import onsets
    from dlgmd_cli.results.outcome import Outcome

    found: Outcome
    if programs:
        with ExitStack() as opened:
            clips = [Path(video)] if video else opened.enter_context(made_clips())
            on_pass = opened.enter_context(progress("bench", repeats + 1, "pass"))
            found = timed_programs(clips, repeats, on_pass)
    elif models:
        n_passes = repeats * len(every.SIZES_WH) * len(MODELS)
        with progress("bench", n_passes, "pass") as on_pass:
            found = every.every_model(frames, repeats, on_pass)
    elif shares:
        if video is None:
            raise click.UsageError("--share works only with a VIDEO.")
        shares = tuple(dict.fromkeys(shares))
        with progress("bench", repeats * len(shares), "pass") as on_pass:
            found = onsets(video, shares, repeats, on_pass)
    else:
        radii = tuple(dict.fromkeys(radii)) or task.RADII
        scales = tuple(dict.fromkeys(scales)) or task.SCALES
        with ExitStack() as opened:
            given = video or opened.enter_context(task.moving_texture(frames))
            n_passes = repeats * len(radii) * len(scales)
            on_pass = opened.enter_context(progress("bench", n_passes, "pass"))
            found = task.bench(
                given,
                radii=radii,
                scales=scales,
                frames=frames,
                repeats=repeats,
                on_pass=on_pass,
            )
    if out is not None:
        found.save(out, overwrite=overwrite)
    show(found)
