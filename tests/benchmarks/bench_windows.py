"""The two windows against version 2.0.0, on rendered flights that were used for no choice.

    python tests/benchmarks/bench_windows.py render FOLDER [CELL ...]
    python tests/benchmarks/bench_windows.py measure FOLDER NAME [CELL ...]
    python tests/benchmarks/bench_windows.py report FOLDER NAME NAME [CELL ...]
    python tests/benchmarks/bench_windows.py rows FOLDER NAME NAME [CELL ...]

`render` writes the flights of each cell of `CELLS` below FOLDER. `measure` writes what the checkout
that is imported says about each frame, as FOLDER/CELL-NAME.npz; so 2.0.0 is measured by its own
code. `report` compares the second name with the first, on the same flights, and `rows` prints a row
a cell, at the shipped thresholds alone. A cell that was not measured is left out, and they say so.
"""

import argparse
import math
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from dlgmd_cli.frame import small_wh
from dlgmd_cli.models import expansion
from dlgmd_cli.models.base import create_model
from dlgmd_cli.parameters.presets import LkDivergenceParameters
from dlgmd_cli.results.intervals import poisson_interval
from dlgmd_cli.results.labels import read_cases
from dlgmd_cli.results.scoring import Signal, tally
from dlgmd_cli.scenes.flights.braking import Brakes, Stoppable
from dlgmd_cli.scenes.flights.scenes import recorded_stage
from dlgmd_cli.tasks.evaluate.stopping import Stops
from dlgmd_cli.video.opening import open_video


@dataclass(frozen=True)
class Cell:
    """A block of flights: its seeds, and the options of `dlgmd synth random`."""

    seed: int
    count: int
    options: tuple[str, ...] = ("--speed", "1:3")


# One factor at a time; 60 flights have about 30 drones that a stop can save. No flight of these
# seeds was rendered before this file stood as it is.
CELLS = {
    "unseen": Cell(955000, 120),
    "1 m/s": Cell(956000, 60, ("--speed", "1")),
    "2 m/s": Cell(957000, 60, ("--speed", "2")),
    "3 m/s": Cell(958000, 60, ("--speed", "3")),
    "5 m/s": Cell(959000, 60, ("--speed", "5")),
    "60 deg": Cell(960000, 60, ("--speed", "1:3", "--fov", "60")),
    "100 deg": Cell(961000, 60, ("--speed", "1:3", "--fov", "100")),
    "120 deg": Cell(962000, 60, ("--speed", "1:3", "--fov", "120")),
    "tilt 10": Cell(963000, 60, ("--speed", "1:3", "--camera-tilt", "10")),
    "tilt 20": Cell(964000, 60, ("--speed", "1:3", "--camera-tilt", "20")),
    "tilt 25": Cell(965000, 60, ("--speed", "1:3", "--camera-tilt", "25")),
    "approached": Cell(966000, 20, ("--manner", "approached")),
    "crossed": Cell(967000, 20, ("--manner", "crossed")),
    # Again, with twice as many flights, where 30 drones and 3 minutes left open whether a lens or a
    # tilt is worse than 80 degrees and level.
    "80 deg, again": Cell(980000, 120),
    "60 deg, again": Cell(981000, 120, ("--speed", "1:3", "--fov", "60")),
    "100 deg, again": Cell(982000, 120, ("--speed", "1:3", "--fov", "100")),
    "tilt 10, again": Cell(983000, 120, ("--speed", "1:3", "--camera-tilt", "10")),
    # Once more, since a false stop is so rare that 14 minutes decide nothing.
    "80 deg, third": Cell(984000, 120),
    "60 deg, third": Cell(985000, 120, ("--speed", "1:3", "--fov", "60")),
    "100 deg, third": Cell(986000, 120, ("--speed", "1:3", "--fov", "100")),
    "tilt 10, third": Cell(987000, 120, ("--speed", "1:3", "--camera-tilt", "10")),
}
# Cells whose flights count together: those flown again, and all at 1 to 3 m/s.
TOGETHER = {
    "80 deg, again and third": ("80 deg, again", "80 deg, third"),
    "60 deg, again and third": ("60 deg, again", "60 deg, third"),
    "100 deg, again and third": ("100 deg, again", "100 deg, third"),
    "tilt 10, again and third": ("tilt 10, again", "tilt 10, third"),
    "80 deg, all": ("unseen", "1 m/s", "2 m/s", "3 m/s", "80 deg, again", "80 deg, third"),
    "60 deg, all": ("60 deg", "60 deg, again", "60 deg, third"),
    "100 deg, all": ("100 deg", "100 deg, again", "100 deg, third"),
    "tilt 10, all": ("tilt 10", "tilt 10, again", "tilt 10, third"),
}
# The shipped thresholds, of both windows in 1/s and of the time to contact in seconds.
EXPANSION_ALARM, TTC_ALARM = 0.52, 0.64
# What is to be reached on "unseen": shares saved, the gain over 2.0.0, and false stops a minute.
GOALS = {
    "saved, stabilised": (">=", 0.80),
    "saved, instant tilt": (">=", 0.96),
    "saved, 8 m/s2": (">=", 0.97),
    "gain, stabilised, over 2.0.0": (">=", 0.15),
    "false stops per min": ("<=", 0.8),
    "narrow targets below walls and boards, instant tilt": ("<=", 0.05),
    "lenses of 60, 100 and 120 degrees below 80, instant tilt": ("<=", 0.10),
    "camera tilted by 10 degrees below level, instant tilt": ("<=", 0.05),
    "approached, detected of 20, below 2.0.0": ("<=", 0),
}
# What is to be reached "again", against "80 deg, again": shares saved, of either brake, and false
# stops. All flights of both times together are shown, too.
GOALS_AGAIN = {
    "lenses of 60 and 100 degrees below 80, stabilised and instant tilt": ("<=", 0.10),
    "camera tilted by 10 degrees below level, stabilised and instant tilt": ("<=", 0.05),
    "false stops per min, as a multiple of those at 80 degrees": ("<=", 2.0),
}
# What is to be reached by the false stops of all flights at 1 to 3 m/s with today's windows, those
# at 1, 2 and 3 m/s, "again" and "third" among them: the rate with a lens of 60 or 100 degrees, or a
# camera 10 degrees up, as a multiple of the rate at 80 degrees and level. Before "third" was
# rendered they are 9 in 26 minutes (80 degrees, level), 5 in 11, 2 in 11 and 5 in 11.
GOALS_THIRD = {"false stops per min, as a multiple of those at 80 degrees": ("<=", 2.0)}
NARROW = ("chair", "pillar", "person", "carton", "ball", "notebook")
WIDE = ("wall", "gridded pattern", "board")
BRAKES = {
    "stabilised": Brakes(agile=False),
    "instant tilt": Brakes(agile=True),
    "8 m/s²": Brakes(brake_m_s2=8.0),
}
BOTH = ("stabilised", "instant tilt")
_HORIZON_S, _Z = 1.0, 1.96


