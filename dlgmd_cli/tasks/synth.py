"""Stimuli with their ground truth: flat scenes, flights, and many flights with labels.

With an alarm in the loop, the drone of a flight brakes at the alarm, and a film shows the flight
without and with it.
"""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, overload

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import (
    DlgmdError,
    OutputExistsError,
    ParameterError,
    ResultError,
    argument,
    counted,
    overwrite_hint,
)
from dlgmd_cli.frame import BgrImage, GreyImage
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.files import remove_leftovers
from dlgmd_cli.machine.pool import results_of
from dlgmd_cli.models.alarm import Alarm
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.windows import Camera
from dlgmd_cli.parameters.facts import Json, Record, Value, defined, extended
from dlgmd_cli.results import labels, store
from dlgmd_cli.results.csv import Cell, Cells, Table, table_of, write_values
from dlgmd_cli.results.labels import LABELS, Label
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.results.record import differences, read_record
from dlgmd_cli.scenes.flights.braking import Brakes, FlightInLoop
from dlgmd_cli.scenes.flights.scenes import FlightScene, collision_frame, find_scene
from dlgmd_cli.scenes.flights.truth import Target
from dlgmd_cli.scenes.stimuli.clip import DrawSheet, Rendering, check_codec, choose_codec, n_digits
from dlgmd_cli.tasks.call import OnFrame, Progress, no_progress
from dlgmd_cli.video.base import parse_size
from dlgmd_cli.video.writer import best_codec, playable_fps, video_writer

_log = logging.getLogger(__name__)

# The kind of footage in the labels of many flights.
RENDERED = "rendered"
# The table of a flight without and with an alarm in the loop, and the ends of its files' names.
AVOIDANCE = (
    *("flight", "frame", "time_s", "distance_m", "time_to_contact_s"),
    *("mp_abs", "spike", "expansion", "ttc_s", "rule", "threshold", "alarm"),
)
_ENDS = ("-avoid.mp4", "-avoid.png", "-avoid.csv")


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
        return _avoided(stimulus, chosen, avoid, Path(out), name, progress, overwrite=overwrite)
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
    return _many(_FlightSet(clip, count), jobs, overwrite, progress)


@dataclass(eq=False, repr=False)
class RenderedClip(Outcome):
    """A rendered stimulus; `save` writes its images as NAME.npy and its truth as NAME.csv.

    Attributes
    ----------
    name : str
        The scene's name.
    fps : float
        Frames per second.
    truth : structured ndarray, shape (n,)
        The ground truth of each frame; its columns are those of the CSV.
    record : dict
        Of a flight: its phases, and the frame of the collision.
    frames : ndarray, shape (n, H, W), uint8, or None
        The images, for `run(clip.frames, fps=clip.fps)`; None if they were written to files.
    paths : tuple of Path
        The files, the video first.
    """

    name: str
    fps: float
    truth: Table
    record: Record
    frames: npt.NDArray[np.uint8] | None = None
    paths: tuple[Path, ...] = ()

    def __repr__(self) -> str:
        where = f" in {self.paths[0]}" if self.paths else ""
        return f"<RenderedClip {self.name}: {counted(len(self.truth), 'frame')}{where}>"

    def cells(self) -> Cells:
        """The columns and rows of the truth."""
        return {f"{self.name}.csv": (self.truth.dtype.names or (), self.truth.tolist())}

    def tables(self) -> dict[str, store.Write]:
        """The functions that write the truth, and the images that are in memory."""
        tables = super().tables()
        if self.frames is not None:
            tables[f"{self.name}.npy"] = partial(_write_array, array=self.frames)
        return tables

    def shown(self) -> Iterator[Shown]:
        """Where the files are, and how a flight with the alarm in the loop ends."""
        yield from self.paths
        if "avoid" in self.record:
            yield "Without: {without}. With {avoid}: {with}.".format(**self.record)


