"""Whole processes over 1,200 frames of 1080p: decoding alone, PySceneDetect, and `dlgmd run`.

Not part of the test run. From the repository, with FFmpeg's command installed:

    python tests/benchmarks/bench_run.py

It makes its clip, runs all commands once to fill caches, and then in turn, five times each. The
table has the medians of CPU time (all threads, user and system) and of wall time, and their ratios
to FFmpeg's. What is not installed is left out. A number after the command is that of the rounds.
"""

import importlib.util
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

N_ROUNDS = 5
# A camera-like image: a texture that moves and grows, with noise.
SCENE = (
    "mandelbrot=size=2400x1400:rate=30:end_scale=0.3,"
    "crop=1920:1080:x='n*1.5':y='n',noise=alls=6:allf=t"
)
ENCODING = ("-pix_fmt", "yuv420p", "-c:v", "libx264", "-preset", "veryfast", "-crf", "23")
READ = """
import sys, cv2
capture = cv2.VideoCapture(sys.argv[1], cv2.CAP_FFMPEG)
while capture.read()[0]:
    pass
"""


def make_clip(folder: Path) -> Path:
    """Write 300 frames, and the clip, which has them four times."""
    part, clip = folder / "part.mp4", folder / "pan.mp4"
    ffmpeg = ("ffmpeg", "-v", "error")
    scene = ("-f", "lavfi", "-i", SCENE, "-frames:v", "300")
    subprocess.run([*ffmpeg, *scene, *ENCODING, part], check=True)
    loops = ("-stream_loop", "3", "-i", part, "-c", "copy")
    subprocess.run([*ffmpeg, *loops, clip], check=True)
    return clip


def commands(clip: Path) -> dict[str, list[str]]:
    """The commands by the names that the table shows."""
    python, scenedetect = sys.executable, "scenedetect"
    dlgmd = [python, "-m", "dlgmd_cli", "run", str(clip), "--overwrite", "--out"]
    found = {
        "ffmpeg -f null": ["ffmpeg", "-v", "error", "-i", str(clip), "-f", "null", "-"],
        "OpenCV read()": [python, "-c", READ, str(clip)],
    }
    # Without extras, Numba is not there to be chosen for large frames.
    engine = [] if importlib.util.find_spec("numba") else ["--engine", "opencv"]
    decoders = {"opencv": "OpenCV"}
    if importlib.util.find_spec("av"):
        decoders["pyav"] = "PyAV"
    for decoder, name in decoders.items():
        if importlib.util.find_spec(scenedetect):
            detect = [python, "-m", scenedetect, "--quiet", "--input", str(clip)]
            detect += ["--backend", decoder, "detect-content"]
            found[f"scenedetect detect-content, {name}"] = detect
        run = [*dlgmd, decoder, "--decoder", decoder, *engine]
        found[f"run, {name}"] = run
        found[f"run, {name}, --format=none"] = [*run, "--format=none"]
        found[f"run, {name}, --scale 1"] = [*run, "--scale", "1"]
        found[f"run, {name}, --scale 1 --set 9"] = [*run, "--scale", "1", "--set", "9"]
    return found


def timed(command: list[str], folder: Path) -> tuple[float, float]:
    """CPU and wall time of a process and its children, in seconds."""
    begin_s = time.perf_counter()
    process = subprocess.Popen(
        command, cwd=folder, stdout=subprocess.DEVNULL, env=environment(folder)
    )
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"failed: {' '.join(command)}")
    return usage.ru_utime + usage.ru_stime, time.perf_counter() - begin_s


def environment(folder: Path) -> dict[str, str]:
    """The environment with this repository first on Python's path, and its bytecode in `folder`.

    An installed package has its bytecode, whatever the variables of this shell say.
    """
    here = str(Path(__file__).parents[2])
    paths = filter(None, (here, os.environ.get("PYTHONPATH")))
    kept = {"PYTHONPATH": os.pathsep.join(paths), "PYTHONPYCACHEPREFIX": str(folder / "bytecode")}
    return {**os.environ, **kept, "PYTHONDONTWRITEBYTECODE": ""}


def main(n_rounds: int, names: str) -> None:
    """Run everything in turn, or what has one of the `names` in its own, and print the table."""
    if not shutil.which("ffmpeg"):
        raise SystemExit("ffmpeg is not installed")
    with tempfile.TemporaryDirectory(prefix="dlgmd-bench-") as name:
        folder = Path(name)
        runs = commands(make_clip(folder))
        if names:
            runs = {label: run for label, run in runs.items() if re.search(names, label)}
        taken: dict[str, list[tuple[float, float]]] = {label: [] for label in runs}
        for n_done in range(-1, n_rounds):
            for label, command in runs.items():
                times = timed(command, folder)
                if n_done >= 0:
                    taken[label].append(times)
    medians = {
        label: [statistics.median(column) for column in zip(*times, strict=True)]
        for label, times in taken.items()
    }
    cpu_base, wall_base = medians["ffmpeg -f null"]
    print(f"{'median of ' + str(n_rounds):42}{'CPU s':>8}{'ratio':>7}{'wall s':>8}{'ratio':>7}")
    for label, (cpu_s, wall_s) in medians.items():
        ratios = cpu_s / cpu_base, wall_s / wall_base
        print(f"{label:42}{cpu_s:8.2f}{ratios[0]:7.2f}{wall_s:8.2f}{ratios[1]:7.2f}")


if __name__ == "__main__":
    main(int([*sys.argv, N_ROUNDS][1]), "".join(sys.argv[2:3]))
