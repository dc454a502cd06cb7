"""`dlgmd synth`: render stimuli with their ground truth."""

from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, print_table, progress, show
from dlgmd_cli.parameters.checks import Spec

_PICTURE, _FLIGHTS = "Image", "Flights only"


def _speed(text: str) -> tuple[float, ...]:
    """`1:3` -> (1.0, 3.0), and `5` -> (5.0,)."""
    return tuple(Spec().parse(part) for part in text.split(":", 1))


# The options of scenes by section of the help: type, metavar and help of each. The scenes check the
# ranges, and have the defaults.
_SCENE_OPTIONS: dict[str, dict[str, tuple[Any, str | None, str]]] = {
    _PICTURE: {
        "size": (options.SIZE, None, "Size of the frames in px.  [default: the scene's own; flat "
            "scenes 480x270]"),
        "fps": (float, "F", "Frames per second.  [default: 30]"),
        "frames": (int, "N", "Number of frames.  [default: the whole flight; flat scenes: until "
            "just before contact, 75 without contact]"),
        "fov": (float, "DEG", "Horizontal field of view of the camera.  [default: flights 80, flat "
            "scenes 60]"),
        "noise": (float, "SD", "Standard deviation of the noise in each pixel, as a fraction "
            "of white: of linear light in flights, of luminance in flat scenes.  "
            "[default: flights 0.002, flat scenes 0]"),
        "speed": (options.Parsed("speed", _speed), "V|MIN:MAX", "Speed in m/s; in 'random', the "
            "cruising speed, or that of an approaching object. In translating-cubes: px/frame, "
            "negative to the left, one cube for each --speed.  [default: 3 m/s; 1, 2, 3 and 4 "
            "px/frame; 'random': 0.6 to 2.9 m/s mostly]"),
        "seed": (int, "N", "Seed of the noise and, in flights, of everything that is random.  "
            "[default: 0]"),
    },
    _FLIGHTS: {
        "camera-tilt": (float, "DEG", "Angle at which the camera is mounted on the drone, upwards "
            "positive, -45 to 45.  [default: 0]"),
        "exposure": (float, "MS", "Exposure time in ms, which causes motion blur.  [default: 0]"),
        "rolling-shutter": (float, "MS", "Delay in ms between the first and the last row.  "
            "[default: 0]"),
        "vignette": (float, "V", "Fraction of the light that is lost in the corners, 0 to 1.  "
            "[default: 0.3]"),
        "shot-noise": (float, "SD", "Standard deviation of the shot noise at full light; its "
            "variance is proportional to the light.  [default: 0.01]"),
        "manner": (str, "NAME", "In 'random': the scenario, such as hit, pass, approached or "
            "crossed.  [default: drawn by the seed]"),
        "gamma": (float, "G", "Grey levels are light to the power of 1/G.  [default: 2.2]"),
    },
    "Flat scenes only": {
        "object-size": (float, "S", "Side or diameter of the object in m; in px for "
            "translating-cubes.  [default: 0.5 m; a ninth of the height]"),
        "distance": (float, "D", "Distance in m at the first frame.  [default: 7.5; "
            "receding-cube 0.1]"),
        "contrast": (float, "C", "Weber contrast: the object is 1 + C times as bright as the "
            "background.  [default: -0.75]"),
        "background": (float, "L", "Luminance of the background, 0 to 1.  [default: 0.8]"),
    },
}  # fmt: skip


_flight_option = partial(click.option, cls=options.SectionOption, section=_FLIGHTS)


