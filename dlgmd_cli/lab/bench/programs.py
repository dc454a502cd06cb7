"""CPU and wall time of whole programs over the same clips: decoding alone, PySceneDetect, `run`."""

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import NamedTuple

from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.results.outcome import Outcome, Shown

# Sizes of the clips, and how often each has its 300 frames of 30 a second: 40 s, and 10 minutes.
CLIPS = (((1920, 1080), 4), ((1280, 720), 4), ((640, 360), 4), ((640, 360), 60))
N_FRAMES = 300
# A camera-like image: a texture that moves and grows, with noise.
SCENE = (
    "mandelbrot=size=2400x1400:rate=30:end_scale=0.3,"
    "crop=1920:1080:x='n*1.5':y='n',scale={0}:{1},noise=alls=6:allf=t"
)
ENCODING = ("-pix_fmt", "yuv420p", "-c:v", "libx264", "-preset", "veryfast", "-crf", "23")
BASE = "OpenCV read()"
_READ = """
import sys, cv2
capture = cv2.VideoCapture(sys.argv[1], cv2.CAP_FFMPEG)
while capture.read()[0]:
    pass
"""
# The least that a measurement by tracked points takes: `read()`, a small grey image, and two calls
# of Lucas and Kanade's method for 7x7 points.
TRACKED = "OpenCV read(), track"
_TRACK = """
import sys, cv2, numpy as np
cv2.setNumThreads(1)
capture = cv2.VideoCapture(sys.argv[1], cv2.CAP_FFMPEG)
places = np.stack(np.meshgrid(np.linspace(94, 145, 7), np.linspace(42, 92, 7)), axis=-1)
places = places.reshape(-1, 2).astype(np.float32)
options = dict(winSize=(13, 13), maxLevel=3)
before = None
while True:
    found, image = capture.read()
    if not found:
        break
    size = 240, 240 * image.shape[0] // image.shape[1]
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    now = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    if before is not None:
        there = cv2.calcOpticalFlowPyrLK(before, now, places, None, **options)[0]
        cv2.calcOpticalFlowPyrLK(now, before, there, None, **options)
    before = now
"""


class Taken(NamedTuple):
    """The time of a process and its children, in seconds: user and system, and by the clock."""

    cpu_s: float
    wall_s: float


@dataclass(eq=False)
class Programs(Outcome):
    """The medians of each program on each clip; `rows` has (clip, program) -> times."""

    TABLES = ("programs.csv",)

    rows: dict[tuple[str, str], Taken]

    def cells(self) -> dict[str, tuple[list[str], list[list[float | str | None]]]]:
        """The rows as `programs.csv` has them; the ratios are to the bare `read()` of OpenCV."""
        header = ["clip", "program", "cpu_s", "wall_s", "cpu_ratio", "wall_ratio"]
        table: list[list[float | str | None]] = []
        for (clip, program), taken in self.rows.items():
            base = self.rows[clip, BASE]
            ratios = taken.cpu_s / base.cpu_s, taken.wall_s / base.wall_s
            table.append([clip, program, *taken, *ratios])
        return {"programs.csv": (header, table)}

    def shown(self) -> Iterator[Shown]:
        """The table, and the path of its file if there is one."""
        _, table = self.cells()["programs.csv"]
        titles = ("clip", "program", "CPU s", "wall s", "CPU/read()", "wall/read()")
        yield titles, [(*map(str, row[:2]), *(f"{cell:.2f}" for cell in row[2:])) for row in table]
        yield from self.paths


def commands(clip: Path, out: Path) -> dict[str, list[str]]:
    """The programs that are installed, by name; `out` is a folder for results."""
    python = sys.executable
    run = [python, "-m", "dlgmd_cli", "run", str(clip), "--format=none", "--overwrite"]
    run += ["--out", str(out)]
    found = {
        "ffmpeg -f null": ["ffmpeg", "-v", "error", "-i", str(clip), "-f", "null", "-"],
        BASE: [python, "-c", _READ, str(clip)],
        TRACKED: [python, "-c", _TRACK, str(clip)],
    }
    if importlib.util.find_spec("scenedetect"):
        detect = [python, "-m", "scenedetect", "--quiet", "--input", str(clip)]
        found["scenedetect"] = [*detect, "--backend", "opencv", "detect-content"]
    found |= {"run": run, "run --set 9": [*run, "--set", "9"]}
    if importlib.util.find_spec("av"):
        found["run --decoder pyav"] = [*run, "--decoder", "pyav"]
    return found


def programs(
    clips: Sequence[Path], repeats: int, on_pass: Callable[[int], object] = lambda n_done: None
) -> Programs:
    """Run all programs on all clips in turn, `repeats` times after a first pass that fills caches.

    Raises DlgmdError if a program fails. `on_pass` is called with the number of passes done.
    """
    taken: dict[tuple[str, str], list[Taken]] = {}
    with tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
        for n_done in range(repeats + 1):
            for clip in clips:
                for name, command in commands(clip, Path(folder)).items():
                    one = timed(command, folder)
                    taken.setdefault((clip.stem, name), []).extend([one] if n_done else [])
            on_pass(n_done + 1)
    return Programs({key: Taken(*map(median, zip(*of, strict=True))) for key, of in taken.items()})


def timed(command: Sequence[str], folder: str) -> Taken:
    """The time of a process and its children; `folder` is for the bytecode of modules.

    An installed package has its bytecode, whatever the variables of this shell say.
    """
    bytecode = {"PYTHONPYCACHEPREFIX": f"{folder}/bytecode", "PYTHONDONTWRITEBYTECODE": ""}
    begin_s = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env={**os.environ, **bytecode})
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise DlgmdError("", f"it fails: {' '.join(command)}")
    return Taken(usage.ru_utime + usage.ru_stime, time.perf_counter() - begin_s)


@contextmanager
def made_clips() -> Iterator[list[Path]]:
    """Temporary clips of the sizes that people fly, one of 10 minutes."""
    if not shutil.which("ffmpeg"):
        raise DlgmdError("", "the command ffmpeg is not installed", "Install FFmpeg.")
    ffmpeg = ("ffmpeg", "-v", "error", "-y")
    with tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
        clips = []
        for size_wh, n_times in CLIPS:
            part = Path(folder, f"part{size_wh[0]}.mp4")
            if not part.exists():
                scene = ("-f", "lavfi", "-i", SCENE.format(*size_wh), "-frames:v", str(N_FRAMES))
                subprocess.run([*ffmpeg, *scene, *ENCODING, part], check=True)
            seconds = N_FRAMES * n_times // 30
            clips.append(Path(folder, f"{size_wh[0]}x{size_wh[1]}, {seconds} s.mp4"))
            loops = ("-stream_loop", str(n_times - 1), "-i", part, "-c", "copy")
            subprocess.run([*ffmpeg, *loops, clips[-1]], check=True)
        yield clips
