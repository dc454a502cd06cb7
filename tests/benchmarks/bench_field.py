"""Alarms on disturbed flights: for light, screens, propellers, and links that stall.

Not part of the test run. From the repository, for flights of `dlgmd synth random --count 60`:

    python tests/benchmarks/bench_field.py FOLDER [CASE ...]

Each case changes the pictures, or the times at which they arrive, of every flight in the folder's
labels.csv, and counts what `Alarm` makes of them, by the rules of `dlgmd evaluate`: an alarm up to
1 s before the collision is a hit, one that is justified (flying straight on, the drone would have
hit something within 1.5 s) is neither a hit nor false. A drone is saved if a stop at the first
alarm of either kind ends before the collision. The case `osd-masked` hides what `osd` paints.
"""

import csv
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from dlgmd_cli import Alarm, load_config, open_video
from dlgmd_cli.frame import resized
from dlgmd_cli.models.detection import spans
from dlgmd_cli.scenes.flights.braking import Brakes, Stoppable
from dlgmd_cli.scenes.flights.scenes import recorded_stage

FPS, WIDTH_PX, HORIZON_S, REACT_S = 30.0, 240, 1.0, 0.1
# A rolling shutter that takes 20 ms for its rows sees two bands of a light at 100 Hz.
MAINS_HZ, READOUT_S = 100.0, 0.02


def flicker(depth, picture, number, rng):
    """Mains flicker: bands of light and dark, `depth` of the brightness to both sides."""
    rows = (number / FPS + np.linspace(0.0, READOUT_S, len(picture))) * MAINS_HZ
    return picture * (1.0 + depth * np.sin(2.0 * np.pi * rows))[:, None]


