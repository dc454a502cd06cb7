"""`dlgmd export`: the model for other machines."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, print_json, print_path, print_table, settings
from dlgmd_cli.parameters.presets import PRESETS, SMALL_WIDTH_PX


@click.command(cls=Command, short_help="Write the model as C for a microcontroller.")
@options.option_group("named", dict, *options.ONE_MODEL, options.alarm_option)
@options.with_default(
    "--size", type=options.SIZE, default="96x72", help="Size of the frames in px."
)
@options.input_options("fov", "camera_tilt")
@click.option(
    "--prefix",
    default="",
    help="Beginning of the names of functions, types, macros and files; with different ones, "
    "several exports fit into one firmware.",
)
@options.folder_option(
    "-o", "--out", default=Path("dlgmd-c"), show_default=True, help="Folder for the sources."
)
@options.overwrite_option
def export(
    named: dict[str, Any],
    size: tuple[int, int],
    fov: float | None,
    camera_tilt: float | None,
    prefix: str,
    out: Path,
    overwrite: bool,
) -> None:
    """Write a D-LGMD, the expansion and the alarm as C99 for a microcontroller.

    \b
    Examples:
      dlgmd export                         # frames of 96x72 px
      dlgmd export --set 9 --size 160x120  # the paper's set 9
      dlgmd export --fov 120               # a wide lens

    The C code takes grey frames of one size, one byte per cell. For each frame, it returns the
    membrane potential, the time to contact, spike, alarm, and their place in the image. The
    expansion is measured unless spikes raise the alarm (--alarm spikes). The code allocates no
    memory and needs no library. The parameters are constants in the code.

    Writes the sources, an example, and a test with Python's answers ('make test'; 'make qemu' runs
    the test on emulated Cortex-M boards). DIR/README.md explains the files and states their memory
    and operations.

    Only the model dlgmd can be exported, in all its formulations. For frames up to 128 px wide, the
    default is the preset flight-small instead of flight.
    """
    from dlgmd_cli.export.project import Export, files
    from dlgmd_cli.models.windows import Camera
    from dlgmd_cli.results.store import claimed, file_of
    from dlgmd_cli.scenes import ball_approaches
    from dlgmd_cli.tasks.call import options_for
    from dlgmd_cli.tasks.camera import camera_of

    is_default = all(named[name] is None for name in ("set_name", "config", "model"))
    if is_default and size[0] <= SMALL_WIDTH_PX:  # small frames have a preset of their own
        named["set_name"] = PRESETS[-1]
    setup = options.setup_of(**named)
    chosen = "".join(f" --set {name}" for name in setup.config.named.values())
    reading = options_for(setup, {"fov": fov, "camera_tilt": camera_tilt})
    camera = camera_of(replace(reading, crop=None), size)[0] or Camera()
    if camera != Camera():
        chosen += f" --fov {camera.fov_deg:g} --camera-tilt {camera.tilt_deg:g}"
    exported = Export(
        setup.params, *size, setup.label, setup.config.model_fps, chosen, prefix, camera
    )
    contents = files(exported, ball_approaches(*size))
    with claimed(out, names=contents, overwrite=overwrite) as claim:
        claim.write({name: file_of(data) for name, data in contents.items()})
    if settings().as_json:
        print_json({"folder": str(out), **exported.costs})
        return
    print_path(out)
    print_table(("a frame costs", ""), [(key, f"{n:,}") for key, n in exported.costs.items()])