@dataclass(eq=False, repr=False)
class Flights(Outcome):
    """Many flights in a folder.

    `path` is the file of labels, and `labels` has its rows: a structured array with the columns
    ``video``, ``collision_frame``, ``target``, ``kind`` and ``manner``. `failed` says which flights
    could not be rendered, and why, of the `count` that were asked for.
    """

    TABLES = (labels.LABELS,)

    path: Path
    labels: Table
    failed: dict[str, str]
    count: int

    def __repr__(self) -> str:
        n_hits = np.count_nonzero(~np.isnan(self.labels["collision_frame"].astype(float)))
        n_videos = counted(len(self.labels), "video")
        return f"<Flights in {self.path}: {n_videos}, {n_hits} with a collision>"

    def cells(self) -> Cells:
        """The columns and rows of the labels."""
        rows = [[None if v != v else v for v in row] for row in self.labels.tolist()]
        return {labels.LABELS: (labels.COLUMNS, rows)}

    @property
    def failure(self) -> DlgmdError | None:  # type: ignore[override]
        """Why the exit code is 1: some flights could not be rendered."""
        n_present = len(self.labels)
        if n_present == self.count:
            return None
        kept = f"the other {n_present} are in {self.path.parent}"
        why = f"{self.count - n_present} of {self.count} flights failed; {kept}"
        return DlgmdError("", why, "Fix what is named above, then run the same command again.")

    def facts(self) -> dict[str, Json]:
        """The file of labels, and what failed."""
        return {"labels": str(self.path), "failed": self.failed}

    def shown(self) -> Iterator[Shown]:
        """Where the labels are."""
        if len(self.labels):
            yield self.path


def _write_array(path: Path, array: GreyImage) -> None:
    with path.open("wb") as file:  # given a name, NumPy would append .npy to it
        np.save(file, array)


