"""`fly`: one flight with its truth, in memory; `render`: labelled flights, in a folder."""

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import DlgmdError, counted
from dlgmd_cli.lab.fly import gl
from dlgmd_cli.lab.fly.scripts import TILT_S, Options, Script, script_of
from dlgmd_cli.machine.pool import results_of
from dlgmd_cli.results import store
from dlgmd_cli.results.labels import HEADINGS, LABELS, Label, write_labels
from dlgmd_cli.results.labels import TRUTH as TRUTHS
from dlgmd_cli.results.outcome import Written
from dlgmd_cli.video.writer import best_codec, write_video

TRUTH = (
    "frame", "time_s", "distance_m", "closing_m_s", "time_to_contact_s", "roll_deg", "pitch_deg",
    "yaw_deg", "vx_m_s", "vy_m_s", "vz_m_s",
)  # fmt: skip
HEADING = ("frame", "right_deg", "up_deg", "speed_m_s", "roll_deg", "pitch_deg", "yaw_deg")
Cell = str | int | float | None


@dataclass(eq=False)
class Flight:
    """A rendered flight.

    Attributes
    ----------
    frames : ndarray, shape (n, H, W), uint8
    fps : float
    truth : structured ndarray, shape (n,)
        The columns of `TRUTH`. `distance_m` is the way that the drone and its target could still
        fly on their course until something is inside a tube as wide as the hull, measured from the
        camera; NaN if nothing is. `closing_m_s` is the speed on that course.
        `time_to_contact_s` counts to the contact of this flight; NaN without one, and after it.
    headings : structured ndarray, shape (n,)
        The columns of `HEADING`, as ``--heading`` reads them.
    collision_frame : int or None
        The first frame at which something is within `HULL_M` of the camera.
    record : dict
        Manner, seed, world, target, camera, and `phases`: name -> first and last frame.
    """

    frames: npt.NDArray[np.uint8]
    fps: float
    truth: npt.NDArray[np.void]
    headings: npt.NDArray[np.void]
    collision_frame: int | None
    record: dict[str, Any]


def fly(
    scene: str | None = None,
    *,
    seed: int = 0,
    size: str | tuple[int, int] = (480, 270),
    fps: float = 30.0,
    tilt_s: float = TILT_S,
) -> Flight:
    """Render a flight; the same arguments give the same frames. `flown` takes all `Options`.

    Parameters
    ----------
    scene : str, optional
        A manner, such as "hit" or "pass", or one of the paper's "group1" to "group5".
    seed : int
        Of everything that is drawn.
    size : str or (int, int)
        Width and height in px, "480x270" or (480, 270).
    fps : float
        Frames per second.
    tilt_s : float
        The time constant with which the drone tilts, in s.

    Raises
    ------
    ParameterError
        If a name is unknown.
    DlgmdError
        If MuJoCo is missing, or cannot draw.
    """
    if isinstance(size, str):
        width, _, height = size.partition("x")
        size = int(width), int(height)
    return flown(Options(scene, seed, size, fps, tilt_s=tilt_s))


def flown(options: Options) -> Flight:
    """Render a flight; see `fly`."""
    gl.require()
    from dlgmd_cli.lab.fly.stage import Stage

    script = script_of(options)
    with Stage(script, options.seed, options.size_wh) as stage:
        times = frame_times(stage.seconds, options.fps)
        frames = np.stack([stage.image(frame, time_s) for frame, time_s in enumerate(times)])
        rows = [(frame, time_s, *stage.truth(time_s)) for frame, time_s in enumerate(times)]
        tilt_deg = script.camera_tilt_deg
        states = [stage.path.at(time_s) for time_s in times]
        headings = [(frame, *one.heading(tilt_deg)) for frame, one in enumerate(states)]
        contact_s = stage.contact_s
    truth = _structured(rows, TRUTH)
    collision = None if contact_s is None else math.ceil(contact_s * options.fps - 1e-6)
    record = record_of(script, options, collision)
    return Flight(frames, options.fps, truth, _structured(headings, HEADING), collision, record)


def _structured(rows: list[tuple[float, ...]], names: Sequence[str]) -> npt.NDArray[np.void]:
    """Rows with these columns, the frame first."""
    return np.array(rows, [(name, int if name == "frame" else float) for name in names])


def frame_times(seconds: float, fps: float) -> list[float]:
    """The times of the frames of a flight, in s."""
    return [frame / fps for frame in range(math.floor(seconds * fps + 1e-6) + 1)]


