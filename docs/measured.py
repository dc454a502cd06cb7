"""The tables that docs/measure.py measures: a function each, which returns it in Markdown."""

import csv
import math
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from situations import situations
from tables import table

import dlgmd_cli
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.lab.paper.clips import VERSIONS
from dlgmd_cli.results.intervals import binomial_interval, poisson_interval
from dlgmd_cli.results.labels import read_cases
from dlgmd_cli.results.scoring import tally
from dlgmd_cli.scenes.flights.braking import Brakes
from dlgmd_cli.tasks.evaluate.candidates import signal_of
from dlgmd_cli.tasks.evaluate.stopping import following, stops_in

ROOT = Path(__file__).parents[1]
# The folder of rendered flights.
WORK = ROOT / "build" / "measure"
# Other thresholds and rules that are compared with the preset flight, by name.
CONFIGS = {
    "early": "preset: flight\nexpansion_alarm: 0.4\n",
    "neuron": "preset: flight\nalarm: spikes\n",
}
BRAKES = {
    "own limits": (),
    "stabilised": ("--stabilised",),
    "instant tilt": ("--agile",),
    "8 m/s²": ("--brake", "8"),
}


def dlgmd(*words: object) -> None:
    """Run a command of this checkout."""
    command = [sys.executable, "-m", "dlgmd_cli", *map(str, words), "-q"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=_environment())


def _environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT)}


@cache
def flights(name: str, count: int, seed: int, *options: str) -> Path:
    """The labels of random flights, 240x136 px, which are rendered unless they are there."""
    folder = WORK / name
    words = ("--count", count, "--seed", seed, "--size", "240x136", "--name", "u", *options)
    dlgmd("synth", "random", *words, "--out", folder)
    return folder / "labels.csv"


def unseen() -> Path:
    """The held-out flights at 1 to 3 m/s."""
    return flights("unseen", 60, 130000, "--speed", "1:3")


def at_5() -> Path:
    """The held-out flights at 5 m/s."""
    return flights("at-5", 14, 131000, "--speed", "5")


def reference(name: str) -> Path:
    """A table of labels of real clips."""
    if "DLGMD_REFERENCE" not in os.environ:
        raise SystemExit("Set DLGMD_REFERENCE to the folder of the real clips.")
    return Path(os.environ["DLGMD_REFERENCE"]) / name / "labels.csv"


Rows = list[dict[str, str]]