def _complete_scene(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    from dlgmd_cli.scenes.flights.scenes import SCENES

    scenes = [scene for name, scene in SCENES.items() if name.startswith(incomplete)]
    return [CompletionItem(scene.name, help=scene.description) for scene in scenes]


def _file_name(ctx: click.Context, param: click.Parameter, value: str | None) -> str | None:
    """A name without folder and suffix."""
    is_name = value is None or (value.strip(". ") and Path(value).name == value)
    if not is_name or (value and (value[0] == "." or options.is_file_name(Path(value)))):
        raise click.BadParameter(
            f"{value!r} is not a name. Write loom-2, without folder and suffix."
        )
    return value


def _scene_options(command: Any) -> Any:
    for section in reversed(_SCENE_OPTIONS):
        for name, (kind, metavar, text) in reversed(_SCENE_OPTIONS[section].items()):
            facts = {"type": kind, "metavar": metavar, "help": text, "multiple": name == "speed"}
            option = click.option(f"--{name}", cls=options.SectionOption, section=section, **facts)
            command = option(command)
    return command


@click.command(cls=Command)
@click.argument("scene_name", metavar="SCENE", required=False, shell_complete=_complete_scene)
@click.option("--list", "lists", is_flag=True, help="List the scenes and exit.")
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    default=Path(),
    callback=options.folder_name,
    metavar="DIR",
    show_default="here",
    shell_complete=options.complete_folder,
    help="Folder for the files.",
)
@click.option(
    "--name",
    callback=_file_name,
    metavar="NAME",
    help="Name of the files, so that two seeds do not collide.  [default: the scene's]",
)
@click.option("--lossless", is_flag=True, help="Write a lossless video (FFV1 in .avi).")
@click.option("--png", is_flag=True, help="Write a folder of PNG images instead of a video.")
@click.option("--sheet", is_flag=True, help="Also draw a contact sheet of up to 12 frames.")
@options.dpi_option
@options.overwrite_option
@_scene_options
@_flight_option(
    "--agile/--stabilised",
    default=None,
    help="Whether the drone moves abruptly, like a racing drone, or smoothly, like a camera "
    "drone.  [default: the scene's own; in 'random', a quarter of the flights are agile]",
)
@_flight_option(
    "--count",
    type=options.numeric(int, 1, 1_000_000),
    help="Render N flights with consecutive seeds, and write DIR/labels.csv.",
)
@_flight_option(
    "--avoid",
    metavar="PRESET",
    help="Stop the drone at the alarm of a preset (flight), a set (9) or a file, and film the "
    "flight without and with it.",
)
@_flight_option(
    "--jobs",
    type=options.numeric(int, 1, 512),
    help="With --count: number of processes.  [default: all processors]",
)
def synth(scene_name: str | None, lists: bool, out: Path, **given: Any) -> None:
    """Render a stimulus with its ground truth.

    \b
    Examples:
      dlgmd synth looming-cube --speed 5        # a cube that approaches at 5 m/s
      dlgmd synth group2 --size 480x270         # the paper's group 2, a flight
      dlgmd synth random --count 20 -o flights  # 20 random flights, labels.csv

    SCENE is a flight through a rendered room, or a flat scene: a plain object on a plain
    background. 'dlgmd synth --list' lists the scenes.

    Writes DIR/NAME.mp4 and DIR/NAME.csv, which has the ground truth of each frame. For a flight,
    DIR/NAME.yaml has its phases and the frame of the collision. --sheet adds DIR/NAME-sheet.png, a
    contact sheet of frames with their ground truth.

    With --count, writes DIR/NAME-0000.mp4 and so on, and DIR/labels.csv. Flights that already exist
    are kept: after an interruption, run the same command again to continue.

    With --avoid, writes DIR/NAME-avoid.mp4 instead, a film of the flight without and with the
    alarm: the model processes each frame, and at its first alarm the drone brakes, as in 'dlgmd
    evaluate'. DIR/NAME-avoid.png is the film's frame at the collision, and DIR/NAME-avoid.csv has a
    row for each frame of both flights.

    Half of the flights of 'random' hit something; the others are as hard as real footage. The
    column manner of the labels has the scenario: hit, wall, pass, stop (miss an obstacle), gusts,
    storm, turns, close (past things), low (over tiles and lines), people (who walk past), light
    (shadows and exposure), walk (a hand-held camera), approached (a ball, a person or another drone
    hits the drone, which hovers) or crossed (it passes by).
    """
    if lists:
        _list()
        return
    if scene_name is None:
        raise click.UsageError("Missing argument 'SCENE'. 'dlgmd synth --list' lists the scenes.")
    from dlgmd_cli.tasks import synth as task

    given["speed"] = tuple(chain.from_iterable(given["speed"]))
    show(task.synth(scene_name, out, progress=progress, **given))


def _list() -> None:
    from dlgmd_cli.scenes.flights.scenes import SCENES

    width = max(map(len, SCENES))
    for kind, is_flight in (("flight", True), ("flat scene", False)):
        scenes = [s for s in SCENES.values() if s.is_flight == is_flight]
        print_table((kind, "shows"), [(s.name.ljust(width), s.description) for s in scenes])
