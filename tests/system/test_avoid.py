"""`dlgmd synth --avoid`: a flight with the alarm in the loop, which brakes while it is filmed."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from conftest import csv_rows, full

from dlgmd_cli.errors import OutputError, OutputExistsError
from dlgmd_cli.results.store import claimed
from dlgmd_cli.scenes.flights.braking import Brakes, FlightInLoop
from dlgmd_cli.scenes.flights.path import REACH_M, Stage, Stretch
from dlgmd_cli.scenes.flights.path import Path as FlightPath
from dlgmd_cli.scenes.flights.scenes import SCENES, FlightOptions, FlightScene
from dlgmd_cli.scenes.flights.solids import Solid, Texture, World, quad
from dlgmd_cli.scenes.flights.truth import Target
from dlgmd_cli.tasks.synth import synth

pytestmark = pytest.mark.slow

SPEED, WALL_M = 2.0, 5.0
CONTACT_S = (WALL_M - REACH_M) / SPEED


def stage_of(seed, agile=None):
    """Straight on at 2 m/s, to a wall with a pattern; seed 1 sees it farther away, and ends."""
    away = 20.0 if seed == 1 else 0.0
    pattern = Texture(np.random.default_rng(0).random((40, 40)))
    wall = Solid("wall", [quad((WALL_M + away, 3, 3), (0, -6, 0), (0, 0, -6), pattern)])
    start = [0.0, 0.0, 0.0, SPEED, 0, 0, 0, 0, 0, 0, 0, 0]
    end = [3.0 * SPEED, *start[1:]]
    path = FlightPath([Stretch(0.0, 3.0, np.array([start, end]))], (("cruise", 0.0, 3.0),))
    contact_s = None if away else CONTACT_S
    return Stage(World(wall), path, "wall", contact_s, 3.0, bool(agile), wall)


@pytest.fixture
def scene(monkeypatch):
    made = FlightScene("wall", "", FlightOptions(shape=(90, 160)), stage_of)
    monkeypatch.setitem(SCENES, "wall", made)
    return made


def in_loop(scene, alarm_s, **flags):
    options = scene.configure({"size": (36, 64), **flags})
    flight = FlightInLoop(scene, options, Brakes())
    frames = []
    for frame in flight:
        frames.append(frame)
        if flight.time_s >= alarm_s - 1e-9:
            flight.brake()
    return flight, frames, list(scene.frames(options))


@pytest.mark.parametrize("agile", [False, True])
def test_the_drone_brakes_leans_back_and_stops(scene, agile):
    flight, frames, free = in_loop(scene, 1.5, agile=agile)
    braked, stage = flight.braked, flight.stage
    assert braked.alarm_s == 1.5 and braked.stop.saved and braked.justified
    # The same images until the pilot has reacted, at 1.6 s, and others then.
    same = [(a == b).all() for a, b in zip(frames, free, strict=False)]
    assert all(same[:49]) and not any(same[52:80])
    before, after = stage.path.state(1.6 - 1e-6), stage.path.state(1.6 + 1e-6)
    assert after.position_m == pytest.approx(before.position_m, abs=1e-4)
    assert after.velocity_m_s == pytest.approx(before.velocity_m_s, abs=1e-3)
    middle, end = stage.path.state(1.9), stage.path.state(stage.duration_s)
    assert middle.pitch_deg > 5.0 and abs(end.pitch_deg) < 1.0
    assert np.linalg.norm(end.velocity_m_s) < 1e-6
    left_m = Target(stage).seen_from(end, stage.duration_s)[0] - REACH_M
    assert left_m == pytest.approx(braked.stop.stopped_m, abs=2e-3) and left_m > 0.3
    assert stage.contact_s is None and stage.path.phase(stage.duration_s) == "hover"
    assert len(frames) == int(stage.duration_s * 30 + 1e-6) + 1


def test_a_late_alarm_only_softens_the_blow(scene):
    flight, _, _ = in_loop(scene, CONTACT_S - 0.35)
    stop, stage = flight.braked.stop, flight.stage
    assert not stop.saved and 0.5 < stop.impact_m_s < SPEED
    assert CONTACT_S < stage.contact_s < CONTACT_S + 0.3
    state = stage.path.state(stage.contact_s)
    assert state.velocity_m_s[0] == pytest.approx(stop.impact_m_s, abs=0.02)
    assert stage.path.state(stage.duration_s).position_m[0] < state.position_m[0] - 0.05


@pytest.mark.parametrize("alarm_s", [CONTACT_S - 0.05, CONTACT_S + 0.1])
def test_an_alarm_at_contact_changes_nothing(scene, alarm_s):
    flight, frames, free = in_loop(scene, alarm_s)
    assert flight.stage.contact_s == CONTACT_S and len(frames) == len(free)
    assert all((a == b).all() for a, b in zip(frames, free, strict=True))


def test_the_loop_of_a_reader(scene):
    """`brake` may be called at every frame: the pilot answers the first."""
    flight = FlightInLoop(scene, scene.configure({"size": (36, 64)}), Brakes())
    for _ in islice(flight, 60):
        flight.brake()
    assert flight.braked.alarm_s == 0.0


def test_earlier_files_stay_until_all_of_the_new_ones_are_whole(scene, tmp_path, monkeypatch):
    options = {"avoid": "set9", "size": "64x36", "frames": 2}
    for path in synth("wall", tmp_path, **options).paths:
        path.write_text("earlier")

    monkeypatch.setattr("dlgmd_cli.tasks.synth.write_values", full)
    with pytest.raises(OutputError, match="No space left"):
        synth("wall", tmp_path, overwrite=True, **options)
    texts = [path.read_bytes() for path in sorted(tmp_path.iterdir())]
    assert texts == [b"earlier"] * 3


def test_the_films_folder_is_locked_while_it_is_flown(scene, tmp_path):
    with claimed(tmp_path), pytest.raises(OutputExistsError, match="is writing here"):
        synth("wall", tmp_path, avoid="set9", size="64x36", frames=10)


def test_what_the_function_tells(scene, tmp_path):
    clip = synth("wall", tmp_path, avoid="set9", size="64x36", seed=1, frames=6)
    assert clip.record["saved"] is None and clip.record["collision_frame"] is None
    assert {row["flight"] for row in clip.truth} == {"without", "with"}
    assert {(row["rule"], row["threshold"]) for row in clip.truth} == {("spikes", 0.4)}


def test_the_command_tells_what_came_of_the_stop(runs, scene):
    """By a rule that is true as soon as anything moves."""
    Path("hasty.yaml").write_text("preset: flight\nalarm: spikes\nt_mp: 0.001\nn_sp: 1\n")
    told = runs("synth", "wall", "--avoid", "hasty.yaml", "--size", "64x36", "--frames", 8)
    words = " ".join(told.stdout.split())
    assert "Without: hits at 2.0 m/s. With hasty.yaml: stops " in words, words
    rows = csv_rows(Path("wall-avoid.csv"))
    alarms = [row["alarm"] for row in rows if row["flight"] == "with"]
    assert alarms[0] == "0" and "1" in alarms


def test_the_film_and_its_table(dlgmd, runs, scene):
    options = ("--size", "96x54", "--frames", 54, "--out", "a", "--name", "one")
    result = runs("synth", "wall", "--avoid", "flight", *options)
    assert result.stdout.startswith("a/one-avoid.mp4\na/one-avoid.png\na/one-avoid.csv\nWithout: ")
    assert "hits at 2.0 m/s. With flight:" in result.stdout.replace("\n", " ")
    rows = csv_rows(Path("a/one-avoid.csv"))
    by_flight = {word: [r for r in rows if r["flight"] == word] for word in ("without", "with")}
    alarms = [float(row["time_s"]) for row in by_flight["with"] if row["alarm"] == "1"]
    assert alarms and alarms[0] < CONTACT_S
    assert {(row["rule"], row["threshold"]) for row in rows} == {("expansion", "0.52")}
    is_above = [float(row["expansion"] or "nan") >= 0.52 for row in rows]
    assert is_above == [row["alarm"] == "1" for row in rows]
    assert float(by_flight["with"][50]["expansion"]) != 0.0
    assert float(by_flight["without"][30]["time_to_contact_s"]) == pytest.approx(CONTACT_S - 1.0)
    assert float(by_flight["without"][30]["distance_m"]) == pytest.approx(3.0)
    again = dlgmd("synth", "wall", "--avoid", "flight", "--out", "a", "--name", "one")
    assert again.exit_code == 2 and "already exists" in again.stderr
