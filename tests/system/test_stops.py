"""`dlgmd evaluate` on rendered flights: records, thresholds that follow the speed, brakes."""

import math
import shutil
from pathlib import Path

import pytest
from conftest import csv_rows, read_video, write_video, yaml_of
from test_avoid import CONTACT_S, stage_of

from dlgmd_cli.errors import ResultError
from dlgmd_cli.models.rules import RATE_TIMES_TIME
from dlgmd_cli.scenes.flights.braking import Brakes
from dlgmd_cli.scenes.flights.scenes import SCENES, FlightOptions, FlightScene, recorded_stage
from dlgmd_cli.tasks.synth import synth

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("here")]


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """Two flights at a wall, one of which ends early, and their labels."""
    folder = tmp_path_factory.mktemp("rendered") / "f"
    with pytest.MonkeyPatch.context() as patch:
        scene = FlightScene("wall", "", FlightOptions(shape=(54, 96)), stage_of)
        patch.setitem(SCENES, "wall", scene)
        synth("wall", folder, count=2, jobs=1)
        yield folder


@pytest.fixture
def flights(runs, rendered):
    """The same in the working folder, to be changed."""
    return shutil.copytree(rendered, Path("f"))


def braked(runs, flights, *options, plots=False):
    """The outcome of the command by the rule `ttc`, and its row of all flights."""
    quick = ("--no-baselines", "--jobs", 1, "--overwrite", "--alarm", "ttc", "--out", "ev")
    result = runs("evaluate", flights / "labels.csv", *quick, *options, plots=plots)
    rows = [row for row in csv_rows("ev/evaluate.csv") if row["at"] == "default"]
    of_all = {"all"}
    (row,) = [r for r in rows if {r[k] for k in ("target", "kind", "manner", "speed")} == of_all]
    assert row["drones"] == "1" and float(row["speed_m_s"]) == pytest.approx(2.0)
    return result, row


def test_evaluate_closes_the_loop(runs, flights):
    result, row = braked(runs, flights, "--brake", 40, "--react", 0, plots=True)
    assert float(row["saved"]) == 1.0
    assert "1 drone in which a stop avoids the collision, at 2.0 to 2.0 m/s" in result.stdout
    assert "Reaction 0 s, braking at 40 m/s²" in result.stdout
    assert Path("ev/evaluate-stops.png").exists() and yaml_of("ev/evaluate.yaml")["react_s"] == 0
    of_drone = [row for row in csv_rows("ev/alarms.csv") if row["stopped_m"]]
    assert of_drone and {row["saved"] for row in of_drone} == {"1"}
    assert all(float(row["stopped_m"]) > 0.1 for row in of_drone)
    assert "1" in {row["justified"] for row in of_drone}
    braked(runs, flights, "--horizon", 0.1)
    kinds = {(r["kind"], r["justified"]) for r in csv_rows("ev/alarms.csv")}
    assert ("justified", "1") in kinds and not {("false", "1"), ("early", "1")} & kinds
    estimates = [row for row in csv_rows("ev/ttc.csv") if row["ttc_s"]]
    assert {row["model"] for row in estimates} == {"flight alarm=ttc"} and Path(
        "ev/evaluate-ttc.png"
    ).exists()
    near = estimates[0]
    assert (near["left_from_s"], near["left_to_s"], near["frames"]) == ("0.2", "0.3", "3")
    assert 0.1 < float(near["ttc_s"]) < 0.6 and near["estimated"] == "1"
    assert csv_rows("ev/curves.csv")[0].keys() >= {"saved", "unneeded_per_min"}


def test_who_brakes_harder_saves_as_many_drones(runs, flights):
    shares = [float(braked(runs, flights, one)[1]["saved"]) for one in ("--stabilised", "--agile")]
    assert shares[0] <= shares[1]


def test_a_threshold_that_follows_the_speed(runs, flights):
    """A row more for the rule `ttc` alone; the flight's true speed is 2 m/s throughout."""
    common = ("evaluate", flights / "labels.csv", "--config", "flight", "--set", 9, "--format=none")
    common += ("--no-baselines", "--jobs", 1, "--overwrite", "--out", "ev", "--stabilised")
    rows = {}
    for speed in ("2", "true"):
        runs(*common, "--speed-m-s", speed)
        found = [r for r in csv_rows("ev/evaluate.csv") if r["at"] == "default"]
        rows |= {r["model"]: r for r in reversed(found)}
    assert rows.keys() == {"set9", "flight", "flight, 2 m/s", "flight, true speed"}
    given, true, usual = rows["flight, 2 m/s"], rows["flight, true speed"], rows["flight"]
    assert float(usual["threshold"]) == 0.52
    needed_s = Brakes(agile=False).needed_s(2.0)
    assert float(given["threshold"]) == pytest.approx(RATE_TIMES_TIME / (needed_s + 0.2))
    assert float(true["threshold"]) == pytest.approx(RATE_TIMES_TIME / 0.2)
    same = given.keys() - {"model", "threshold", "auc"}
    assert {k: true[k] for k in same} == {k: given[k] for k in same}
    assert float(given["saved"]) >= float(usual["saved"])


