"""Labels and truth of ODA (Dupeyroux and others), real approaches of a drone to one or two poles.

    python tests/benchmarks/label_oda.py ODA OUT
    dlgmd evaluate OUT/labels.csv --out scores

Download trial_overview.csv and the folders of some trials from https://doi.org/10.4121/14214236.
ODA has trial_overview.csv and, for each trial N, N/optitrack.csv and N/N.avi. OUT/labels.csv gets a
row for each trial, OUT/truth/N.csv one for each frame of its video.

They come from the drone's poses, which are assumed to begin with the video. The frame of contact is
the one nearest to a pole that lay ahead. The pilots turn away some 2 s before it, before an alarm
is due: read the column `justified` of the scores.
"""

import argparse
import csv
from pathlib import Path

import numpy as np

from dlgmd_cli.results.csv import write_values

FPS = 29.97
# The axes of the drone and of a pole are so far apart at contact, in m: 0.2 for the pole.
REACH_M = 0.45
# An approach is a course to contact within so many s. Course and speed are means over MEAN_S.
SOON_S, MEAN_S = 3.0, 0.2
COLUMNS = "video", "collision_frame", "target", "kind", "manner", "closest_m", "speed_m_s"
TRUTH = "frame", "time_s", "distance_m", "closing_m_s", "time_to_contact_s"


def read_overview(path):
    """Trial -> places of its poles (n, 2) in m, and their number and the light, in words."""
    trials = {}
    for row in csv.DictReader(path.read_text(encoding="utf-8-sig").splitlines()):
        if row["Incl. Video"] == "1" and row["Obstacle x"] and row["Obstacle z"]:
            poles, _ = trials.setdefault(row["Sequence"], ([], row["Lux"]))
            poles.append((float(row["Obstacle x"]), float(row["Obstacle z"])))
    return {n: (np.array(p), f"{len(p)} pole(s), {lux} lux") for n, (p, lux) in trials.items()}


def truth_of(poses, poles):
    """Times of the frames, distance in m and time to contact in s of each pole, and the speed.

    `poses` has the time in ns, x, y and z in a row; x and z are level. The time to contact is that
    of a straight course at constant speed: NaN where it passes the pole, or leads away from it.
    """
    time_s = (poses[:, 0] - poses[0, 0]) / 1e9
    at_s = np.arange(0.0, time_s[-1], 1.0 / FPS)
    ends_s = np.clip([at_s, at_s - MEAN_S / 2, at_s + MEAN_S / 2], 0.0, time_s[-1])
    place, first, last = np.stack([np.interp(ends_s, time_s, poses[:, k]) for k in (1, 3)], axis=-1)
    velocity = (last - first) / (ends_s[2] - ends_s[1])[:, None]
    speed = np.maximum(np.linalg.norm(velocity, axis=1)[:, None], 0.1)  # at rest, noise alone
    away = poles - place[:, None]
    ahead = (away * velocity[:, None]).sum(axis=-1) / speed
    rest = REACH_M**2 - ((away**2).sum(axis=-1) - ahead**2)
    with np.errstate(invalid="ignore"):
        ttc_s = np.where(ahead > 0.0, np.maximum(ahead - np.sqrt(rest), 0.0) / speed, np.nan)
    return at_s, np.linalg.norm(away, axis=-1) - REACH_M, ttc_s, speed[:, 0]


def label(number, folder, out, poles, manner):
    """The label of a trial, and its truth as a file."""
    poses = np.loadtxt(folder / number / "optitrack.csv", delimiter=",", skiprows=1)
    at_s, distance, ttc_s, speed = truth_of(poses, poles)
    nearest = distance.min(axis=1)
    closing = -np.gradient(nearest, at_s)
    rows = zip(at_s, nearest, closing, np.fmin.reduce(ttc_s, axis=1), strict=True)
    write_values(out / "truth" / f"{number}.csv", TRUTH, ((k, *row) for k, row in enumerate(rows)))
    pole = int(np.nanmin(ttc_s, axis=0, initial=np.inf).argmin())
    soon = np.flatnonzero(ttc_s[:, pole] < SOON_S)
    frame = soon[0] + distance[soon[0] :, pole].argmin() if soon.size else None
    closest_m = (distance.min() if frame is None else distance[frame, pole]) + REACH_M
    speed_m_s = np.median(speed[soon] if soon.size else speed)
    video = str((folder / number / f"{number}.avi").resolve())
    return video, frame, "pole", "real", manner, closest_m, speed_m_s


parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("folder", type=Path)
parser.add_argument("out", type=Path)
asked = parser.parse_args()
(asked.out / "truth").mkdir(parents=True, exist_ok=True)
trials = read_overview(asked.folder / "trial_overview.csv")
own = {n: one for n, one in trials.items() if (asked.folder / n / "optitrack.csv").is_file()}
rows = [label(n, asked.folder, asked.out, *one) for n, one in own.items()]
write_values(asked.out / "labels.csv", COLUMNS, rows)
print(f"{len(rows)} trials: {sum(row[1] is not None for row in rows)} approach a pole")