def place(folder: Path, cell: str) -> Path:
    """Where the flights of a cell are."""
    return folder / cell.replace(" ", "-").replace("/", "-")


def render(folder: Path, cell: str) -> None:
    """Render the flights of a cell; those that exist are kept."""
    own = CELLS[cell]
    words = ["--count", own.count, "--seed", own.seed, "--size", "240x136", "--jobs", 1]
    options = [*own.options, *map(str, words), "--name", "u", "--out", str(place(folder, cell))]
    subprocess.run([sys.executable, "-m", "dlgmd_cli", "synth", "random", *options], check=True)


def measured_by(record: dict) -> expansion.Expansion:
    """The expansion with the camera of a flight, where this version has cameras."""
    if not hasattr(expansion, "Camera"):
        return expansion.Expansion()
    options = record["options"]
    camera = expansion.Camera(options["fov"], options.get("camera-tilt", 0.0))
    return expansion.Expansion(camera=camera)


def measure(folder: Path, cell: str, name: str) -> None:
    """Write what each frame of the flights of a cell says."""
    columns: dict[str, list[float]] = {key: [] for key in ("flight", "time_s", "ttc_s")}
    columns |= {"expansion": [], "approach": [], "lk": []}
    for number, video in enumerate(sorted(place(folder, cell).glob("*.mp4"))):
        ahead = measured_by(yaml.safe_load(video.with_suffix(".yaml").read_text()))
        flow = create_model(LkDivergenceParameters())
        with open_video(video, width_px=240, model_fps=30, repeats=None) as source:
            size_wh = small_wh(*source.source_wh)
            for frame in source.frames(size_wh):
                if frame.is_repeat:
                    continue
                found = ahead.step(frame.grey, frame.time_s)
                rate = flow.step(frame.luminance, frame.time_s).mp / frame.grey.size
                row = number, frame.time_s, found.ttc_s, found.expansion
                values = (*row, getattr(found, "approach", math.nan), rate)
                for column, value in zip(columns.values(), values, strict=True):
                    column.append(value)
    arrays = {key: np.array(column) for key, column in columns.items()}
    np.savez(place(folder, cell).with_name(f"{place(folder, cell).name}-{name}.npz"), **arrays)


