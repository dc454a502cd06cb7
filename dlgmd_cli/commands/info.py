"""`dlgmd info`: describe videos, and suggest options for a run."""

import logging
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from dlgmd_cli.commands import defaults
from dlgmd_cli.commands.console import (
    Command,
    Failed,
    print_json,
    print_path,
    print_table,
    settings,
    settings_option,
    warn,
)
from dlgmd_cli.commands.frame import write_files
from dlgmd_cli.commands.options import (
    complete_file,
    decoder_option,
    file_ending,
    input_fps_option,
    json_option,
    overwrite_option,
)
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.errors import DlgmdError, SourceError, printable
from dlgmd_cli.parameters import DEFAULT_WIDTH_PX, PRESETS, load_config

if TYPE_CHECKING:
    from dlgmd_cli.video.survey import Survey

_log = logging.getLogger(__name__)

# Pictures a second below which an approach looks too fast to the model.
_SLOW_FPS = 20.0


@click.command(
    cls=Command,
    short_help="Describe videos: size, frame rate, repeats, damage.",
    epilog="Example: dlgmd info flight.mp4 --write-mask mask.png",
)
@click.argument("input_paths", metavar="INPUT...", nargs=-1, shell_complete=complete_file)
@settings_option(
    is_flag=False,
    flag_value="",
    help=f"Without INPUT: show the own defaults in {defaults.NAME}, or in FILE.",
)
@click.option(
    "--write-mask",
    "mask_path",
    type=file_ending("mask.png"),
    metavar="FILE.png",
    help="Write a mask for --mask: black where pixels never change, such as an on-screen display.",
)
@overwrite_option
@input_fps_option
@decoder_option
@json_option
def info(
    input_paths: tuple[str, ...],
    mask_path: Path | None,
    overwrite: bool,
    input_fps: float | None,
    decoder: str | None,
    as_json: bool,
) -> None:
    """Describe videos: size, codec, frame rate, repeated frames, damage.

    INPUT is as in 'dlgmd run', and is read to the end. Below the facts, the command suggests
    options of 'dlgmd run', or what to do with the file first.

    'dlgmd info --settings' shows your own defaults of options. The file dlgmd.yaml, in the working
    folder or in one above it, may set size, mask, decoder, format and out, such as 'out: results'
    on a line. Paths are relative to the file. Options take precedence over it.
    """
    if not input_paths:
        _show_settings(as_json=as_json)
        return
    if mask_path is not None and len(input_paths) > 1:
        raise click.UsageError("--write-mask works with one INPUT.")

    from dlgmd_cli.results.store import refuse_existing
    from dlgmd_cli.video.base import DEFAULT_DECODER
    from dlgmd_cli.video.survey import survey

    if mask_path is not None:
        refuse_existing(mask_path, overwrite=overwrite, option="--write-mask")
    found: list[dict[str, Any]] = []
    for path in input_paths:
        try:
            with progress(path, None) as on_frame:
                facts = survey(
                    path, decoder=decoder or DEFAULT_DECODER, input_fps=input_fps, on_frame=on_frame
                )
        except DlgmdError as error:
            if len(input_paths) == 1:
                raise
            _log.error("%s", str(error).rstrip("."))
            found.append({"path": path, "error": printable(str(error))})
            continue
        found.append(_facts(facts))
        if not as_json:
            print_table(("", printable(facts.path)), _rows(facts))
            for line in found[-1]["advice"]:
                click.echo(printable(line))
            for warning in facts.warnings:
                warn(f"{facts.path}: {warning}")
        if mask_path is not None:
            _write_mask(mask_path, facts, overwrite=overwrite)
    if as_json:
        print_json({"inputs": found})
    elif mask_path is not None:
        print_path(mask_path)
    if n_failed := sum("error" in one for one in found):
        raise Failed(f"{n_failed} of {len(input_paths)} inputs failed.")


def _show_settings(*, as_json: bool) -> None:
    """Print the own defaults; raises UsageError if --settings is not given."""
    source = click.get_current_context().get_parameter_source("own_defaults")
    if source is ParameterSource.DEFAULT and settings().own_defaults is None:
        raise click.UsageError("Missing argument 'INPUT...'.")
    path = defaults.find(settings().own_defaults)
    values = {} if path is None else defaults.read(path)
    if as_json:
        print_json({"settings": None if path is None else str(path), **values})
        return
    if path is None:
        click.echo(f"There is no {defaults.NAME} here or in a folder above. It may set:")
    rows = [
        (key, ", ".join([values[key]] if isinstance(values[key], str) else values[key]))
        for key in defaults.KEYS
        if key in values
    ]
    rows = rows if path else list(defaults.KEYS.items())
    print_table(("", "" if path is None else str(path)), rows)


def _write_mask(path: Path, facts: "Survey", *, overwrite: bool) -> None:
    """Write a picture of the input's size, black in the borders and where pixels never change."""
    import cv2
    import numpy as np

    if facts.mask is None:
        why = "no pixels stay the same while the others change"
        raise SourceError(facts.path, why, "Paint a mask yourself, or leave it out.")
    _, encoded = cv2.imencode(".png", np.where(facts.mask, np.uint8(0), np.uint8(255)))
    write = partial(Path.write_bytes, data=encoded.tobytes())
    write_files({path: write}, overwrite=overwrite, option="--write-mask")