@cache
def evaluated(labels: Path, *options: str) -> dict[str, Rows]:
    """The tables that `dlgmd evaluate` writes, by name; configurations are those of `CONFIGS`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for key, text in CONFIGS.items():
            (folder / f"{key}.yaml").write_text(text, encoding="utf-8")
        words = [str(folder / f"{word}.yaml") if word in CONFIGS else word for word in options]
        dlgmd("evaluate", labels, *words, "--format=none", "--out", folder)
        files = ("evaluate", "curves", "ttc")
        return {
            file: [*csv.DictReader((folder / f"{file}.csv").open(encoding="utf-8"))]
            for file in files
        }


def group(rows: Rows, at: str = "default", **wanted: str) -> dict[str, dict[str, str]]:
    """The rows of one group of videos, all of them unless named, by model."""
    groups = {"target": "all", "kind": "all", "manner": "all", "speed": "all", **wanted}
    return {
        row["model"]: row
        for row in rows
        if row["at"] == at and all(row[key] == value for key, value in groups.items())
    }


def number(text: str | float, digits: int = 2) -> str:
    """A number of a table; a dash where there is none."""
    return "–" if text == "" or math.isnan(float(text)) else f"{float(text):.{digits}f}"


def count(row: dict[str, str]) -> int:
    """How many drones are saved."""
    return round(float(row["saved"] or 0) * float(row["drones"]))


def false_stops(row: dict[str, str]) -> int:
    """How many stops are false."""
    return round(float(row["unneeded_per_min"] or 0) * float(row["minutes"]))


def share(n: int, of: int) -> str:
    """The 95 % interval of a share; a dash for none of none."""
    if not of:
        return "–"
    low, high = binomial_interval(n, of)
    return f"{low:.2f}–{high:.2f}"


def hourly(n: int, minutes: float) -> list[str]:
    """A rate an hour, and its 95 % interval."""
    return [
        f"{60 * n / minutes:.0f}",
        "–".join(f"{60 * end / minutes:.0f}" for end in poisson_interval(n)),
    ]


def says() -> str:
    """What `Alarm` says in some situations."""
    rows = []
    for name, frames in situations().items():
        alarm = dlgmd_cli.Alarm()
        found = [alarm.step(frame, n / 30) for n, frame in enumerate(frames)]
        at = [f"{n / 30:.1f} s ({one.side})" for n, one in enumerate(found) if one.alarm]
        least = min((one.ttc_s for one in found if one.ttc_s > 0), default=math.nan)
        blind = [f"`{one.blind}` at {n / 30:.1f} s" for n, one in enumerate(found) if one.blind]
        rows.append(
            [name, [*at, "none"][0], number(least, 1), [*blind, "–"][0], f"{len(frames) / 30:.1f}"]
        )
    return table(["what happens", "alarm begins", "least `ttc_s`, s", "blind", "of s"], rows)


# Speed in m/s, field of view in degrees, number of flights and first seed of the cells of `choose`.
# No flight of these seeds was rendered before the table was measured.
CELLS = (
    (1, 80, 40, 971000),
    (2, 80, 40, 972000),
    (3, 80, 40, 973000),
    (5, 80, 24, 974000),
    (2, 60, 24, 975000),
    (2, 120, 24, 976000),
)
TILTS = (10, 20, 25)


def choose() -> str:
    """What a threshold for a speed and a tilt brings: `--speed-m-s S --tilt T`."""
    head = ["speed, m/s", "tilt, °", "lens, °", "`expansion_alarm`, 1/s", "median lead time, s"]
    head += ["drones saved", "95 %", "false stops per hour", "95 %"]
    rows = []
    for speed, fov, n, seed in CELLS:
        options = ("--speed", str(speed), "--fov", str(fov))
        labels = flights(f"choose-{speed}-{fov}", n, seed, *options)
        cases = read_cases(labels)
        flown = [(case, dlgmd_cli.run(case.path, "flight")) for case in cases]
        for tilt in TILTS:
            rows.append([str(speed), str(tilt), str(fov), *_chosen(flown, speed, tilt)])
    return table(head, rows)


def _chosen(flown: list, speed: float, tilt: float) -> list[str]:
    """Threshold, lead time, saved drones and false stops of flights, and the intervals."""
    brakes = Brakes(agile=False, tilt_deg=tilt)
    at = rule_of(following(flown[0][1].params, brakes, speed)).threshold
    leads_s, saved, n_false, minutes = [], [], 0, 0.0
    for case, result in flown:
        signal = signal_of(result, case)
        # Only an alarm asks for a stop: no other frame needs one to be simulated.
        on_s = signal.time_s[signal.strength >= at]
        stops = stops_in(brakes, (case, result.record, on_s if len(on_s) else signal.time_s[:1]))
        counts = tally(stops.on(signal), 1, at)
        leads_s += [lead for lead in counts.lead_s[:, 0].tolist() if not math.isnan(lead)]
        saved += [stops.outcomes(counts.stop_s)[0, 0] == 1.0] if stops.can_stop else []
        n_false, minutes = n_false + int(counts.n_false[0]), minutes + counts.minutes
    shown = [f"{sum(saved)} of {len(saved)}", share(sum(saved), len(saved))]
    lead_s = statistics.median(leads_s) if leads_s else math.nan
    return [f"{at:.2f}", number(lead_s), *shown, *hourly(n_false, minutes)]


ALL_MODELS = ("--config", "flight", "--config", "early", "--config", "neuron")
ALL_MODELS += ("--config", "flight-small", "--set", "3", "--set", "6", "--set", "9")
ALL_MODELS += ("--model", "lgmd", "--model", "emd-lgmd", "--model", "dlgmd-onoff")
# The rows of baselines have their best threshold.
BASELINES = ("ΣP", "LK divergence")


def models() -> str:
    """All models on the held-out flights."""
    rows = evaluated(unseen(), *ALL_MODELS)["evaluate"]
    own = group(rows) | {k: v for k, v in group(rows, "best").items() if k not in group(rows)}
    n = next(iter(own.values()))["collisions"]
    head = ["model", f"detected, of {n}", "median lead time, s", "its 10 % quantile, s"]
    return table(
        [*head, "false stops", "minutes"],
        [
            [
                *(f"`{name}`", row["hits"], number(row["lead_s"]), number(row["lead_p10_s"])),
                *(str(false_stops(row)), number(row["minutes"], 1)),
            ]
            for name, row in own.items()
        ],
    )


def _braked(labels: Path, brake: str) -> Rows:
    """The scores of flight and its variants by a way of braking."""
    own = ("--config", "flight", "--config", "early", "--config", "flight-small")
    return evaluated(labels, *own, "--no-baselines", *BRAKES[brake])["evaluate"]


def brakes() -> str:
    """The drones that are saved, by how they brake."""
    by_brake = {brake: group(_braked(unseen(), brake)) for brake in BRAKES}
    first = by_brake["own limits"]
    n = int(float(first["flight"]["drones"]))
    rows = [[f"`{m}`", *(str(count(by_brake[b][m])) for b in BRAKES)] for m in first]
    return table(["model", *(f"{brake}, of {n}" for brake in BRAKES)], rows)


def speeds() -> str:
    """The drones that flight saves by speed, and false stops."""
    rows = []
    for brake in [*BRAKES][1:]:
        scores = _braked(unseen(), brake) + _braked(at_5(), brake)
        names = sorted(
            {row["speed"] for row in scores} - {"all"}, key=lambda s: float(s.split()[0])
        )
        for name in names:
            row = group(scores, speed=name)["flight"]
            n, of = count(row), int(float(row["drones"] or 0))
            false, minutes = false_stops(row), float(row["minutes"])
            cells = [brake, name, f"{n} of {of}", share(n, of), *hourly(false, minutes)]
            rows.append([*cells, f"{minutes:.1f}"])
    head = ["drone", "speed", "saved", "95 %", "false stops per hour", "95 %", "minutes"]
    return table(head, rows)


def targets() -> str:
    """The drones that flight saves, by target."""
    rows = []
    by_brake = {brake: _braked(unseen(), brake) for brake in BRAKES}
    for target in sorted({row["target"] for row in by_brake["stabilised"]} - {"all"}):
        own = {b: group(rows_, target=target).get("flight") for b, rows_ in by_brake.items()}
        if own["stabilised"] and float(own["stabilised"]["drones"] or 0):
            n = str(int(float(own["stabilised"]["drones"])))
            rows.append([target, n, *(str(count(row)) for row in own.values() if row)])
    return table(["target", "drones", *BRAKES], rows)


def _short(row: dict[str, str]) -> list[str]:
    """Detected, lead time, saved and false stops of flight."""
    of = f"{count(row)} of {float(row['drones']):.0f}"
    detected = f"{row['hits']} of {row['collisions']}"
    return [detected, number(row["lead_s"]), of, str(false_stops(row))]


STABILISED = ("--config", "flight", "--no-baselines", "--stabilised")
SHORT = ["detected", "median lead time, s", "saved, stabilised", "false stops"]


def rates() -> str:
    """Flight at lower frame rates."""
    rows = []
    for fps in ("30", "15", "10"):
        scores = evaluated(unseen(), *STABILISED, "--fps", fps)
        rows.append([fps, *_short(group(scores["evaluate"])["flight"])])
    return table(["frames/s", *SHORT], rows)


# The share of the light in the corners that is left, and FFmpeg's filters.
VIGNETTES = {
    "as rendered": "",
    "45 % (π/5)": "vignette=PI/5",
    "12 % (0.98)": "vignette=0.98",
    "12 %, corrected": "vignette=0.98,vignette=0.98:mode=backward",
}


def vignette() -> str:
    """Flight behind a lens that darkens the corners."""
    rows = []
    for number_, (name, filters) in enumerate(VIGNETTES.items()):
        labels = _filtered(unseen(), f"vignette-{number_}", filters) if filters else unseen()
        scores = evaluated(labels, *STABILISED)
        rows.append([name, *_short(group(scores["evaluate"])["flight"])])
    return table(["corners", *SHORT], rows)


def _filtered(labels: Path, name: str, filters: str) -> Path:
    """The flights after FFmpeg's filters, with their labels and records."""
    folder = WORK / name
    folder.mkdir(parents=True, exist_ok=True)
    for path in labels.parent.iterdir():
        target = folder / path.name
        if path.suffix != ".mp4":
            shutil.copy2(path, target)
        elif not target.exists():
            words = ["-vf", filters, "-c:v", "libx264", "-crf", "12", "-pix_fmt", "yuv420p"]
            command = ["ffmpeg", "-v", "error", "-y", "-i", path, *words, target]
            subprocess.run(command, check=True)
    return folder / labels.name


