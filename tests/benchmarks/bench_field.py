"""Alarms on disturbed flights: light, screens, propellers, lenses, and links that stall.

Not part of the test run. From the repository:

    dlgmd synth random --speed 1:3 --count 60 --seed 150000 --name u --out FLIGHTS
    python tests/benchmarks/bench_field.py FLIGHTS [CASE ...] [--config FILE] [-v]

Each case changes the images, or the times at which they arrive, of every flight in the folder's
labels.csv. What `Alarm` makes of them is judged by the functions of `dlgmd evaluate`, with its
usual horizon, and each drone braking as it can. Flights in which the drone flies itself are counted
by themselves; beside them stands what comes at a drone that hovers, or passes it. `osd-masked`
hides what `osd` paints, and `osd-info` what `dlgmd info --write-mask` proposes. `-v` names the
flights that are missed, and those with false alarms.
"""

import argparse
import subprocess
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from dlgmd_cli import Alarm, load_config, open_video
from dlgmd_cli.frame import resized
from dlgmd_cli.results.labels import read_cases
from dlgmd_cli.results.record import read_record
from dlgmd_cli.results.scoring import Signal, score, tally
from dlgmd_cli.scenes.flights.braking import Brakes
from dlgmd_cli.scenes.flights.random_flights import VISITS
from dlgmd_cli.tasks.evaluate.stopping import score_stops, stops_in
from dlgmd_cli.video.survey import static_pixels

FPS, WIDTH_PX, FOV_DEG = 30.0, 240, 80.0
# A rolling shutter that takes 20 ms for its rows sees two bands of a light at 100 Hz.
MAINS_HZ, READOUT_S, VIBRATION_HZ = 100.0, 0.02, 85.0
# An alarm is on or off here; what is judged is when it begins.
ON, N_SP = 0.5, 1


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


