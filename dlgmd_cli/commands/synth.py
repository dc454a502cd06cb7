"""`dlgmd synth`: stimuli with their ground truth."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands._clip_options import (
    SectionedCommand,
    by_flag,
    clip_options,
    count_option,
    jobs_option,
)
from dlgmd_cli.commands._console import print_path, print_table, progress, say, settings
from dlgmd_cli.commands._sheets import draw_sheet

if TYPE_CHECKING:
    from dlgmd_cli.stimuli.base import Scene
    from dlgmd_cli.stimuli.encode import DrawSheet
    from dlgmd_cli.stimuli.form import Form


@click.command(
    cls=SectionedCommand,
    epilog="Example: dlgmd synth looming-cube --speed 5 --noise 0.02 --seed 1 --out stimuli",
)
@click.argument("scene_name", metavar="SCENE", required=False)
@click.option("--list", "lists", is_flag=True, help="List the scenes and stop.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path(),
    metavar="DIR",
    show_default="here",
    help="Folder for the files.",
)
@click.option("--lossless", is_flag=True, help="Write FFV1 in .avi, which keeps every grey level.")
@click.option("--png", is_flag=True, help="Write a folder of PNG, which keeps every grey level.")
@click.option(
    "--sheet",
    is_flag=True,
    help="Draw a contact sheet, too, of up to 12 frames, the collision's among them.",
)
@click.option("--overwrite", is_flag=True, help="Replace earlier files.")
@clip_options
@count_option
@jobs_option
def synth(
    scene_name: str | None,
    lists: bool,
    out: Path,
    lossless: bool,
    png: bool,
    sheet: bool,
    overwrite: bool,
    given: dict[str, Any],
    count: int | None,
    jobs: int | None,
) -> None:
    """Render a stimulus with its ground truth.

    Makes DIR/SCENE.mp4 and DIR/SCENE.csv, whose rows say what is true of each frame; of a flight
    also DIR/SCENE.yaml with its phases and the frame of the collision. 'dlgmd synth --list' has the
    scenes: flights in rendered rooms, and flat ones, plain objects on a plain background.

    --sheet makes DIR/SCENE-sheet.png beside them, which shows at a glance what was rendered: frames
    from the first to the last, with what is true of each. With --count, every flight has its own.

    --count makes DIR/SCENE-0000.mp4 and so on, the first with --seed, each other with the next
    seed, and DIR/labels.csv. Flights that are there already are kept: after an interrupt, the same
    command goes on.
    """
    if count is None and jobs is not None:
        raise click.UsageError("--jobs shares out the flights of --count. Add it.")
    if lists:
        _list()
        return
    if scene_name is None:
        raise click.UsageError("Missing argument 'SCENE'. 'dlgmd synth --list' has them.")
    from dlgmd_cli.flights.scenes import find_scene
    from dlgmd_cli.stimuli.form import Form

    scene = find_scene(scene_name)
    options = scene.configure(by_flag(given))
    form = Form.choose(lossless=lossless, png=png, playable=scene.is_playable)
    draw = draw_sheet if sheet else None
    if count is None:
        _render_one(scene, options, form, out, overwrite, draw)
        return
    from dlgmd_cli.commands._flights import render_fleet
    from dlgmd_cli.flights.dataset import Fleet
    from dlgmd_cli.flights.scene import FlightScene

    if not isinstance(scene, FlightScene):
        raise click.UsageError(f"--count is for flights, and {scene.name} is none.")
    fleet = Fleet(scene, options, count, out, form, draw)
    render_fleet(fleet, jobs=jobs, overwrite=overwrite)


def _list() -> None:
    """The scenes by kind, on stdout."""
    from dlgmd_cli.flights.scene import FlightScene
    from dlgmd_cli.flights.scenes import SCENES

    flights = [scene for scene in SCENES.values() if isinstance(scene, FlightScene)]
    flat = [scene for scene in SCENES.values() if not isinstance(scene, FlightScene)]
    width = max(map(len, SCENES))
    for kind, scenes in (("flight", flights), ("flat scene", flat)):
        if scenes:
            rows = [(scene.name.ljust(width), scene.description) for scene in scenes]
            print_table((kind, "shows"), rows)


def _render_one(
    scene: "Scene[Any]",
    options: Any,
    form: "Form",
    out: Path,
    overwrite: bool,
    draw: "DrawSheet | None",
) -> None:
    """Render a clip and print the paths of its files."""
    from dlgmd_cli.stimuli.encode import write_clip

    # A flight has noise unless told otherwise, and what its video keeps of it is a camera's share.
    is_smoothed = form.codec == "mpeg4" and not scene.is_playable and options.noise > 0.0
    if is_smoothed and not settings().quiet:
        say("Note: MPEG-4 smooths the noise; --lossless keeps every pixel of it.")
    with progress(scene.name, scene.n_frames(options)) as on_frame:
        paths = write_clip(
            scene, options, out, form, overwrite=overwrite, on_frame=on_frame, draw_sheet=draw
        )
    for path in paths:
        print_path(path)