# The cases of tests/benchmarks/bench_field.py in words.
DISTURBANCES = {
    "clean": "none",
    "flicker-5": "mains flicker of 5 % (100 Hz)",
    "flicker-12": "mains flicker of 12 %",
    "osd": "on-screen display",
    "osd-masked": "on-screen display, all of it masked",
    "osd-info": "on-screen display, mask by `info`",
    "dark": "a sixth of the light, noise of 4 levels",
    "darker": "a tenth of the light, noise of 8 levels",
    "exposure": "exposure that steps by a fifth, twice a second",
    "propellers": "two propellers in the upper corners",
    "fish-eye": "fish-eye, 88° from corner to corner",
    "jello": "a rolling shutter that sways by 0.5 % of the width at 85 Hz",
    "crf-38": "H.264 at a quality (CRF) of 38",
    "upside-down": "upside down",
    "stall-150": "a link that stalls for 150 ms each second",
    "stall-200": "a link that stalls for 200 ms",
    "stall-300": "a link that stalls for 300 ms",
}


def light() -> str:
    """Flight with disturbed images, by tests/benchmarks/bench_field.py."""
    labels = flights("light", 60, 150000, "--speed", "1:3")
    printed = _script("bench_field.py", labels.parent)
    rows = []
    for line in printed.splitlines():
        pattern = r"(\S+) +[\d.]+ \((\d+/\d+)\) +[\d.]+ \((\d+/\d+)\) +([\d.]+) \((\d+)\)"
        if found := re.match(pattern, line):
            case, detected, saved, _, n_false = found.groups()
            cells = [each.replace("/", " of ") for each in (detected, saved)]
            rows.append([DISTURBANCES[case], *cells, n_false])
    return table(["disturbance", "detected", "saved", "false alarms"], rows)