def stops_of(stage, time_s: np.ndarray, brakes: Brakes) -> Stops:
    """What a stop at each frame is worth."""
    flight = Stoppable(stage)
    made = [flight.stop(at_s, brakes) for at_s in time_s.tolist()]
    facts = ([getattr(one, key) for one in made] for key in ("saved", "impact_m_s", "stopped_m"))
    saved, impact, left = map(np.array, facts)
    justified = np.array([flight.is_justified(at_s) for at_s in time_s.tolist()])
    nothing = np.full(len(time_s), math.nan)
    return Stops(time_s, saved, impact, left, justified, flight.can_stop, flight.speed_m_s, nothing)


class Flights:
    """The flights of a cell, as a version of the program measured them."""

    def __init__(self, folder: Path, cell: str, name: str) -> None:
        where = place(folder, cell)
        table = np.load(where.with_name(f"{where.name}-{name}.npz"))
        self.cases = read_cases(where / "labels.csv")
        rows = [table["flight"] == number for number in range(len(self.cases))]
        self.tables = [{key: table[key][own] for key in table.files} for own in rows]
        self._stops: dict[str, list[Stops]] = {}

    def stops(self, brake: str) -> list[Stops]:
        """The stops of each flight by one way of braking."""
        if brake not in self._stops:
            pairs = zip(self.cases, self.tables, strict=True)
            self._stops[brake] = [
                stops_of(recorded_stage(Path(case.path)), own["time_s"], BRAKES[brake])
                for case, own in pairs
            ]
        return self._stops[brake]

    def signals(self, rule: str) -> list[Signal]:
        """What a rule compares with its threshold."""
        found = []
        for case, own in zip(self.cases, self.tables, strict=True):
            strength = {"ttc": -own["ttc_s"], "lk": own["lk"]}.get(rule)
            if strength is None:
                is_near = own["approach"] >= 1.0 / TTC_ALARM
                strength = np.where(is_near, np.inf, own["expansion"])
            contacts_s = tuple(frame / 30.0 for frame in case.collisions)
            found.append(Signal(own["time_s"], strength, contacts_s, 1.0 / 30.0))
        return found


def outcome(flights: Flights, stops: list[Stops], rule: str, at: float):
    """Which drones are saved at a threshold, by target, and false stops a minute."""
    tallies = [
        tally(own.on(signal), 1, at, _HORIZON_S)
        for signal, own in zip(flights.signals(rule), stops, strict=True)
    ]
    targets = [case.targets[0] if case.targets else "" for case in flights.cases]
    flown = zip(targets, stops, tallies, strict=True)
    drones = [(t, own.outcomes(counts.stop_s)[0, 0]) for t, own, counts in flown if own.can_stop]
    saved = np.array([is_saved == 1.0 for _, is_saved in drones])
    n_false = sum(int(counts.n_false[0]) for counts in tallies)
    minutes = sum(counts.minutes for counts in tallies)
    return saved, [target for target, _ in drones], n_false, minutes


def equal(flights: Flights, stops: list[Stops], rule: str, most: float) -> float:
    """The threshold that saves most, with at most so many false stops a minute."""
    every = np.concatenate([signal.strength for signal in flights.signals(rule)])
    best, found = -1.0, math.inf
    for at in np.unique(np.quantile(every[np.isfinite(every)], np.linspace(0.5, 1.0, 40))):
        saved, _, n_false, minutes = outcome(flights, stops, rule, at)
        if n_false <= most * minutes + 1e-9 and saved.sum() > best:
            best, found = saved.sum(), at
    return found


def interval(n: int, of: int) -> str:
    """A share with its Wilson interval (95 %) and counts."""
    if not of:
        return "–"
    share, scale = n / of, 1.0 + _Z**2 / of
    middle = (share + _Z**2 / (2 * of)) / scale
    half = _Z / scale * math.sqrt(share * (1 - share) / of + _Z**2 / (4 * of**2))
    low, high = max(middle - half, 0.0), min(middle + half, 1.0)
    return f"{share:.2f} ({low:.2f}–{high:.2f}), {n} of {of}"


