"""`dlgmd synth`: render stimuli with their ground truth."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from dlgmd_cli.cancel import EXIT_INTERRUPTED, Interrupted
from dlgmd_cli.commands.console import Command, Failed, note, print_path, print_table, say, tell
from dlgmd_cli.commands.options import (
    SIZE,
    SectionOption,
    complete_folder,
    dpi_option,
    folder_name,
    is_file_name,
    numeric,
    overwrite_option,
)
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.threads import n_processors

if TYPE_CHECKING:
    from dlgmd_cli.lab.flights.dataset import FlightSet
    from dlgmd_cli.lab.stimuli.clip import DrawSheet, Rendering

_PICTURE, _FLIGHTS = "Picture", "Flights only"
# The options of scenes by section of the help: type, metavar and help of each. The scenes check the
# ranges, and have the defaults.
_SCENE_OPTIONS: dict[str, dict[str, tuple[Any, str | None, str]]] = {
    _PICTURE: {
        "size": (SIZE, None, "Size of the frames in px.  [default: the scene's own; flat scenes "
            "480x270]"),
        "fps": (float, "F", "Frames per second.  [default: 30]"),
        "frames": (int, "N", "Number of frames.  [default: the whole flight; flat scenes: until "
            "just before contact, 75 without contact]"),
        "fov": (float, "DEG", "Horizontal field of view of the camera.  [default: flights 80, flat "
            "scenes 60]"),
        "noise": (float, "SD", "Standard deviation of the noise in each pixel, as a fraction "
            "of white: of linear light in flights, of luminance in flat scenes.  "
            "[default: flights 0.002, flat scenes 0]"),
        "seed": (int, "N", "Seed of the noise and, in flights, of everything that is random.  "
            "[default: 0]"),
    },
    _FLIGHTS: {
        "exposure": (float, "MS", "Exposure time in ms, which causes motion blur.  [default: 0]"),
        "rolling-shutter": (float, "MS", "Delay in ms between the first and the last row.  "
            "[default: 0]"),
        "vignette": (float, "V", "Fraction of the light that is lost in the corners, 0 to 1.  "
            "[default: 0.3]"),
        "shot-noise": (float, "SD", "Standard deviation of the shot noise at full light; its "
            "variance is proportional to the light.  [default: 0.01]"),
        "gamma": (float, "G", "Grey levels are light to the power of 1/G.  [default: 2.2]"),
    },
    "Flat scenes only": {
        "object-size": (float, "S", "Side or diameter of the object in m; in px for "
            "translating-cubes.  [default: 0.5 m; a ninth of the height]"),
        "speed": (float, "V", "Speed in m/s. In translating-cubes: px/frame, negative to the "
            "left, one cube for each --speed.  [default: 3 m/s; 1, 2, 3 and 4 px/frame]"),
        "distance": (float, "D", "Distance in m at the first frame.  [default: 7.5; "
            "receding-cube 0.1]"),
        "contrast": (float, "C", "Weber contrast: the object is 1 + C times as bright as the "
            "background.  [default: -0.75]"),
        "background": (float, "L", "Luminance of the background, 0 to 1.  [default: 0.8]"),
    },
}  # fmt: skip


_flight_option = partial(click.option, cls=SectionOption, section=_FLIGHTS)


def _complete_scene(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    from dlgmd_cli.lab.flights.scenes import SCENES

    scenes = [scene for name, scene in SCENES.items() if name.startswith(incomplete)]
    return [CompletionItem(scene.name, help=scene.description) for scene in scenes]


def _file_name(ctx: click.Context, param: click.Parameter, value: str | None) -> str | None:
    """A name without folder and suffix."""
    is_name = value is None or (value.strip(". ") and Path(value).name == value)
    if not is_name or (value and (value[0] == "." or is_file_name(Path(value)))):
        raise click.BadParameter(
            f"{value!r} is not a name. Write loom-2, without folder and suffix."
        )
    return value


def _scene_options(command: Any) -> Any:
    for section in reversed(_SCENE_OPTIONS):
        for name, (kind, metavar, text) in reversed(_SCENE_OPTIONS[section].items()):
            facts = {"type": kind, "metavar": metavar, "help": text, "multiple": name == "speed"}
            option = click.option(f"--{name}", cls=SectionOption, section=section, **facts)
            command = option(command)
    return command


@click.command(
    cls=Command,
    epilog="Example: dlgmd synth looming-cube --speed 5 --noise 0.02 --seed 1 --out stimuli",
)
@click.argument("scene_name", metavar="SCENE", required=False, shell_complete=_complete_scene)
@click.option("--list", "lists", is_flag=True, help="List the scenes and exit.")
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    default=Path(),
    callback=folder_name,
    metavar="DIR",
    show_default="here",
    shell_complete=complete_folder,
    help="Folder for the files.",
)
@click.option(
    "--name",
    callback=_file_name,
    metavar="NAME",
    help="Name of the files, so that two seeds do not collide.  [default: the scene's]",
)
@click.option("--lossless", is_flag=True, help="Write a lossless video (FFV1 in .avi).")
@click.option("--png", is_flag=True, help="Write a folder of PNG pictures instead of a video.")
@click.option("--sheet", is_flag=True, help="Also draw a contact sheet of up to 12 frames.")
@dpi_option
@overwrite_option
@_scene_options
@_flight_option(
    "--agile/--stabilised",
    default=None,
    help="Whether the drone moves abruptly, like a racing drone, or smoothly, like a camera "
    "drone.  [default: the scene's own; in 'random', a quarter of the flights are agile]",
)
@_flight_option(
    "--count",
    type=numeric(int, 1, 1_000_000),
    metavar="N",
    help="Render N flights with consecutive seeds, and write DIR/labels.csv.",
)
@_flight_option(
    "--jobs",
    type=numeric(int, 1, 512),
    metavar="N",
    help="With --count: number of processes.  [default: all processors]",
)
def synth(
    scene_name: str | None,
    lists: bool,
    out: Path,
    name: str | None,
    lossless: bool,
    png: bool,
    sheet: bool,
    dpi: int,
    overwrite: bool,
    count: int | None,
    jobs: int | None,
    **given: Any,
) -> None:
    """Render a stimulus with its ground truth.

    SCENE is a flight through a rendered room, or a flat scene: a plain object on a plain
    background. 'dlgmd synth --list' lists the scenes.

    Writes DIR/NAME.mp4 and DIR/NAME.csv, which has the ground truth of each frame. For a flight,
    DIR/NAME.yaml has its phases and the frame of the collision. --sheet adds DIR/NAME-sheet.png, a
    contact sheet of frames with their ground truth.

    With --count, writes DIR/NAME-0000.mp4 and so on, and DIR/labels.csv. Flights that already exist
    are kept: after an interruption, run the same command again to continue.

    Half of the flights of 'random' hit something. The others are as hard as real footage. Column
    manner of the labels says how each is flown: pass, stop (miss an obstacle), gusts, turns, close
    (past things), low (over tiles and lines), people (who walk past), light (shadows and exposure)
    or walk (a camera in the hand).
    """
    if count is None and jobs is not None:
        raise click.UsageError("--jobs works only with --count. Add it.")
    if lists:
        _list()
        return
    if scene_name is None:
        raise click.UsageError("Missing argument 'SCENE'. 'dlgmd synth --list' lists the scenes.")
    from dlgmd_cli.lab.flights.scenes import find_scene
    from dlgmd_cli.lab.stimuli.clip import Rendering, choose_codec

    scene = find_scene(scene_name)
    options = scene.configure(_by_flag(given))
    codec = choose_codec(lossless=lossless, png=png, playable=scene.is_flight)
    draw: DrawSheet | None = None
    if sheet:  # only now, as importing Matplotlib takes time
        from dlgmd_cli.lab.plots.contact_sheet import save_contact_sheet

        draw = partial(save_contact_sheet, dpi=dpi)
    clip = Rendering(scene, options, out, codec, name or scene.name, draw)
    if count is None:
        _render_one(clip, overwrite)
        return
    if not scene.is_flight:
        raise click.UsageError(f"--count works only with flights, and {scene.name} is not one.")
    from dlgmd_cli.lab.flights.dataset import FlightSet

    _render_fleet(FlightSet(clip, count), jobs, overwrite)


def _by_flag(given: dict[str, Any]) -> dict[str, Any]:
    """The options that the user has set, by flag, as scenes take them; sizes are (H, W)."""
    if given["size"]:
        given["size"] = given["size"][::-1]
    return {
        f"--{name.replace('_', '-')}": value
        for name, value in given.items()
        if value not in (None, ())
    }


def _list() -> None:
    from dlgmd_cli.lab.flights.scenes import SCENES

    width = max(map(len, SCENES))
    for kind, is_flight in (("flight", True), ("flat scene", False)):
        scenes = [s for s in SCENES.values() if s.is_flight == is_flight]
        print_table((kind, "shows"), [(s.name.ljust(width), s.description) for s in scenes])


def _render_one(clip: "Rendering", overwrite: bool) -> None:
    from dlgmd_cli.results.store import locked

    scene, options = clip.scene, clip.options
    # Flights have noise by default, and a camera's video would be compressed as well: no note.
    is_smoothed = clip.codec == "mpeg4" and not scene.is_flight and vars(options)["noise"] > 0.0
    if is_smoothed:
        note("MPEG-4 smooths the noise; --lossless keeps every pixel of it")
    with locked(clip.folder), progress(scene.name, scene.n_frames(options)) as on_frame:
        paths = clip.write(overwrite=overwrite, on_frame=on_frame)
    for path in paths:
        print_path(path)


def _render_fleet(flights: "FlightSet", jobs: int | None, overwrite: bool) -> None:
    """Render the missing flights, and write the labels of all that exist, even after an error."""
    from dlgmd_cli.results.store import locked

    is_interrupted = False
    with locked(flights.like.folder):
        present = flights.present()
        missing = [number for number in range(flights.count) if number not in present]
        flights.check(missing, overwrite=overwrite)
        if present:
            tell(f"{len(present)} of {flights.count} flights were already there.")
        try:
            _render_missing(flights, missing, jobs or n_processors(), overwrite)
        except (Interrupted, KeyboardInterrupt):
            is_interrupted = True
        except Exception:
            if len(flights.present()) > len(present):
                say(_kept(flights, _label(flights, overwrite)))
            raise
        n_present = _label(flights, overwrite)
    if is_interrupted:
        say(f"Interrupted. {_kept(flights, n_present)}" if n_present else "Interrupted.")
        raise click.exceptions.Exit(EXIT_INTERRUPTED)
    if n_present < flights.count:
        raise Failed(
            f"{flights.count - n_present} of {flights.count} flights failed; the other {n_present} "
            f"are in {flights.like.folder}. Fix what is named above, then run the same command "
            "again."
        )


def _render_missing(flights: "FlightSet", missing: list[int], jobs: int, overwrite: bool) -> None:
    """Render flights, and report those that fail."""
    n_present = flights.count - len(missing)
    n_jobs = min(jobs, max(1, len(missing)))
    with progress(flights.like.name, flights.count, "flight") as on_flight:
        on_flight(n_present)
        done = flights.render(missing, n_jobs, overwrite=overwrite)
        for n_done, (number, error) in enumerate(done, start=n_present + 1):
            if error is not None:
                name = flights.clip(number).name
                say(str(error) if name in error.what else f"{name}: {error}")
            on_flight(n_done)


def _label(flights: "FlightSet", overwrite: bool) -> int:
    """Write the labels of the existing flights, if there are any; returns their number."""
    labels = flights.present()
    if labels:
        flights.write_labels(labels, overwrite=overwrite)
        print_path(flights.labels_path)
    return len(labels)


def _kept(flights: "FlightSet", n_present: int) -> str:
    return (
        f"{flights.like.folder} holds {n_present} of {flights.count} flights; "
        "run the same command again for the others."
    )
