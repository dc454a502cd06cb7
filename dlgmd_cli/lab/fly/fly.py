"""`fly`: one flight with its truth, in memory; `render`: labelled flights, in a folder."""

import csv
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import DlgmdError, counted
from dlgmd_cli.lab.fly import gl
from dlgmd_cli.lab.fly.scripts import FOV_DEG, GROUPS, SPEEDS_M_S, Script, script_of
from dlgmd_cli.machine.pool import results_of
from dlgmd_cli.results import store
from dlgmd_cli.results.labels import LABELS
from dlgmd_cli.results.outcome import Written
from dlgmd_cli.video.writer import best_codec, video_writer

if TYPE_CHECKING:
    from dlgmd_cli.lab.fly.stage import Stage

TRUTH = (
    "frame", "time_s", "distance_m", "closing_m_s", "time_to_contact_s", "roll_deg", "pitch_deg",
    "yaw_deg", "vx_m_s", "vy_m_s", "vz_m_s",
)  # fmt: skip
LABEL_COLUMNS = (
    "video", "collision_frame", "target", "kind", "manner", "speed_m_s", "fov", "camera_tilt",
)  # fmt: skip
SIZE_WH, FPS = (480, 270), 30.0
Cell = str | int | float | None


@dataclass(frozen=True)
class Options:
    """What is flown, and how it is filmed; None is drawn by the seed.

    Attributes
    ----------
    scene : str, optional
        A manner, or a group of the paper.
    seed : int
    size_wh : (int, int)
        Of the images, in px.
    fps : float
    environment, target : str, optional
    speed_m_s : (float, float)
        Least and greatest speed that is drawn.
    fov, camera_tilt : float
        Angles of the camera in degrees; `fov` may be None.
    agile : bool
        Whether the drone tilts at once.
    """

    scene: str | None = None
    seed: int = 0
    size_wh: tuple[int, int] = SIZE_WH
    fps: float = FPS
    environment: str | None = None
    target: str | None = None
    speed_m_s: tuple[float, float] = SPEEDS_M_S
    fov: float | None = None
    camera_tilt: float = 0.0
    agile: bool = False

    def script(self) -> Script:
        """The script that these options name; raises ParameterError."""
        script = script_of(self.scene, self.seed, self.environment, self.target, self.speed_m_s)
        drawn = np.random.default_rng([self.seed, 4]).uniform(*FOV_DEG)
        fov = script.fov_deg if script.name in GROUPS else round(float(drawn), 1)
        return replace(
            script,
            meets_s=round(script.meets_s * self.fps) / self.fps,
            fov_deg=fov if self.fov is None else self.fov,
            camera_tilt_deg=self.camera_tilt,
            agile=self.agile,
        )


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
    collision_frame : int or None
        The first frame at which something is within `HULL_M` of the camera.
    record : dict
        Manner, seed, world, target, speed, camera, and `phases`: name -> first and last frame.
    paths : tuple of pathlib.Path
        The files, once written.
    """

    frames: npt.NDArray[np.uint8]
    fps: float
    truth: npt.NDArray[np.void]
    collision_frame: int | None
    record: dict[str, Any]
    paths: tuple[Path, ...] = field(default=())


def fly(
    scene: str | None = None,
    *,
    seed: int = 0,
    size: str | tuple[int, int] = SIZE_WH,
    fps: float = FPS,
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
    return flown(Options(scene, seed, size, fps))


def flown(options: Options) -> Flight:
    """Render a flight; see `fly`."""
    gl.require()
    from dlgmd_cli.lab.fly.stage import Stage

    script = options.script()
    with Stage(script, options.seed, options.size_wh) as stage:
        times = frame_times(stage.seconds, options.fps)
        frames = np.stack([stage.image(frame, time_s) for frame, time_s in enumerate(times)])
        rows = [truth_row(stage, frame, time_s) for frame, time_s in enumerate(times)]
        contact_s = stage.contact_s
    truth = np.array(rows, [(name, int if name == "frame" else float) for name in TRUTH])
    collision = None if contact_s is None else math.ceil(contact_s * options.fps - 1e-6)
    return Flight(frames, options.fps, truth, collision, record_of(script, options, collision))


def frame_times(seconds: float, fps: float) -> list[float]:
    """The times of the frames of a flight, in s."""
    return [frame / fps for frame in range(math.floor(seconds * fps + 1e-6) + 1)]


def truth_row(stage: "Stage", frame: int, time_s: float) -> tuple[float, ...]:
    """A row of the truth."""
    state, (distance, closing) = stage.path.at(time_s), stage.course(time_s)
    left_s = math.nan if stage.contact_s is None else stage.contact_s - time_s
    return (
        frame, time_s, distance, closing, left_s if left_s >= -1e-6 else math.nan,
        *state.attitude_deg, *state.velocity,
    )  # fmt: skip


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
        "world": script.world, "target": script.target, "collision_frame": collision,
        "fov": script.fov_deg, "camera_tilt": script.camera_tilt_deg, "agile": script.agile,
        "fps": options.fps, "phases": phases,
    }  # fmt: skip


def render(
    options: Options,
    out: str | os.PathLike[str],
    *,
    count: int = 1,
    jobs: int | None = None,
    png: bool = False,
    overwrite: bool = False,
) -> Written:
    """Render flights with consecutive seeds into a folder.

    Writes a video or a folder of images for each, `truth/NAME.csv`, and `labels.csv` last. After
    an error or an interruption, the flights that are there are whole, and the labels list them.

    Parameters
    ----------
    options : Options
        Its seed is the first one.
    out : path
        The folder.
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
    folder = Path(out)
    tasks = [replace(options, seed=options.seed + number) for number in range(count)]
    tasks[0].script()
    done: dict[int, dict[str, Cell]] = {}
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
                rows = [[label[name] for name in LABEL_COLUMNS] for label in labels]
                claim.commit({LABELS: store.file_of(table(LABEL_COLUMNS, rows))})
    n_contacts = sum(label["collision_frame"] is not None for label in labels)
    line = f"{counted(len(labels), 'flight')}, {n_contacts} with a collision"
    written = Written((folder / LABELS,), (line,)) if labels else Written(())
    written.failure = failure
    return written