def _script(name: str, *words: object) -> str:
    """What a script of the benchmarks prints."""
    command = [sys.executable, str(ROOT / "tests/benchmarks" / name), *map(str, words)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=_environment())
    return done.stdout


def _printed_table(text: str) -> str:
    """The table in Markdown that a script printed."""
    return "\n".join(line for line in text.splitlines() if line.startswith("|"))


def rules() -> str:
    """Rules that use the neuron beside the expansion, on rendered flights."""
    return _printed_table(_script("bench_rules.py", unseen(), "--stabilised"))


def rules_real() -> str:
    """The same on real clips, most of them at 10 frames/s."""
    return _printed_table(_script("bench_rules.py", reference("footage")))


def _ordinary() -> Path:
    """Labels of the real clips without contact at 20 frames/s and more."""
    source = reference("footage")
    wanted = [
        row
        for row in csv.DictReader(source.open(encoding="utf-8"))
        if not row["collision_frame"] and float(row["fps"]) >= 20
    ]
    WORK.mkdir(parents=True, exist_ok=True)
    path = WORK / "ordinary.csv"
    lines = [f"{source.parent / row['video']},,{row['kind']}" for row in wanted]
    path.write_text("\n".join(["video,collision_frame,kind", *lines, ""]), encoding="utf-8")
    return path


THRESHOLDS = (0.36, 0.40, 0.44, 0.48, 0.52, 0.56, 0.60)


