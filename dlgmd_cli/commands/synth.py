"""`dlgmd synth`: render plain stimuli with their ground truth."""

import math
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, progress, show

# The options of scenes: type, metavar and help of each. The scenes check the ranges and define the
# defaults.
_SCENE_OPTIONS: dict[str, tuple[click.ParamType | type, str | None, str]] = {
    "size": (options.SIZE, None, "Size of the frames in px.  [default: 480x270]"),
    "fps": (float, "F", "Frames per second.  [default: 30]"),
    "frames": (int, "N", "Number of frames.  [default: until just before contact, or the end of "
        "the motion; at most 75 without contact]"),
    "hold": (float, "S", "Seconds for which the object is still after the motion.  [default: 0]"),
    "fov": (float, "DEG", "Horizontal field of view of the camera.  [default: 60]"),
    "speed": (float, "V", "Speed in m/s; px/frame where nothing approaches, negative to the left; "
        "degrees/frame for rotating. translating and translating-cubes: one object for each "
        "--speed.  [default: 3 m/s; 4 px/frame; 1, 2, 3 and 4 px/frame for cubes; "
        "3 degrees/frame]"),
    "l-over-v": (float, "MS", "Half the object's size over its speed, in ms, instead of --speed."),
    "distance": (float, "D", "Distance in m at the first frame, for receding at the last.  "
        "[default: 7.5; 0.1 for receding-cube]"),
    "final-angle": (float, "DEG", "Angular size at which the motion ends.  [default: contact]"),
    "object-size": (float, "S", "Side or diameter of the object in m; in px where nothing "
        "approaches: the width of a bar or stripe, the side of a square, the thickness of what "
        "grows.  [default: 0.5 m; a ninth of the height, nine tenths of "
        "it for what grows]"),
    "vertical": (bool, None, "Move, grow or drift downwards instead of to the right."),
    "contrast": (float, "C", "Weber contrast: the object is 1 + C times as bright as the "
        "background.  [default: -0.75]"),
    "light": (bool, None, "Exchange the two: a light object on a dark background."),
    "background": (float, "L", "Luminance of the background, 0 to 1.  [default: 0.8]"),
    "background-image": (str, "FILE", "An image behind the object; its mean is the background."),
    "noise": (float, "SD", "Standard deviation of the noise in each pixel, as a fraction of white."
        "  [default: 0]"),
    "seed": (int, "N", "Seed of the noise.  [default: 0]"),
}  # fmt: skip


def _complete_scene(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    from dlgmd_cli.scenes.objects import SCENES

    scenes = {scene.name: scene.description for scene in SCENES.values()}
    scenes["benchmark"] = "the basic videos of the LGMD benchmark"
    known = (name for name in scenes if name.startswith(incomplete))
    return [CompletionItem(name, help=scenes[name]) for name in known]


def _scene_options(command: Any) -> Any:
    for name, (kind, metavar, text) in reversed(_SCENE_OPTIONS.items()):
        facts: dict[str, Any] = {"help": text, "cls": options.SectionOption, "section": "Stimulus"}
        if kind is bool:
            facts |= {"is_flag": True}
        else:
            kind = options.numeric(kind, -math.inf) if kind in (int, float) else kind
            facts |= {"type": kind, "metavar": metavar, "multiple": name == "speed"}
        command = click.option(f"--{name}", **facts)(command)
    return command


@click.command(cls=Command)
@click.argument("scene", metavar="SCENE", shell_complete=_complete_scene)
@options.folder_option(
    "-o", "--out", default=Path(), show_default=True, help="Folder for the files."
)
@click.option(
    "--lossless/--mp4",
    default=True,
    show_default=True,
    help="FFV1 in .avi, or MPEG-4, in which slow frames may become duplicates.",
)
@options.overwrite_option
@_scene_options
def synth(scene: str, out: Path, **given: Any) -> None:
    """Render a plain stimulus with its ground truth.

    \b
    Examples:
      dlgmd synth looming --l-over-v 50 --final-angle 60 --hold 0.5  # stops at 60 degrees
      dlgmd synth ball --light --noise 0.01      # a light ball, with a little noise
      dlgmd synth translating --speed -2         # a bar that crosses to the left
      dlgmd synth benchmark --out lgmd           # the basic videos of the LGMD benchmark

    SCENE is looming or receding (a square), ball or capsule (which approach), looming-cube (the
    same as looming), looming-ball (the same as ball), receding-cube (for as long as --frames says),
    translating (a bar), translating-cubes, elongating, shortening, grating, rotating (a bar), or
    benchmark. 'dlgmd lab fly' renders flights through rooms.

    Writes DIR/NAME.avi (with --mp4 NAME.mp4; --overwrite removes the other) and DIR/NAME.csv, which
    has the ground truth of each frame. benchmark takes no option of the stimulus, and writes
    sixteen videos, 432x240, 50 frames, into the folders of their classes, and DIR/annotations.json
    for 'dlgmd evaluate'.
    """
    from dlgmd_cli.tasks import synth as task

    show(task.synth(scene, out, progress=progress, **given))