def _rendered(folder: Path, png: bool, options: Options) -> dict[str, Cell]:
    """Render a flight into the folder; returns its label."""
    flight = flown(options)
    name = f"{flight.record['manner']}-{options.seed:04d}"
    video = save(flight, folder, name, png=png)
    collision = flight.collision_frame
    speed = None if collision is None else float(flight.truth["closing_m_s"][collision])
    facts = {
        **flight.record, "video": video.name, "kind": "rendered",
        "speed_m_s": None if speed is None else round(speed, 2),
    }  # fmt: skip
    return {column: facts[column] for column in LABEL_COLUMNS}


def save(flight: Flight, folder: Path, name: str, *, png: bool) -> Path:
    """Write a flight's truth and its video, or images; returns the path of the latter."""
    with store.writing(folder):
        (folder / "truth").mkdir(parents=True, exist_ok=True)
    text = table(TRUTH, [[_rounded(cell) for cell in row.tolist()] for row in flight.truth])
    truth = store.ClaimedFolder(folder / "truth")
    truth.commit({f"{name}.csv": store.file_of(text)})
    if png:
        with store.ClaimedFolder(folder).staged() as stage:
            (stage / name).mkdir()
            for number, frame in enumerate(flight.frames):
                data = cv2.imencode(".png", frame)[1].tobytes()
                (stage / name / f"{number:05d}.png").write_bytes(data)
        video = folder / name
    else:
        video = folder / f"{name}.mp4"
        shape = flight.frames.shape[1], flight.frames.shape[2]
        with video_writer(video, shape, flight.fps, codec=best_codec()) as write:
            for frame in flight.frames:
                write(frame)
    flight.paths = (video, folder / "truth" / f"{name}.csv")
    return video


def _rounded(cell: float) -> Cell:
    """A cell of the truth: empty for what is undefined."""
    return cell if isinstance(cell, int) else None if math.isnan(cell) else round(cell, 6)


def table(header: Sequence[str], rows: Sequence[Sequence[Cell]]) -> str:
    """A table as CSV; None is an empty cell."""
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()