def real() -> str:
    """Alarms of flight on ordinary real clips, by threshold, beside the held-out flights."""
    variants = [f"t{at:g}:expansion_alarm={at:g}" for at in THRESHOLDS]
    words = [word for one in variants for word in ("--variant", one)]
    clips = group(evaluated(_ordinary(), *STABILISED, *words)["evaluate"])
    flown = group(evaluated(unseen(), *STABILISED, *words)["evaluate"])
    head = ["`expansion_alarm`, 1/s", "real: alarms", "minutes", *SHORT]
    rows = []
    for name, at in zip([*clips][1:], THRESHOLDS, strict=True):
        clip, row = clips[name], flown[name]
        cells = [f"{at:.2f}", clip["false_alarms"], number(clip["minutes"], 1)]
        rows.append([*cells, *_short(row)])
    return table(head, rows)


def _errors(labels: Path, *options: str) -> str:
    """The errors of the time to contact."""
    rows = evaluated(labels, "--config", "flight", "--no-baselines", *options)["ttc"]
    head = ["true time, s", "with an estimate", "median error, s", "median ratio", "90 % ratio"]
    return table(
        head,
        [
            [
                f"{float(row['left_from_s']):.1f}–{float(row['left_to_s']):.1f}",
                number(row["estimated"]),
                f"{float(row['error_s']):+.2f}" if row["error_s"] else "–",
                *(
                    f"{math.exp(float(row[key])):.2f}" if row[key] else "–"
                    for key in ("log_error", "log_error_p90")
                ),
            ]
            for row in rows
        ],
    )


def ttc_flights() -> str:
    """Errors of the time to contact in rendered flights."""
    return _errors(unseen())


def ttc_synthetic() -> str:
    """Errors of the time to contact of plain objects."""
    folder = WORK / "synthetic"
    for scene in ("looming-cube", "looming-ball"):
        dlgmd("synth", scene, "--out", folder)
    text = "video,collision_frame\nlooming-cube.mp4,74\nlooming-ball.mp4,74\n"
    (folder / "labels.csv").write_text(text, encoding="utf-8")
    return _errors(folder / "labels.csv")


def ttc_real() -> str:
    """Errors of the time to contact in real crashes at 10 frames/s."""
    return _errors(reference("footage"))


def sets() -> str:
    """The AUC of the neuron's sets on frames 240 px wide."""
    chosen = flights("tuning", 60, 910000, "--speed", "1:3")
    numbers = ("4", "5", "6", "7", "8", "9")
    words = [word for number_ in numbers for word in ("--set", number_)]
    places = {"22 real clips": reference("footage"), "6 dash-camera clips": reference("clips")}
    places["60 rendered flights"] = chosen
    scored = {
        name: group(evaluated(labels, *words, "--no-baselines", "--size", "240x135")["evaluate"])
        for name, labels in places.items()
    }
    rows = [[n, *(number(own[f"set{n}"]["auc"]) for own in scored.values())] for n in numbers]
    return table(["set", *scored], rows)


def following_speed() -> str:
    """A threshold that follows each flight's true speed, beside the fixed one."""
    rows = []
    for brake in [*BRAKES][1:]:
        for name, labels in (("1 to 3", unseen()), ("5", at_5())):
            words = ("--config", "flight", "--no-baselines", "--speed-m-s", "true", *BRAKES[brake])
            fixed, follows = group(evaluated(labels, *words)["evaluate"]).values()
            of = f"{float(fixed['drones']):.0f}"
            both = [str(count(fixed)), str(count(follows)), of]
            false = [str(false_stops(fixed)), str(false_stops(follows))]
            rows.append([brake, name, *both, *false, number(fixed["minutes"], 1)])
    head = ["drone", "speed, m/s", "saved, fixed", "saved, following", "drones"]
    return table([*head, "false stops, fixed", "false stops, following", "minutes"], rows)