def report(folder: Path, before: str, after: str, cells: Iterable[str]) -> None:
    """Print the tables, in Markdown."""
    for cell in cells:
        try:
            old, new = Flights(folder, cell, before), Flights(folder, cell, after)
        except FileNotFoundError:
            print(f"\n{cell}: not measured")
            continue
        print(f"\n## {cell}: {len(new.cases)} flights, seeds from {CELLS[cell].seed}\n")
        print("| rule | brakes | saved | false stops per min | paired with 2.0.0 |")
        print("|---|---|---|---|---|")
        for brake in BRAKES:
            stops = new.stops(brake)
            base = outcome(old, stops, "ttc", -TTC_ALARM)
            most = max(0.8, base[2] / base[3])
            rows = {
                f"2.0.0, ttc {TTC_ALARM} s": (old, "ttc", -TTC_ALARM),
                f"two windows, {EXPANSION_ALARM}/s": (new, "expansion", EXPANSION_ALARM),
                f"2.0.0, best at {most:.2f}/min": (old, "ttc", None),
                f"two windows, best at {most:.2f}/min": (new, "expansion", None),
                f"LK, best at {most:.2f}/min": (new, "lk", None),
            }
            for words, (flights, rule, at) in rows.items():
                at = equal(flights, stops, rule, most) if at is None else at
                saved, targets, n_false, minutes = outcome(flights, stops, rule, at)
                pair = f"+{(saved & ~base[0]).sum()} −{(~saved & base[0]).sum()}"
                cells_ = words, brake, interval(saved.sum(), len(saved)), f"{n_false / minutes:.2f}"
                print(f"| {' | '.join(cells_)} ({n_false} in {minutes:.1f} min) | {pair} |")
                if at == EXPANSION_ALARM and brake == "instant tilt":
                    by_target = {t: saved[np.array(targets) == t] for t in sorted({*targets})}
        print("\nBy target, two windows, instant tilt: ", end="")
        print(", ".join(f"{t} {own.sum()} of {len(own)}" for t, own in by_target.items()) + ".")
        for words, names in (("Narrow", NARROW), ("Walls and boards", WIDE)):
            own = np.concatenate([by_target.get(name, np.zeros(0, bool)) for name in names])
            print(f"{words}: {interval(int(own.sum()), len(own))}.")


def rows(folder: Path, before: str, after: str, cells: Iterable[str]) -> None:
    """Print a row a cell, at the shipped thresholds, and those of `TOGETHER`."""
    versions = {"2.0": (before, "ttc", -TTC_ALARM), "2.1": (after, "expansion", EXPANSION_ALARM)}
    heads = (f"{what}, {version}" for what in (*BOTH, "false stops/min") for version in versions)
    print(f"| flights | drones | {' | '.join(heads)} |\n|---|---|---|---|---|---|---|---|")
    found: dict[str, list[list[float]]] = {}
    for cell in cells:
        try:
            found[cell] = [counts(folder, cell, *version) for version in versions.values()]
            print(row(cell, found[cell]))
        except FileNotFoundError as error:
            print(f"| {cell}: not measured, there is no {Path(error.filename).name} |")
    for words, own in TOGETHER.items():
        if all(cell in found for cell in own):
            print(row(words, np.sum([found[cell] for cell in own], axis=0)))


def counts(folder: Path, cell: str, name: str, rule: str, at: float) -> list[float]:
    """Stabilised and agile drones that are saved, all drones, false stops, and minutes.

    A stop is simulated only where the rule asks for it.
    """
    flights = Flights(folder, cell, name)
    stages = [recorded_stage(Path(case.path)) for case in flights.cases]
    asked = [
        signal.time_s[signal.strength >= at] if (signal.strength >= at).any() else signal.time_s[:1]
        for signal in flights.signals(rule)
    ]
    saved = []
    for brake in BOTH:
        pairs = zip(stages, asked, strict=True)
        stops = [stops_of(stage, time_s, BRAKES[brake]) for stage, time_s in pairs]
        drones, _, n_false, minutes = outcome(flights, stops, rule, at)
        saved.append(drones.sum())
    return [*saved, len(drones), n_false, minutes]


def row(words: str, versions: Iterable[Iterable[float]]) -> str:
    """The `counts` of both versions as a row of a table."""
    old, new = versions
    drones = int(old[2])
    texts = [interval(int(one[brake]), drones) for brake in range(2) for one in (old, new)]
    for *_, n_false, minutes in (old, new):
        low, high = (end / minutes for end in poisson_interval(int(n_false)))
        rate = f"{n_false / minutes:.2f} ({low:.2f}–{high:.2f})"
        texts.append(f"{rate}, {n_false:.0f} in {minutes:.1f} min")
    return f"| {' | '.join([words, str(drones), *texts])} |"


def main() -> None:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("task", choices=("render", "measure", "report", "rows"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*")
    given = parser.parse_args()
    n_names = {"render": 0, "measure": 1, "report": 2, "rows": 2}[given.task]
    names, cells = given.names[:n_names], given.names[n_names:] or [*CELLS]
    if given.task in ("report", "rows"):
        (report if given.task == "report" else rows)(given.folder, *names, cells)
        return
    for cell in cells:
        if given.task == "render":
            render(given.folder, cell)
        elif place(given.folder, cell).is_dir():
            measure(given.folder, cell, *names)


if __name__ == "__main__":
    main()