def osd(picture, number, rng):
    """The screen of a drone: clock, battery, height, horizon, cross-hair."""
    picture = np.uint8(picture)  # OpenCV writes text into nothing else
    height, width = picture.shape
    scale, rows = width / 960, (int(0.09 * height), int(0.95 * height))
    texts = {
        (0.02, rows[0]): f"{number // 1800:02d}:{number / FPS % 60:05.2f}",
        (0.78, rows[0]): f"{16.8 - number / 900:.2f}V",
        (0.02, rows[1]): f"ALT {2.0 + np.sin(number / 9):.1f}m",
        (0.72, rows[1]): f"{(number * 7) % 97:3d}mAh {number % 13:2d}A",
    }
    for (x, y), text in texts.items():
        place, face = (int(x * width), y), cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(picture, text, place, face, 1.2 * scale, 0, max(1, round(7 * scale)))
        cv2.putText(picture, text, place, face, 1.2 * scale, 255, max(1, round(3 * scale)))
    lean, middle, arm = 0.15 * np.sin(number / 11), (width // 2, height // 2), width // 6
    for side in (-1, 1):
        a = middle[0] + side * arm // 2, int(middle[1] + side * lean * arm / 2)
        b = middle[0] + side * arm, int(middle[1] + side * lean * arm)
        cv2.line(picture, a, b, 255, max(1, round(3 * scale)))
    return picture


def osd_mask(shape):
    """Where `osd` paints, at any time."""
    grey = np.full(shape, 128, np.uint8)
    painted = [osd(grey.copy(), number, None) != grey for number in range(300)]
    return cv2.dilate(np.any(painted, axis=0).astype(np.uint8), np.ones((5, 5))) > 0


def dark(part, levels, picture, number, rng):
    """Night: a part of the light, and noise of some levels in each pixel."""
    return picture / part + rng.standard_normal(picture.shape, np.float32) * levels


def exposure(picture, number, rng):
    """The exposure steps by a fifth twice a second."""
    return picture * (1.2 if number // 15 % 2 else 1.0)


def propellers(picture, number, rng):
    """Two blurred blades that turn in the upper corners."""
    picture = picture.copy()
    width = picture.shape[1]
    for side in (0, width):
        angle = np.deg2rad(number * 77 % 360)
        end = int(side + 0.22 * width * np.cos(angle)), int(0.22 * width * np.sin(angle))
        cv2.line(picture, (side, 0), end, 60.0, max(2, width // 60))
    return picture


def upside_down(picture, number, rng):
    """The camera hangs."""
    return picture[::-1, ::-1]


PICTURES = {
    "clean": lambda picture, number, rng: picture,
    "flicker-5": partial(flicker, 0.05),
    "flicker-12": partial(flicker, 0.12),
    "osd": osd,
    "osd-masked": osd,
    "dark": partial(dark, 6.0, 4.0),
    "darker": partial(dark, 10.0, 8.0),
    "exposure": exposure,
    "propellers": propellers,
    "upside-down": upside_down,
}
STALLS = {f"stall-{ms}": ms / 1000.0 for ms in (150, 200, 300)}


def arrivals(times_s, stall_s):
    """When frames arrive over a link that stalls once a second, and then hands on all of them."""
    into_s = times_s % 1.0
    came = np.where(into_s < stall_s, np.floor(times_s) + stall_s, times_s)
    return np.maximum.accumulate(came + 0.001 * np.arange(len(came)) * (stall_s > 0.0))


def alarms_of(path, case, config):
    """Times of the frames of a flight as captured, and whether the alarm is on."""
    alarm, rng = Alarm(load_config(config)), np.random.default_rng(1)
    change, times_s, on = PICTURES.get(case, PICTURES["clean"]), [], []
    with open_video(path, width_px=10_000) as video:
        frames = [(one.grey, one.time_s) for one in video]
    came = arrivals(np.array([time_s for _, time_s in frames]), STALLS.get(case, 0.0))
    if case == "osd-masked":
        hidden = resized(np.float32(osd_mask(frames[0][0].shape)), _reduced(frames[0][0]))
        alarm.ignore(hidden > 0.0)
    for number, ((grey, time_s), came_s) in enumerate(zip(frames, came.tolist(), strict=True)):
        picture = change(np.float32(grey), number, rng)
        picture = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
        on.append(alarm.step(np.ascontiguousarray(picture), came_s).alarm)
        times_s.append(time_s)
    return np.array(times_s), np.array(on)


def _reduced(grey):
    return WIDTH_PX, max(1, round(grey.shape[0] * WIDTH_PX / grey.shape[1]))


def scored(task):
    """Of a flight: announced and saved (None without a collision), false alarms, and minutes."""
    path, contact, case, config = task
    times_s, on = alarms_of(path, case, config)
    starts = [int(first) for first, _ in spans(on, times_s)]
    flight = Stoppable(recorded_stage(path))
    justified = {first for first in starts if flight.is_justified(times_s[first])}
    if contact is None:
        return None, None, len(starts) - len(justified), times_s[-1] / 60.0
    end_s = times_s[min(contact, len(times_s) - 1)]
    before = {first for first in starts if first <= contact}
    hits = {first for first in before if end_s - times_s[first] <= HORIZON_S}
    needed, saved = sorted(hits | (justified & before)), None
    if flight.can_stop:
        saved = bool(needed) and flight.stop(times_s[needed[0]], Brakes(REACT_S)).saved
    return bool(hits), saved, len(before - hits - justified), end_s / 60.0


def main(folder, *cases, config="flight"):
    folder = Path(folder)
    with (folder / "labels.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    print(f"{'case':12} recall  saved  false/min   ({len(rows)} flights, {config})")
    with ProcessPoolExecutor() as pool:
        for case in cases or [*PICTURES, *STALLS]:
            tasks = [
                (folder / row["video"], int(row["collision_frame"] or -1), case, config)
                for row in rows
            ]
            tasks = [(path, None if at < 0 else at, *more) for path, at, *more in tasks]
            found = list(pool.map(scored, tasks))
            hits, saved = ([one[i] for one in found if one[i] is not None] for i in (0, 1))
            n_false, minutes = sum(one[2] for one in found), sum(one[3] for one in found)
            shares = f"{np.mean(hits):.2f}    {np.mean(saved):.2f} "
            print(f"{case:12} {shares}  {n_false / minutes:.2f} ({n_false})", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