def fish_eye(picture, number, rng):
    """An equidistant lens of the same field of view at the corners."""
    height, width = picture.shape
    y, x = np.mgrid[:height, :width].astype(np.float32)
    y, x = y - (height - 1) / 2, x - (width - 1) / 2
    focal = width / 2 / np.tan(np.deg2rad(FOV_DEG / 2))
    corner = np.hypot(height, width) / 2
    angle = np.hypot(y, x) / corner * np.arctan(corner / focal)
    scale = focal * np.tan(angle) / np.maximum(np.hypot(y, x), 1e-6)
    places = (x * scale + (width - 1) / 2, y * scale + (height - 1) / 2)
    maps = [np.float32(side) for side in places]
    return cv2.remap(picture, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def jello(picture, number, rng):
    """A rolling shutter on a frame that vibrates: rows sway by half a percent of the width."""
    height, width = picture.shape
    y, x = np.mgrid[:height, :width].astype(np.float32)
    rows_s = number / FPS + READOUT_S * y / height
    sway = np.float32(0.005 * width * np.sin(2.0 * np.pi * VIBRATION_HZ * rows_s))
    return cv2.remap(picture, x + sway, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def unchanged(picture, number, rng):
    return picture


PICTURES = {
    "clean": unchanged,
    "flicker-5": partial(flicker, 0.05),
    "flicker-12": partial(flicker, 0.12),
    "osd": osd,
    "osd-masked": osd,
    "osd-info": osd,
    "dark": partial(dark, 6.0, 4.0),
    "darker": partial(dark, 10.0, 8.0),
    "exposure": exposure,
    "propellers": propellers,
    "fish-eye": fish_eye,
    "jello": jello,
    "crf-38": unchanged,
    "upside-down": upside_down,
}
STALLS = {f"stall-{ms}": ms / 1000.0 for ms in (150, 200, 300)}


def arrivals(times_s, stall_s):
    """When frames arrive over a link that stalls once a second, and then hands on all of them."""
    into_s = times_s % 1.0
    came = np.where(into_s < stall_s, np.floor(times_s) + stall_s, times_s)
    return np.maximum.accumulate(came + 0.001 * np.arange(len(came)) * (stall_s > 0.0))


def compressed(pictures, crf):
    """Images, (n, H, W), as H.264 leaves them."""
    size = "{2}x{1}".format(*pictures.shape)
    raw = ["-f", "rawvideo", "-pix_fmt", "gray"]
    coded = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", str(crf), "-f", "matroska"]
    for command in (
        [*raw, "-s", size, "-r", str(FPS), "-i", "-", *coded, "-"],
        ["-i", "-", *raw, "-"],
    ):
        command = ["ffmpeg", "-v", "error", "-threads", "1", *command]
        given = pictures.tobytes() if isinstance(pictures, np.ndarray) else pictures
        pictures = subprocess.run(command, input=given, stdout=subprocess.PIPE, check=True).stdout
    width, height = map(int, size.split("x"))
    return np.frombuffer(pictures, np.uint8).reshape(-1, height, width)


def disturbed(frames, case):
    """The images of a flight, (H, W) uint8 each, as the case changes them."""
    change, rng = PICTURES.get(case, unchanged), np.random.default_rng(1)
    if case == "crf-38":
        return compressed(np.stack(frames), 38)
    changed = (change(np.float32(grey), number, rng) for number, grey in enumerate(frames))
    return [np.clip(np.rint(one), 0, 255).astype(np.uint8) for one in changed]


def is_on(path, case, config):
    """Times of the frames of a flight as captured and as they come; whether the alarm is on."""
    alarm = Alarm(load_config(config))
    with open_video(path, width_px=10_000) as video:
        frames = [(one.grey.copy(), one.time_s) for one in video]
    greys, times_s = zip(*frames, strict=True)
    came = arrivals(np.array(times_s), STALLS.get(case, 0.0))
    pictures, hidden = disturbed(greys, case), None
    if case == "osd-masked":
        hidden = osd_mask(greys[0].shape)
    elif case == "osd-info":
        hidden = static_pixels(np.min(pictures, axis=0), np.max(pictures, axis=0))
    if hidden is not None:
        alarm.ignore(resized(np.float32(hidden), _reduced(greys[0])) > 0.0)
    on = [
        alarm.step(np.ascontiguousarray(picture), came_s).alarm
        for picture, came_s in zip(pictures, came.tolist(), strict=True)
    ]
    return np.array(times_s), came, np.array(on)


def _reduced(grey):
    return WIDTH_PX, max(1, round(grey.shape[0] * WIDTH_PX / grey.shape[1]))


def worth(video):
    """What a stop at each frame of a flight is worth."""
    with open_video(video.path, width_px=WIDTH_PX) as frames:
        times_s = np.array([one.time_s for one in frames])
    record = {"input": read_record(Path(video.path).with_suffix(".yaml"))}
    return stops_in(Brakes(), (video, record, times_s))


def judged(task):
    """What the alarms of a flight announce, and what the stops are worth that they ask for."""
    video, stops, case, config = task
    times_s, came_s, on = is_on(video.path, case, config)
    contacts_s = tuple(np.interp(video.collisions, np.arange(len(times_s)), times_s))
    signal = stops.on(Signal(came_s, on.astype(float), contacts_s, 1.0 / FPS))
    return stops, tally(signal, N_SP, ON)


def share(n, of):
    return f"{n / of:.2f} ({n}/{of})" if of else "-"


def row(found):
    """Recall, saved drones and false alarms a minute of some flights, in words."""
    if not found:
        return "-"
    scores, stops = score([counts for _, counts in found]), score_stops(found)
    n_saved = round(stops["saved"] * stops["drones"]) if stops["drones"] else 0
    announced = share(scores["hits"], scores["collisions"])
    saved, rate = share(n_saved, stops["drones"]), scores["false_alarms_per_min"]
    return f"{announced:13} {saved:13} {rate:5.2f} ({scores['false_alarms']})"


def named(video, stops):
    return f"{Path(video.name).stem} ({video.manner} {stops.speed_m_s:.1f} m/s)"


def main(folder, cases, config, verbose):
    videos = read_cases(Path(folder) / "labels.csv")
    with ProcessPoolExecutor() as pool:
        stops = list(pool.map(worth, videos))
        is_visit = [video.manner in VISITS for video in videos]
        print(f"{len(videos)} flights, {config}; in {sum(is_visit)} something comes or passes\n")
        print(f"{'':12} {'recall':13} {'saved':13} false/min   | comes or passes: the same")
        for case in cases or [*PICTURES, *STALLS]:
            tasks = [(*both, case, config) for both in zip(videos, stops, strict=True)]
            found = list(pool.map(judged, tasks))
            own, visits = (
                row([one for one, comes in zip(found, is_visit, strict=True) if comes == which])
                for which in (False, True)
            )
            print(f"{case:12} {own:40}| {visits}", flush=True)
            if verbose:
                flown = list(zip(videos, stops, found, strict=True))
                missed = [named(*one[:2]) for one in flown if np.isnan(one[2][1].lead_s).any()]
                false = [named(*one[:2]) for one in flown if one[2][1].n_false.any()]
                print(f"  missed: {', '.join(missed)}\n  false: {', '.join(false)}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("folder")
    parser.add_argument("cases", nargs="*")
    parser.add_argument("--config", default="flight")
    parser.add_argument("-v", action="store_true", dest="verbose")
    main(**vars(parser.parse_args()))
