"""`dlgmd lab fly`: render labelled flights, or film one that brakes at an alarm."""

from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, show
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.lab.fly import gl
from dlgmd_cli.lab.fly.objects import KINDS
from dlgmd_cli.lab.fly.scripts import GROUPS, MANNERS, Options
from dlgmd_cli.lab.fly.worlds import ENVIRONMENTS


@click.command(cls=Command)
@click.option(
    "--manner",
    type=click.Choice([*MANNERS, *GROUPS]),
    metavar="NAME",
    help="Scenario: hit, pass, door, turn, climb, approached, crossed, free; or group1 to "
    "group5 of the paper.  [default: drawn by the seed]",
)
@click.option(
    "--environment",
    type=click.Choice([*ENVIRONMENTS]),
    help="Surroundings.  [default: drawn by the seed]",
)
@click.option(
    "--target",
    type=click.Choice([*KINDS]),
    metavar="NAME",
    help=f"Object that is hit, is passed, or approaches: {', '.join(KINDS)}.  "
    "[default: drawn by the seed]",
)
@click.option(
    "--speed",
    "speed_m_s",
    type=options.numeric(low=0.1, high=10),
    metavar="M/S",
    help="Speed of the drone; of the object, if the drone hovers.  [default: 1 to 3, by the seed]",
)
@click.option(
    "--height",
    "height_m",
    type=options.numeric(low=0.3, high=5),
    metavar="M",
    help="Height of the drone, which does not climb.  [default: 0.8 to 1.8, by the seed]",
)
@click.option(
    "--fov",
    type=options.numeric(low=20, high=150),
    metavar="DEG",
    help="Horizontal field of view.  [default: 60 to 120, drawn by the seed; groups 80]",
)
@options.with_default(
    "--camera-tilt",
    type=options.numeric(low=-45, high=45),
    default=0.0,
    metavar="DEG",
    help="Angle at which the camera is mounted, upwards positive.",
)
@click.option("--agile", is_flag=True, help="Tilt as fast as a racing drone.")
@options.with_default(
    "--seed", type=options.numeric(int, 0, 10**9), default=0, help="Seed of the first flight."
)
@options.with_default(
    "--count", type=options.numeric(int, 1, 100_000), default=1, help="Number of flights."
)
@options.with_default(
    "--size", type=options.SIZE, default="480x270", help="Size of the images in px."
)
@options.with_default(
    "--fps", type=options.numeric(low=1, high=240), default=30.0, help="Frames per second."
)
@click.option("--png", is_flag=True, help="Write PNG images, which keep every grey level.")
@click.option(
    "--with",
    "model",
    metavar="N|NAME",
    help="Film one flight that brakes at the alarm of a set or preset, beside one without.",
)
@options.with_default(
    "-o",
    "--out",
    default="flights",
    callback=options.folder_name,
    metavar="DIR",
    help="Folder for the flights.",
)
@options.jobs_option
@options.overwrite_option
def fly(
    manner: str | None,
    size: tuple[int, int],
    model: str | None,
    out: str,
    count: int,
    jobs: int | None,
    png: bool,
    overwrite: bool,
    **given: Any,
) -> None:
    """Render labelled flights of a drone.

    \b
    Examples:
      dlgmd lab fly --count 20 --out flights          # 20 flights, half of them collisions
      dlgmd lab fly --manner group2 --out group2      # group 2 of the paper
      dlgmd lab fly --manner hit --target pole --with flight --out film

    Writes DIR/MANNER-SEED.mp4, DIR/truth/MANNER-SEED.csv with the truth of each frame, and
    DIR/labels.csv for 'dlgmd evaluate'. The same seed gives the same flight.

    With --with, writes DIR/MANNER-SEED-film.mp4 and .csv: a flight without and with the
    alarm. The drone brakes 0.1 s after it, with a tilt of up to 25 degrees.
    """
    from dlgmd_cli.lab.fly.fly import render

    flight = Options(manner, size_wh=size, **given)
    if model is None:
        show(render(flight, Path(out), count=count, jobs=jobs, png=png, overwrite=overwrite))
        return
    if count > 1 or png:
        raise ParameterError("", "--with films one flight", "Leave out --count and --png.")
    gl.require()
    from dlgmd_cli.lab.fly.film import film

    show(film(flight, model, Path(out), overwrite=overwrite))