def test_a_stop_that_is_overdue_from_the_start_has_a_best_threshold(runs, flights):
    """A weak brake needs more time than is ever left, so that the alarm is on throughout."""
    options = ("--brake", 0.5, "--speed-m-s", "true", "--config", "flight", "--format=none")
    runs("evaluate", flights / "labels.csv", *options, "--no-baselines", "--jobs", 1, "--out", "ev")
    rows = [r for r in csv_rows("ev/evaluate.csv") if r["model"] == "flight, true speed"]
    assert {row["at"] for row in rows} == {"default", "best"}
    assert math.isinf(max(float(row["threshold"]) for row in rows))


def test_a_video_without_its_record_or_of_another_version_is_no_flight(runs, flights):
    record = flights / "wall-0000.yaml"
    assert recorded_stage(flights / "wall-0000.mp4").contact_s == CONTACT_S
    record.write_text(record.read_text().replace("collision_time_s: 2.4", "collision_time_s: 2.3"))
    with pytest.raises(ResultError, match="this version renders differently"):
        recorded_stage(flights / "wall-0000.mp4")
    record.write_text("width: 96\n")  # of something else
    assert recorded_stage(flights / "wall-0000.mp4") is None
    record.unlink()
    result = runs("evaluate", flights / "labels.csv", "--no-baselines", "--out", "ev", plots=True)
    assert "a stop avoids" not in result.stdout and result.stderr == ""
    assert not Path("ev/evaluate-stops.png").exists()
    assert {row["saved"] for row in csv_rows("ev/alarms.csv") if "0000" in row["video"]} <= {""}


def closed(dlgmd, folder, collision_frame, *options):
    """The outcome of the command on the flight with this label, and whether its loop is closed."""
    (folder / "own.csv").write_text(f"video,collision_frame\nwall-0000.mp4,{collision_frame}\n")
    quick = ("--no-baselines", "--format=none", "--set", 9, "--scale", 0.5, "--jobs", 1, "--overwrite")
    result = dlgmd("evaluate", folder / "own.csv", *quick, *options, "--out", "ev")
    return result, result.exit_code == 0 and csv_rows("ev/evaluate.csv")[0]["drones"] == "1"


def test_a_record_that_is_not_of_the_video_closes_no_loop(dlgmd, flights):
    """Whatever its frames, size or rate say; a part of the video is still the video."""
    video, record = flights / "wall-0000.mp4", flights / "wall-0000.yaml"
    assert closed(dlgmd, flights, 74, "--end", 2.49)[1]
    whole, (rate, frames) = record.read_text(), read_video(video)
    write_video(video, frames[30:], rate)
    result, is_closed = closed(dlgmd, flights, 44)
    why = "wall-0000.mp4: no stop is simulated: wall-0000.yaml is the record of another video"
    assert f"{why} (frames 91 instead of 61)" in result.stderr and not is_closed
    write_video(video, [frame[:48] for frame in frames], rate)
    result, is_closed = closed(dlgmd, flights, 74)
    assert f"{why} (height 54 instead of 48)" in result.stderr and not is_closed
    write_video(video, frames, 25)
    result, is_closed = closed(dlgmd, flights, 74)
    assert f"{why} (fps 30.0 instead of 25.0)" in result.stderr and not is_closed
    for text in (whole[:200], "scene", whole.replace("fps: 30.0", "fps: .nan", 1)):
        record.write_text(text)
        with pytest.raises(ResultError, match="is damaged"):
            recorded_stage(video)
    result, is_closed = closed(dlgmd, flights, 74)
    assert "no stop is simulated: wall-0000.yaml is damaged" in result.stderr and not is_closed


def test_a_label_that_contradicts_the_record_is_an_error(dlgmd, flights):
    for frame in (60, ""):
        result, _ = closed(dlgmd, flights, frame)
        why = "its label contradicts wall-0000.yaml, which has a collision at frame 74"
        assert result.exit_code == 1 and why in result.stderr
