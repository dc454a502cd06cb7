"""Stimuli with their ground truth: flat scenes, flights, and many flights with labels."""

import logging
import os
from collections.abc import Iterator, Mapping
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any, overload

import numpy as np

from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.threads import n_processors
from dlgmd_cli.results import labels
from dlgmd_cli.results.csv import Table, table_of
from dlgmd_cli.results.store import claimed
from dlgmd_cli.results.synth import Flights, RenderedClip
from dlgmd_cli.scenes.flights.dataset import FlightSet
from dlgmd_cli.scenes.flights.scenes import find_scene
from dlgmd_cli.scenes.stimuli.clip import DrawSheet, Rendering, choose_codec
from dlgmd_cli.tasks.call import Progress, no_progress
from dlgmd_cli.video.base import parse_size

_log = logging.getLogger(__name__)


@overload
def synth(
    scene: str, out: str | os.PathLike[str] | None = None, *, count: None = None, **options: Any
) -> RenderedClip: ...


@overload
def synth(scene: str, out: str | os.PathLike[str], *, count: int, **options: Any) -> Flights: ...


def synth(
    scene: str,
    out: str | os.PathLike[str] | None = None,
    *,
    name: str | None = None,
    count: int | None = None,
    jobs: int | None = None,
    avoid: str | None = None,
    lossless: bool = False,
    png: bool = False,
    sheet: bool = False,
    dpi: int = 200,
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> RenderedClip | Flights:
    """Render a stimulus with its ground truth, as `dlgmd synth` does.

    Parameters
    ----------
    scene : str
        A scene, such as ``"looming-cube"`` or ``"random"``; `dlgmd synth --list` lists them.
    out : str or path, optional
        Folder for the files of `dlgmd synth`, with `lossless`, `png`, `sheet` (of `dpi`) and
        `overwrite`. Without it, the images are kept in memory.
    name : str, optional
        Name of the files, so that two seeds do not collide; the scene's unless given.
    count : int, optional
        Render so many flights with consecutive seeds, and ``out/labels.csv``; those that exist
        are kept. `jobs` is the number of processes, all processors unless given.
    avoid : str, optional
        A preset, such as ``"flight"``, whose alarm stops the drone of a flight: film the flight
        without and with it, side by side.
    progress
        As in `batch`.
    options
        Options of the scene: `size` (``"480x270"``), `fps`, `frames`, `seed`, `speed`, `noise` and
        the others of `dlgmd synth --help`.

    Returns
    -------
    RenderedClip or Flights
        `Flights` with `count`.

    Raises
    ------
    ParameterError
        If there is no such scene or option, or it cannot be rendered like that.
    OutputError, OutputExistsError
        If a file cannot be written, or may not be replaced.

    Examples
    --------
    >>> cube = synth("looming-cube", speed=5)  # doctest: +SKIP
    >>> run(cube.frames, 9, fps=cube.fps)  # doctest: +SKIP
    >>> synth("random", "flights", count=6, jobs=2).labels["video"]  # doctest: +SKIP
    """
    if count is None and jobs is not None:
        why = f"{argument('jobs')} works only with {argument('count')}"
        raise ParameterError("", why, "Add it.")
    stimulus = find_scene(scene)
    chosen = stimulus.configure(_of_scene(options))
    if avoid is not None:
        if out is None or count is not None or sheet or png or lossless:
            why = f"{argument('avoid')} writes a film: it needs a folder, and nothing else of files"
            *names, last = map(argument, ("count", "sheet", "png", "lossless"))
            raise ParameterError("", why, f"Leave out {', '.join(names)} and {last}.")
        from dlgmd_cli.tasks.avoid import avoid as fly  # only now: Matplotlib takes time

        place = avoid, Path(out), name or stimulus.name
        with progress(stimulus.name, 2 * stimulus.n_frames(chosen), "frame") as on_frame:
            return fly(stimulus, chosen, *place, overwrite=overwrite, on_frame=on_frame)
    if out is None:
        if count is not None or sheet or png or lossless:
            why = "count, sheet, png and lossless are for files"
            raise ParameterError("", why, "Give their folder, out.")
        with progress(scene, stimulus.n_frames(chosen), "frame") as on_frame:
            frames = np.stack(list(_watched(stimulus.frames(chosen), on_frame)))
        record = stimulus.record(chosen)
        return RenderedClip(stimulus.name, chosen.fps, _truth(stimulus, chosen), record, frames)
    codec = choose_codec(lossless=lossless, png=png, playable=stimulus.is_flight)
    draw: DrawSheet | None = None
    if sheet:  # only now, as importing Matplotlib takes time
        from dlgmd_cli.plots.sheets import save_contact_sheet

        draw = partial(save_contact_sheet, dpi=dpi)
    clip = Rendering(stimulus, chosen, Path(out), codec, name or stimulus.name, draw)
    if count is None:
        return _one(clip, overwrite, progress)
    if not stimulus.is_flight:
        why = f"{argument('count')} works only with flights, and {stimulus.name} is not one"
        raise ParameterError("", why)
    return _many(FlightSet(clip, count), jobs or n_processors(), overwrite, progress)


def _of_scene(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are set, as scenes take them; sizes are (H, W)."""
    given = {name: value for name, value in options.items() if value not in (None, ())}
    if "size" in given:
        size_wh = given["size"]
        given["size"] = (parse_size(size_wh) if isinstance(size_wh, str) else size_wh)[::-1]
    return given


def _watched(frames: Iterator[Any], on_frame: Any) -> Iterator[Any]:
    for number, frame in enumerate(frames, start=1):
        cancel.check()
        on_frame(number)
        yield frame


def _truth(scene: Any, options: Any) -> Table:
    """The ground truth of each frame as a table."""
    names = [name.name for name in fields(scene.truth_type)]
    return table_of(names, ([getattr(r, name) for name in names] for r in scene.truth(options)))


def _one(clip: Rendering, overwrite: bool, progress: Progress) -> RenderedClip:
    """Render one clip into its files."""
    scene, options = clip.scene, clip.options
    # Flights have noise by default, and a camera's video would be compressed as well: no note.
    if clip.codec == "mpeg4" and not scene.is_flight and vars(options)["noise"] > 0.0:
        kept = "Note: MPEG-4 smooths the noise; %s keeps every pixel of it."
        _log.info(kept, argument("lossless"))
    with claimed(clip.folder), progress(scene.name, scene.n_frames(options), "frame") as on_frame:
        paths = clip.write(overwrite=overwrite, on_frame=on_frame)
    record = scene.record(options)
    return RenderedClip(scene.name, options.fps, _truth(scene, options), record, paths=paths)


def _many(flights: FlightSet, jobs: int, overwrite: bool, progress: Progress) -> Flights:
    """Render the missing flights, and write the labels of all that exist, even after an error."""
    folder, failed = flights.like.folder, {}
    with claimed(folder) as claim:
        present = flights.present()
        missing = [number for number in range(flights.count) if number not in present]
        flights.check(missing, overwrite=overwrite)
        if present:
            _log.info("%d of %d flights were already there.", len(present), flights.count)
        try:
            with progress(flights.like.name, flights.count, "flight") as advance:
                advance(len(present))
                done = flights.render(missing, jobs, overwrite=overwrite)
                for n_done, (number, error) in enumerate(done, start=len(present) + 1):
                    if error is not None:
                        name = flights.clip(number).name
                        failed[name] = str(error).removeprefix(f"{name}: ").rstrip(".")
                        _log.error("%s: %s", name, failed[name])
                    advance(n_done)
        except BaseException:  # an interruption, too
            if len(existing := flights.present()) > len(present):
                flights.write_labels(claim, existing, overwrite=overwrite)
                _log.info(
                    "%s holds %d of %d flights; run the same command again for the others.",
                    *(folder, len(existing), flights.count),
                )
            raise
        existing = flights.present()
        if existing:
            flights.write_labels(claim, existing, overwrite=overwrite)
    rows = [[getattr(existing[number], c) for c in labels.COLUMNS] for number in sorted(existing)]
    return Flights(flights.labels_path, table_of(labels.COLUMNS, rows), failed, flights.count)
