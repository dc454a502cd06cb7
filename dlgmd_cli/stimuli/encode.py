"""A scene as a clip with its ground truth beside it; all files appear whole or not at all."""

import csv
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

from dlgmd_cli.results.cells import cell, text_cell
from dlgmd_cli.results.clip_sheet import ClipSheet
from dlgmd_cli.results.files import appearing, refuse_existing, refuse_foreign
from dlgmd_cli.results.record import versions, yaml_text
from dlgmd_cli.stimuli.base import GreyImage, OptionsT, Scene
from dlgmd_cli.stimuli.form import Form
from dlgmd_cli.stimuli.stills import Stills

# Writes a contact sheet to a file whose name ends in .png.
DrawSheet = Callable[[ClipSheet, Path], None]

_PICTURE = re.compile(r"\d{4,}\.png", re.ASCII)


def clip_paths(scene: Scene[Any], form: Form, folder: Path, name: str) -> tuple[Path, ...]:
    """The files of a clip: its frames, their truth, and the record if the scene has one."""
    truth, record = (folder / f"{name}.{suffix}" for suffix in ("csv", "yaml"))
    frames = form.path(folder, name)
    return (frames, truth, record) if scene.has_record else (frames, truth)


def sheet_path(folder: Path, name: str) -> Path:
    """Where the contact sheet of a clip of this name is."""
    return folder / f"{name}-sheet.png"


def write_clip(
    scene: Scene[OptionsT],
    options: OptionsT,
    folder: Path,
    form: Form | None = None,
    *,
    name: str | None = None,
    overwrite: bool = False,
    on_frame: Callable[[int], None] = lambda n_rendered: None,
    draw_sheet: DrawSheet | None = None,
) -> tuple[Path, ...]:
    """Render a scene to ``folder/NAME.mp4``, its ground truth to ``folder/NAME.csv``.

    Of a flight, ``folder/NAME.yaml`` says what it is, and when which phase and the collision come.

    Parameters
    ----------
    scene : Scene
        What to render.
    options : ClipOptions
        Options of that scene.
    folder : Path
        Where to; made if need be.
    form : Form, optional
        What else than the scene's own kind of video: ``NAME.avi`` in FFV1, or ``NAME/0000.png``
        and so on.
    name : str, optional
        The files' stem, if not the scene's name.
    overwrite : bool
        Replace earlier files. A folder that holds more than numbered pictures never is.
    on_frame : callable, optional
        Called after each frame with the number of frames that are rendered.
    draw_sheet : callable, optional
        Draws ``NAME-sheet.png``, a contact sheet, which otherwise there is none of.

    Returns
    -------
    tuple of Path
        The video or folder, the truth, the record if there is one, and the sheet if asked for.

    Raises
    ------
    ParameterError
        If the scene cannot be had with these options, or no video can hold it.
    OutputExistsError
        If a file stands there already and may not be replaced.
    OutputError
        If the files cannot be written.
    """
    form = form or Form.choose(playable=scene.is_playable)
    n_frames = scene.n_frames(options)
    form.check(options)
    name = name or scene.name
    paths = clip_paths(scene, form, folder, name)
    images, rows = scene.frames(options), scene.truth(options)
    stills = None
    if draw_sheet is not None:
        paths = (*paths, sheet_path(folder, name))
        stills = Stills(scene, options, name)
        images, rows = stills.seen(images), stills.known(rows)
    refuse_standing(paths, form, overwrite=overwrite)
    with appearing(*paths) as (frames, truth, *others):
        form.write(frames, _counted(images, on_frame), n_frames, options, target=paths[0])
        write_truth(truth, scene.truth_type, rows)
        if scene.has_record:
            facts = scene.record(options)
            if draw_sheet is not None:
                facts["sheet"] = paths[-1].name
            _write_record(others[0], {**facts, **identity(scene, options, form)})
        if draw_sheet is not None and stills is not None:
            draw_sheet(stills.sheet(), others[-1])
    return paths


def identity(scene: Scene[OptionsT], options: OptionsT, form: Form) -> dict[str, Any]:
    """All that the files of a clip depend on, known before it is rendered."""
    return {
        "scene": scene.name,
        "seed": options.seed,
        "options": options.to_dict(),
        "codec": form.codec,
        "versions": versions(*form.made_by),
    }


def refuse_standing(paths: tuple[Path, ...], form: Form, *, overwrite: bool) -> None:
    """Raise OutputExistsError if a file of a clip stands there and may not be replaced."""
    frames, *others = paths
    if form.is_video:
        others.insert(0, frames)
    else:
        refuse_foreign(frames, lambda name: bool(_PICTURE.fullmatch(name)), overwrite=overwrite)
    for path in others:
        refuse_existing(path, overwrite=overwrite)


def write_truth(path: Path, columns: type, rows: Iterable[Any]) -> None:
    """Write ground truth as CSV; OSError passes through.

    Parameters
    ----------
    path : Path
        The file.
    columns : type
        The dataclass that the rows are of; its fields are the columns.
    rows : iterable
        One a frame. NaN becomes an empty cell.
    """
    names = [field.name for field in fields(columns)]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows([_cell(getattr(row, name)) for name in names] for row in rows)


def _write_record(path: Path, facts: dict[str, Any]) -> None:
    """Write what is so of a clip as a whole, beginning with what it is."""
    ordered = {"scene": facts["scene"], "seed": facts["seed"], **facts}
    path.write_text("# Written by dlgmd.\n" + yaml_text(ordered), encoding="utf-8")


def _cell(value: Any) -> str:
    """A number or text as it stands in a CSV."""
    return text_cell(value) if isinstance(value, str) else cell(value)


def _counted(frames: Iterable[GreyImage], on_frame: Callable[[int], None]) -> Iterator[GreyImage]:
    """The frames, telling how many were taken."""
    for number, frame in enumerate(frames, start=1):
        yield frame
        on_frame(number)
