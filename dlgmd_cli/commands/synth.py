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
    "frames": (int, "N", "Number of frames.  [default: until just before contact; 75 without "
        "contact]"),
    "fov": (float, "DEG", "Horizontal field of view of the camera.  [default: 60]"),
    "speed": (float, "V", "Speed in m/s. In translating-cubes: px/frame, negative to the left, one "
        "cube for each --speed.  [default: 3 m/s; 1, 2, 3 and 4 px/frame]"),
    "distance": (float, "D", "Distance in m at the first frame.  [default: 7.5; receding-cube "
        "0.1]"),
    "object-size": (float, "S", "Side or diameter of the object in m; in px for "
        "translating-cubes.  [default: 0.5 m; a ninth of the height]"),
    "contrast": (float, "C", "Weber contrast: the object is 1 + C times as bright as the "
        "background.  [default: -0.75]"),
    "background": (float, "L", "Luminance of the background, 0 to 1.  [default: 0.8]"),
    "noise": (float, "SD", "Standard deviation of the noise in each pixel, as a fraction of white."
        "  [default: 0]"),
    "seed": (int, "N", "Seed of the noise.  [default: 0]"),
}  # fmt: skip


def _complete_scene(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    from dlgmd_cli.scenes import SCENES

    scenes = [scene for name, scene in SCENES.items() if name.startswith(incomplete)]
    return [CompletionItem(scene.name, help=scene.description) for scene in scenes]


def _scene_options(command: Any) -> Any:
    for name, (kind, metavar, text) in reversed(_SCENE_OPTIONS.items()):
        kind = options.numeric(kind, -math.inf) if kind in (int, float) else kind
        facts = {"type": kind, "metavar": metavar, "help": text, "multiple": name == "speed"}
        command = click.option(f"--{name}", cls=options.SectionOption, section="Stimulus", **facts)(
            command
        )
    return command


@click.command(cls=Command)
@click.argument("scene", metavar="SCENE", shell_complete=_complete_scene)
@options.folder_option(
    "-o", "--out", default=Path(), show_default="here", help="Folder for the files."
)
@click.option("--lossless", is_flag=True, help="Write a lossless video (FFV1 in .avi).")
@options.overwrite_option
@_scene_options
def synth(scene: str, out: Path, **given: Any) -> None:
    """Render a plain stimulus with its ground truth.

    \b
    Examples:
      dlgmd synth looming-cube --speed 5        # a cube that approaches at 5 m/s
      dlgmd synth looming-ball --noise 0.01     # a ball, with a little noise
      dlgmd synth translating-cubes --speed -2  # a cube that crosses to the left

    SCENE is looming-cube, receding-cube, looming-ball or translating-cubes: a plain object on a
    plain background. 'dlgmd lab fly' renders flights through rooms.

    Writes DIR/NAME.mp4 and DIR/NAME.csv, which has the ground truth of each frame.
    """
    from dlgmd_cli.tasks import synth as task

    show(task.synth(scene, out, progress=progress, **given))
