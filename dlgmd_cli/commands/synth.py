"""`dlgmd synth`: stimuli with their ground truth."""

from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands._console import Command, print_path, print_table, say, settings
from dlgmd_cli.commands._types import OptionGroup, Size

scene_options = OptionGroup(
    "given",
    dict,
    click.option("--size", type=Size(), help="Size of the frames, even.  [default: 480x270]"),
    click.option("--fps", type=float, metavar="F", help="Frames per second.  [default: 30]"),
    click.option(
        "--frames",
        type=int,
        metavar="N",
        help="Length of the clip.  [default: all before contact; 75 where there is none]",
    ),
    click.option(
        "--object-size",
        type=float,
        metavar="S",
        help="Side or diameter: m, or px for translating-cubes.  "
        "[default: 0.5 m; a ninth of the height]",
    ),
    click.option(
        "--speed",
        type=float,
        multiple=True,
        metavar="V",
        help="Speed in m/s; for translating-cubes in px/frame, negative to the left, and "
        "repeatable for more cubes.  [default: 3 m/s; 1, 2, 3 and 4 px/frame]",
    ),
    click.option(
        "--distance",
        type=float,
        metavar="D",
        help="Distance in m at the first frame.  [default: 7.5; 0.1 for receding-cube]",
    ),
    click.option(
        "--contrast",
        type=float,
        metavar="C",
        help="Weber contrast: the object is 1 + C times as bright as the background.  "
        "[default: -0.75]",
    ),
    click.option(
        "--background",
        type=float,
        metavar="L",
        help="Luminance of the background, 0 to 1.  [default: 0.8]",
    ),
    click.option(
        "--noise",
        type=float,
        metavar="SD",
        help="Standard deviation of Gaussian luminance noise.  [default: 0]",
    ),
    click.option("--seed", type=int, metavar="N", help="Seed of the noise.  [default: 0]"),
    click.option(
        "--fov",
        type=float,
        metavar="DEG",
        help="Horizontal field of view of the camera.  [default: 60]",
    ),
)


@click.command(
    cls=Command,
    epilog="Example: dlgmd synth looming-cube --speed 5 --noise 0.02 --seed 1 --out stimuli",
)
@click.argument("scene_name", metavar="SCENE", required=False)
@scene_options
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path(),
    metavar="DIR",
    show_default="here",
    help="Folder for the files.",
)
@click.option("--lossless", is_flag=True, help="Write FFV1 in .avi, which keeps every grey level.")
@click.option("--overwrite", is_flag=True, help="Replace earlier files.")
@click.option("--list", "lists", is_flag=True, help="List the scenes and stop.")
def synth(
    scene_name: str | None,
    out: Path,
    lossless: bool,
    overwrite: bool,
    lists: bool,
    given: dict[str, Any],
) -> None:
    """Render a stimulus with its ground truth.

    Makes DIR/SCENE.mp4 and DIR/SCENE.csv; 'dlgmd synth --list' has the scenes. The truth has a row
    a frame: time, angular size, its rate of change, and time to contact.
    """
    from dlgmd_cli.stimuli.scenes import SCENES, find_scene

    if lists:
        print_table(("scene", "shows"), [(name, SCENES[name].description) for name in SCENES])
        return
    if scene_name is None:
        raise click.UsageError("Missing argument 'SCENE'. 'dlgmd synth --list' has them.")
    scene = find_scene(scene_name)
    options = scene.configure(_by_flag(given))
    from dlgmd_cli.stimuli.encode import write_clip

    if options.noise > 0.0 and not lossless and not settings().quiet:
        say("Note: MPEG-4 smooths the noise; --lossless keeps every pixel of it.")
    for path in write_clip(scene, options, out, lossless=lossless, overwrite=overwrite):
        print_path(path)


def _by_flag(given: dict[str, Any]) -> dict[str, Any]:
    """What the user has set, by flag, as scenes take it."""
    values = {
        f"--{name.replace('_', '-')}": value
        for name, value in given.items()
        if value not in (None, ())
    }
    if "--size" in values:
        width, height = values["--size"]
        values["--size"] = (height, width)
    return values