def record_of(script: Script, options: Options, collision: int | None) -> dict[str, Any]:
    """What a flight is, in words and numbers."""
    phases: dict[str, list[int]] = {}
    begin_s = 0.0
    for leg in script.legs:
        first, last = (round(s * options.fps) for s in (begin_s, begin_s + leg.seconds))
        last = last if collision is None else min(last, collision)
        if first < last:
            phases.setdefault(leg.name, [first, last])
        begin_s += leg.seconds
    return {
        "manner": script.name, "seed": options.seed, "environment": script.environment,
        "world": script.world, "target": script.target, "fov": script.fov_deg,
        "camera_tilt": script.camera_tilt_deg, "agile": script.agile, "phases": phases,
    }  # fmt: skip


def render(
    options: Options,
    folder: Path,
    *,
    count: int = 1,
    jobs: int | None = None,
    png: bool = False,
    overwrite: bool = False,
) -> Written:
    """Render flights with consecutive seeds into a folder.

    Writes a video or a folder of images for each, `truth/NAME.csv`, `headings/NAME.csv`, and
    `labels.csv` last. After an error or an interruption, the flights that are there are whole, and
    the labels list them.

    Parameters
    ----------
    options : Options
        Its seed is the first one.
    folder : Path
    count, jobs : int
        Number of flights, and of processes.
    png : bool
        Write PNG images, which keep every grey level, in place of videos.
    overwrite : bool
        Whether earlier labels and flights may be replaced.

    Raises
    ------
    ParameterError, DlgmdError
        As `fly`.
    OutputExistsError, OutputError
        If the folder holds labels already, or cannot be written.
    """
    gl.require()
    tasks = [replace(options, seed=options.seed + number) for number in range(count)]
    script_of(tasks[0])
    done: dict[int, Label] = {}
    failure = None
    with store.claimed(folder, LABELS, names=[LABELS], overwrite=overwrite) as claim:
        try:
            for task, label in results_of(partial(_rendered, folder, png), tasks, jobs):
                if isinstance(label, DlgmdError):
                    failure = label
                else:
                    done[task.seed] = label
        finally:
            labels = [done[seed] for seed in sorted(done)]
            if labels:
                claim.commit({LABELS: partial(write_labels, labels=labels)})
    n_contacts = sum(label.collision_frame is not None for label in labels)
    line = f"{counted(len(labels), 'flight')}, {n_contacts} with a collision"
    written = Written((folder / LABELS,), (line,)) if labels else Written(())
    written.failure = failure
    return written


def _rendered(folder: Path, png: bool, options: Options) -> Label:
    """Render a flight into the folder; returns its label."""
    flight = flown(options)
    record, contact = flight.record, flight.collision_frame
    video = save(flight, folder, f"{record['manner']}-{options.seed:04d}", png=png)
    speed = None if contact is None else round(float(flight.truth["closing_m_s"][contact]), 2)
    return Label(
        video.name, contact, record["target"], "rendered", record["manner"], fov=record["fov"],
        camera_tilt=record["camera_tilt"], speed_m_s=speed,
    )  # fmt: skip


def save(flight: Flight, folder: Path, name: str, *, png: bool) -> Path:
    """Write a flight's truth, motion and video, or images; returns the path of the latter."""
    for known, columns, rows in (
        (TRUTHS, TRUTH, flight.truth),
        (HEADINGS, HEADING, flight.headings),
    ):
        beside = store.ClaimedFolder(folder / known)
        beside.commit({f"{name}.csv": store.file_of(table(columns, rows.tolist()))})
    if not png:
        video = folder / f"{name}.mp4"
        shape = flight.frames.shape[1], flight.frames.shape[2]
        write_video(video, flight.frames, shape, flight.fps, codec=best_codec())
        return video
    with store.ClaimedFolder(folder).staged() as stage:
        (stage / name).mkdir()
        for number, frame in enumerate(flight.frames):
            data = cv2.imencode(".png", frame)[1].tobytes()
            (stage / name / f"{number:05d}.png").write_bytes(data)
    return folder / name


def table(header: Sequence[str], rows: Iterable[Iterable[Cell]]) -> str:
    """A table as CSV; a cell is empty for what is undefined."""
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(map(_rounded, row) for row in rows)
    return text.getvalue()


def _rounded(cell: Cell) -> Cell:
    """A cell with at most six decimals; None for NaN."""
    if not isinstance(cell, float):
        return cell
    return None if math.isnan(cell) else round(cell, 6)