def lk() -> str:
    """Flight beside the divergence of tracked corners, stabilised."""
    curves = evaluated(unseen(), "--config", "flight", "--stabilised")["curves"]
    rows = []
    for at in (1.0, 1.3):
        own = [row for row in curves if row["model"] == BASELINES[1] and row["kind"] == "all"]
        row = min(own, key=lambda one: abs(float(one["threshold"]) - at))
        cells = (row["recall"], row["lead_s"], row["saved"], row["unneeded_per_min"])
        rows.append([f"LK divergence, {at}/s", *map(number, cells)])
    row = group(evaluated(unseen(), "--config", "flight", "--stabilised")["evaluate"])["flight"]
    cells = (row["recall"], row["lead_s"], row["saved"], row["unneeded_per_min"])
    rows.append(["`flight`", *map(number, cells)])
    return table(
        ["detector", "recall", "median lead time, s", "saved", "false stops per min"], rows
    )


def static() -> str:
    """What approaches or crosses before a camera that hovers."""
    models_ = ("--config", "flight", "--set", "3", "--set", "6", "--no-baselines")
    words = (*models_, "--variant", "early:ttc_alarm=0.8")
    came = flights("approached", 20, 132000, "--manner", "approached")
    passed = flights("crossed", 20, 133000, "--manner", "crossed")
    hits, false = (group(evaluated(one, *words)["evaluate"]) for one in (came, passed))
    rows = [
        [f"`{name}`", row["hits"], number(row["lead_s"]), false[name]["false_alarms"]]
        for name, row in hits.items()
    ]
    return table(
        ["model", "detected, of 20", "median lead time, s", "crossing: false alarms"], rows
    )


@cache
def _claims() -> dict[tuple[str, str], str]:
    """The verdict on each claim of the paper about its model, by claim and version.

    Figs. 8, 10 and 12 are judged on the authors' frames alone.
    """
    folder = WORK / "paper"
    frames = ("--reference", reference("clips").parents[1])
    dlgmd("reproduce", "--quick", "--seeds", "100:119", *frames, "--out", folder)
    verdicts = {}
    for row in csv.DictReader((folder / "claims.csv").open(encoding="utf-8")):
        if row["whose"] == "paper":
            key = (row["id"], row["formulation"])
            if key not in verdicts or row["shown_on"] == "authors' frames":
                verdicts[key] = row["verdict"]
    return verdicts


VERDICTS = {"yes": "✓", "no": "✗", "undecided": "?", "empty": "○", "tie": "=", "untestable": "–"}


def paper_totals() -> str:
    """How many claims of the paper hold in each version."""
    rows = []
    for version in VERSIONS:
        own = [found for (_, v), found in _claims().items() if v in (version, "any")]
        rows.append([f"`{version}`", *(str(own.count(verdict)) for verdict in VERDICTS)])
    return table(["version", *VERDICTS.values()], rows)


def paper_figures() -> str:
    """How many claims hold, of those that can be tested, by figure."""
    shown = ("default", "released-2021", "released-2020", "equations")
    rows: dict[str, list[str]] = {}
    for version in shown:
        counts: dict[str, list[str]] = {}
        for (claim, v), found in _claims().items():
            if v in (version, "any") and found != "untestable":
                figure = re.match(r"fig\d+|table4|\w+", claim)[0]
                counts.setdefault(figure, []).append(found)
        for figure, own in counts.items():
            rows.setdefault(figure, []).append(f"{own.count('yes')}/{len(own)}")
    return table(["figure", *(f"`{v}`" for v in shown)], [[f, *cells] for f, cells in rows.items()])


# The tables, and about how many minutes of one core they take, without the rendering of flights.
TABLES: dict[str, tuple[Callable[[], str], int]] = {
    "choose": (choose, 12),
    "says": (says, 2),
    "models": (models, 10),
    "brakes": (brakes, 8),
    "speeds": (speeds, 8),
    "targets": (targets, 8),
    "rates": (rates, 5),
    "vignette": (vignette, 8),
    "light": (light, 12),
    "real": (real, 8),
    "rules": (rules, 10),
    "rules-real": (rules_real, 2),
    "ttc-flights": (ttc_flights, 3),
    "ttc-synthetic": (ttc_synthetic, 1),
    "ttc-real": (ttc_real, 1),
    "sets": (sets, 8),
    "following": (following_speed, 12),
    "lk": (lk, 3),
    "static": (static, 3),
    "paper-totals": (paper_totals, 120),
    "paper-figures": (paper_figures, 120),
}