def _rows(facts: "Survey") -> list[tuple[str, str]]:
    codec = facts.codec or "unknown"
    if facts.pixel_format:
        codec += f", {facts.pixel_format}, {facts.bits} bits"
    elif facts.fps_stated is not None:
        codec += " (FOURCC; the package 'av' would tell more)"
    interlaced = {True: "yes", False: "no", None: "unknown without the package 'av'"}
    repeats = "none"
    if facts.repeats:
        repeats = f"{facts.repeats} of {facts.frames} ({100 * facts.repeats / facts.frames:.0f} %)"
    rows = [
        ("size", f"{facts.width}x{facts.height}"),
        ("codec", codec),
        ("frames", f"{facts.frames}, {facts.duration_s:.3f} s"),
        ("frame rate", _rate(facts)),
        ("repeated frames", repeats),
        ("interlaced", interlaced[facts.is_interlaced]),
        ("decoder", facts.decoder),
    ]
    if facts.turned_deg:
        rows.insert(1, ("rotation", f"{facts.turned_deg}° clockwise, as the file asks"))
    if facts.gaps:
        rows.append(("gaps", f"{facts.gaps}; the model begins anew after each"))
    rows += [("damage", line) for line in facts.damage or ["none found"]]
    if facts.crop is not None:
        rows.append(("without black borders", str(facts.crop)))
    if facts.still is not None:
        rows.append(("never changes", f"{100 * facts.still_share:.2g} % of the pixels"))
    return rows


def _rate(facts: "Survey") -> str:
    """The frame rate as stated and as measured, in words."""
    if facts.fps_true is None or facts.fps_range is None:
        return "none" if facts.fps_stated is None else f"{facts.fps_stated:.6g} stated"
    stated = "none" if facts.fps_stated is None else f"{facts.fps_stated:.6g}"
    kind = "constant"
    if facts.is_variable:
        kind = "variable, {:.3g} to {:.3g}".format(*facts.fps_range)
    return f"{stated} stated, {facts.fps_true:.6g} true, {kind}"


def _facts(facts: "Survey") -> dict[str, Any]:
    values = {name: value for name, value in vars(facts).items() if name != "still"}
    crop = None if facts.crop is None else str(facts.crop)
    return {**values, "crop": crop, "still_share": facts.still_share, "advice": _advice(facts)}


def _advice(facts: "Survey") -> list[str]:
    """Advice for a run on this input, one sentence each."""
    has_fine_levels = facts.bits is not None and facts.bits > 8
    others = (
        (
            facts.is_interlaced,
            "It is interlaced: all commands read it by PyAV and de-interlace it (FFmpeg's bwdif, "
            "one picture a frame).",
        ),
        (
            has_fine_levels and facts.decoder == "opencv",
            f"--decoder pyav keeps all {facts.bits} bits of a sample, opencv keeps 8.",
        ),
        (
            facts.damage,
            "Do not trust the response near the damage: copy the file again, or run the part "
            "before it with --end.",
        ),
        (facts.crop, f"The borders are black: --crop {facts.crop} leaves them out."),
        (
            facts.still is not None,
            f"{100 * facts.still_share:.2g} % of the pixels never change, as those of an on-screen "
            "display or of the vehicle itself: 'dlgmd info --write-mask mask.png' paints them "
            "black for --mask. Look at it before you use it.",
        ),
    )
    return [*_rate_advice(facts), _size_advice(facts), *(line for is_due, line in others if is_due)]


def _rate_advice(facts: "Survey") -> list[str]:
    from dlgmd_cli.frame import RATE_TOLERANCE, sampling_step

    lines = []
    fps = facts.fps_true or facts.fps_stated
    model_fps = load_config(PRESETS[0]).model_fps
    if facts.fps_stated is None:
        lines.append("Nothing states the frame rate: give it with --input-fps.")
    if facts.is_variable:
        lines.append(
            "The frame rate varies, and the model counts frames, not seconds: record at a "
            "constant rate, or convert with 'ffmpeg -i INPUT -r 30 OUTPUT'."
        )
    every, _ = sampling_step(facts.fps_stated or 0.0, RATE_TOLERANCE * model_fps)
    if every > 1:
        lines.append(
            f"At most {model_fps:g} frames a second are processed by default: one in {every} of "
            f"these. --fps all processes every frame."
        )
    n_new = facts.frames - facts.repeats
    rate = None if fps is None else fps * n_new / max(facts.frames, 1)
    if rate is not None and rate < _SLOW_FPS:
        lines.append(
            f"At {rate:.3g} pictures a second an approach looks {model_fps / rate:.2g} times as "
            f"fast as at the {model_fps:g} that the parameters are made for."
        )
    return lines


def _size_advice(facts: "Survey") -> str:
    """The size at which the models see the input."""
    from dlgmd_cli.video.opening import processed_size

    source_wh = facts.crop[:2] if facts.crop else (facts.width, facts.height)

    def default(width_px: int) -> str:
        width, height = processed_size(*source_wh, width_px=width_px)
        return f"{width}x{height} px (--scale {width / source_wh[0]:.3g})"

    preset = PRESETS[0]
    return (
        f"The preset {preset} processes it at {default(load_config(preset).width_px)}, the "
        f"paper's sets at {default(DEFAULT_WIDTH_PX)}."
    )