def _of_scene(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are set, as scenes take them; sizes are (H, W)."""
    given = {name: value for name, value in options.items() if value not in (None, ())}
    if "size" in given:
        size_wh = given["size"]
        given["size"] = (parse_size(size_wh) if isinstance(size_wh, str) else size_wh)[::-1]
    return given


def _watched(frames: Iterable[GreyImage], on_frame: Callable[..., None]) -> Iterator[GreyImage]:
    """The frames; reports the number of each before it."""
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
    if clip.codec == "mpeg4" and not scene.is_flight and getattr(options, "noise", 0.0) > 0.0:
        kept = "Note: MPEG-4 smooths the noise; %s keeps every pixel of it."
        _log.info(kept, argument("lossless"))
    with (
        store.claimed(clip.folder),
        progress(scene.name, scene.n_frames(options), "frame") as on_frame,
    ):
        paths = clip.write(overwrite=overwrite, on_frame=on_frame)
    record = scene.record(options)
    return RenderedClip(scene.name, options.fps, _truth(scene, options), record, paths=paths)


@dataclass(frozen=True)
class _FlightSet:
    """Flights like `like` in its folder; flight i has the seed `like.options.seed` + i.

    Their names are that of `like` with a number.
    """

    like: Rendering
    count: int

    def __post_init__(self) -> None:
        check_codec(self.like.codec, self.like.options)
        self.clip(self.count - 1)

    def clip(self, number: int) -> Rendering:
        """One of the flights."""
        options = replace(self.like.options, seed=self.like.options.seed + number)
        name = f"{self.like.name}-{number:0{n_digits(self.count)}d}"
        return replace(self.like, options=options, name=name)

    def present(self) -> dict[int, Label]:
        """Labels, by number, of the flights that exist, are complete and match the options."""
        known = {}
        for number in range(self.count):
            clip = self.clip(number)
            facts = read_record(clip.paths[2])
            if facts and not _differing(clip, facts):
                words = facts.get("target") or "", RENDERED, facts.get("manner", "")
                known[number] = Label(clip.paths[0].name, facts["collision_frame"], *words)
        return known

    def check(self, missing: Iterable[int], *, overwrite: bool) -> None:
        """Raise OutputExistsError if files in the way of the flights may not be replaced."""
        for clip in map(self.clip, missing):
            facts = {} if overwrite else read_record(clip.paths[2])
            if facts.keys() & {"scene", "seed"}:
                differing = ", ".join(_differing(clip, facts)[:5])
                raise OutputExistsError(
                    str(clip.paths[2]),
                    f"another flight already exists here ({differing})",
                    overwrite_hint("such flights"),
                )
            clip.refuse_existing(overwrite=overwrite)
        self.check_labels(overwrite=overwrite)

    def render(
        self, numbers: Iterable[int], jobs: int | None, *, overwrite: bool
    ) -> Iterator[tuple[int, DlgmdError | None]]:
        """Render flights by number; the files do not depend on the number of processes.

        Yields the number of each flight when it is done, with the error if it failed.
        """
        try:
            yield from results_of(partial(self._render, overwrite=overwrite), numbers, jobs)
        finally:
            remove_leftovers(self.like.folder)  # of workers that were killed

    def _render(self, number: int, *, overwrite: bool) -> None:
        self.clip(number).write(overwrite=overwrite)

    def check_labels(self, *, overwrite: bool) -> None:
        """Raise OutputExistsError if there is a file of labels that lists other videos."""
        path = self.like.folder / LABELS
        store.refuse_existing(path, overwrite=True)
        if overwrite or not path.exists():
            return
        hint = overwrite_hint()
        try:
            listed = labels.read_labels(path)
        except ResultError as error:
            raise OutputExistsError(str(path), error.why, hint) from None
        ours = {self.clip(number).paths[0].name for number in range(self.count)}
        strays = [label.video for label in listed if label.video not in ours]
        if strays:
            raise OutputExistsError(str(path), f"lists other videos, such as {strays[0]}", hint)


def _many(flights: _FlightSet, jobs: int | None, overwrite: bool, progress: Progress) -> Flights:
    """Render the missing flights, and write the labels of all that exist, even after an error."""
    folder, failed = flights.like.folder, {}
    with store.claimed(folder) as claim:
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
            if n_new := len(flights.present()) - len(present):
                kept = f"{len(present) + n_new} of {flights.count} flights"
                _log.info("%s holds %s; run the same command again for the others.", folder, kept)
            raise
        finally:
            existing = [label for _, label in sorted(flights.present().items())]
            if existing:
                flights.check_labels(overwrite=overwrite)
                claim.write({LABELS: partial(labels.write_labels, labels=existing)})
    rows = [[getattr(label, name) for name in labels.COLUMNS] for label in existing]
    return Flights(folder / LABELS, table_of(labels.COLUMNS, rows), failed, flights.count)


def _differing(clip: Rendering, facts: Record) -> list[str]:
    """Differences between a record and the requested flight; empty if it is complete."""
    wanted = clip.identity()
    differing = differences(facts, options=wanted.pop("options"), settings=wanted)
    if differing:
        return [key for key in differing if key != argument("seed")]
    frames, truth, _, *sheet = clip.paths
    if not all(facts.get("sheet") == path.name and path.is_file() for path in sheet):
        return ["without a sheet"]
    is_whole = "collision_frame" in facts and frames.exists() and truth.exists()
    return [] if is_whole else ["damaged"]


def _avoided(
    scene: Any,
    options: Any,
    preset: str,
    folder: Path,
    name: str | None,
    progress: Progress,
    *,
    overwrite: bool,
) -> RenderedClip:
    """Fly a flight without and with an alarm, and film both side by side.

    Returns the table of both flights, what came of the stop, and the files: the film, its image
    at the collision, and the table.
    """
    # Only now: Matplotlib takes time.
    from dlgmd_cli.plots.film import PANEL_WH, AvoidanceFilm, FlightTrace

    if not isinstance(scene, FlightScene):
        why = f"{argument('avoid')} works only with flights, and {scene.name} is not one"
        raise ParameterError("", why)
    fov, tilt = options.fov_deg, options.camera_tilt_deg
    alarms = [Alarm(preset, fov=fov, camera_tilt=tilt) for _ in range(2)]
    paths = tuple(folder / f"{name or scene.name}{end}" for end in _ENDS)
    with (
        progress(scene.name, 2 * scene.n_frames(options), "frame") as on_frame,
        store.claimed(
            folder, paths[2].name, names=[p.name for p in paths], overwrite=overwrite
        ) as claim,
    ):
        without, loop = (FlightInLoop(scene, options, Brakes()) for _ in alarms)
        rows, images = _flown(without, alarms[0], on_frame)
        more_rows, more_images = _flown(loop, alarms[1], on_frame, len(rows), brakes=True)
        facts = _what_came(without, loop)
        film = AvoidanceFilm(
            (
                FlightTrace(f"Without: {facts['without']}", table_of(AVOIDANCE, rows), images),
                FlightTrace(
                    f"With the alarm: {facts['with']}", table_of(AVOIDANCE, more_rows), more_images
                ),
            ),
            alarms[0].rule,
            preset,
            Camera(fov, tilt).windows(PANEL_WH[::-1]) or (),
        )
        rows += more_rows
        contact_s, end = loop.stage.contact_s, film.n_frames - 1
        last = end if contact_s is None else min(end, collision_frame(contact_s, loop.fps))
        fps, codec = playable_fps(options.fps), best_codec()
        with claim.staged(what=paths[0]) as stage:
            video, image, table = (stage / path.name for path in paths)
            with video_writer(
                video, film.shape, fps, codec=codec, is_colour=True, target=paths[0]
            ) as write:
                for index in range(film.n_frames):
                    cancel.check()
                    write(film.picture(index))
            still = film.picture(last)
            image.write_bytes(cv2.imencode(".png", still)[1].tobytes())
            write_values(table, AVOIDANCE, rows)
    record = extended({}, {"avoid": preset, **facts})
    return RenderedClip(scene.name, options.fps, table_of(AVOIDANCE, rows), record, paths=paths)


def _flown(
    flight: FlightInLoop,
    alarm: Alarm,
    on_frame: OnFrame,
    n_before: int = 0,
    *,
    brakes: bool = False,
) -> tuple[list[list[Cell]], list[BgrImage]]:
    """The rows of a flight, and its images; `n_before` frames are done.

    The drone `brakes` at the alarm, or flies on.
    """
    from dlgmd_cli.plots.film import PANEL_WH

    steps: list[tuple[float, Detection]] = []
    images: list[BgrImage] = []
    for number, frame in enumerate(flight):
        cancel.check()
        detection = alarm.step(frame, flight.time_s)
        if detection.alarm and brakes:
            flight.brake()
        steps.append((flight.time_s, detection))
        images.append(
            np.asarray(cv2.resize(frame, PANEL_WH, interpolation=cv2.INTER_LINEAR), np.uint8)
        )
        on_frame(n_before + number + 1)
    rows: list[list[Cell]] = []
    stage, target = flight.stage, Target(flight.stage)
    for time_s, detection in steps:
        distance_m, *_ = target.seen_from(stage.path.state(time_s), time_s)
        left_s = math.nan if stage.contact_s is None else stage.contact_s - time_s
        rows.append(
            [
                "with" if brakes else "without",
                len(rows),
                time_s,
                distance_m,
                left_s if left_s >= 0.0 else math.nan,
                detection.mp_abs,
                detection.spike,
                detection.expansion,
                detection.ttc_s,
                detection.rule,
                alarm.rule.threshold,
                detection.alarm,
            ]
        )
    return rows, images


def _what_came(without: FlightInLoop, loop: FlightInLoop) -> dict[str, Value | None]:
    """What came of the flight and of the stop, in words and numbers."""
    stage, braked = without.stage, loop.braked
    contact_s = stage.contact_s
    flown = "no collision" if contact_s is None else f"hits at {without.speed_m_s:.1f} m/s"
    frame = None if contact_s is None else collision_frame(contact_s, without.fps)
    facts: dict[str, Value | None] = {
        "without": flown,
        "with": flown,
        "collision_frame": frame,
        "saved": None,
    }
    if braked is None:
        return facts | {"with": f"no alarm; {flown}"}
    stop = braked.stop
    end = f"hits at {stop.impact_m_s:.1f} m/s"
    if stop.saved:
        end = f"stops {stop.stopped_m:.2f} m before"
        if contact_s is None:
            end = "a stop for a real obstacle" if braked.justified else "a false stop"
    return facts | {
        "with": end,
        "alarm_s": braked.alarm_s,
        "lead_s": None if contact_s is None else contact_s - braked.alarm_s,
        "saved": stop.saved if contact_s is not None else None,
        "impact_m_s": defined(stop.impact_m_s),
        "stopped_m": defined(stop.stopped_m),
        "justified": braked.justified,
    }
