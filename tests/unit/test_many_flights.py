"""`dlgmd synth SCENE --count`: many flights, their labels, and what an early end leaves of them."""

import os
import pickle
from pathlib import Path

import pytest
from conftest import files_of, yaml_of
from flightscenes import SHORT, Quick

from dlgmd_cli.scenes.flights.scenes import SCENES

OUT = Path("flights")
HEADER = "video,collision_frame,target,kind,manner\n"
# Seeds 1 and 3 collide, in frames 12 and 13.
LABELS_OF_4 = HEADER + (
    "quick-0000.mp4,,wall,rendered,\nquick-0001.mp4,12,wall,rendered,\n"
    "quick-0002.mp4,,wall,rendered,\nquick-0003.mp4,13,wall,rendered,\n"
)
LABELS_OF_2 = "".join(LABELS_OF_4.splitlines(keepends=True)[:3])


@pytest.fixture
def synth(dlgmd, monkeypatch):
    """Call `dlgmd synth quick --count 4 --out flights`, with some seeds at fault."""

    def call(*arguments, count=4, jobs=1, **faults):
        monkeypatch.setitem(SCENES, "quick", Quick(**faults))
        fleet = ["quick", "--out", OUT, "--count", count, "--jobs", jobs]
        return dlgmd("synth", *fleet, *arguments)

    return call


def labels():
    return (OUT / "labels.csv").read_text("ascii")


def identities():
    """Which file each one is: another one after it was written anew."""
    return {path.name: path.stat().st_ino for path in OUT.iterdir() if path.name != "labels.csv"}


# Whole


def test_flights_and_their_labels(synth):
    result = synth()
    assert result.exit_code == 0, result.output
    assert result.stdout == f"{OUT / 'labels.csv'}\n" and result.stderr == ""
    assert labels() == LABELS_OF_4
    names = [f"quick-000{i}.{suffix}" for i in range(4) for suffix in ("csv", "mp4", "yaml")]
    assert sorted(path.name for path in OUT.iterdir()) == ["labels.csv", *names]
    for number in range(4):
        assert yaml_of(OUT / f"quick-000{number}.yaml")["seed"] == number


def test_a_flight_is_the_one_of_its_seed(synth, dlgmd):
    synth("--seed", 10, count=3)
    assert not yaml_of(OUT / "quick-0002.yaml")["agile"]
    single = dlgmd("synth", "quick", "--seed", 12)
    assert single.stdout.split() == ["quick.mp4", "quick.csv", "quick.yaml"]
    for suffix in ("mp4", "csv", "yaml"):
        assert Path(f"quick.{suffix}").read_bytes() == (OUT / f"quick-0002.{suffix}").read_bytes()


def test_folders_of_pictures(synth):
    assert synth("--png", "--frames", 2, count=2).exit_code == 0
    assert labels() == HEADER + "quick-0000,,wall,rendered,\nquick-0001,,wall,rendered,\n"


def test_every_scene_goes_to_other_processes():
    for scene in SCENES.values():
        assert pickle.loads(pickle.dumps(scene)).name == scene.name


# Going on


def test_what_is_there_is_not_rendered_again(synth):
    synth(count=2)
    assert labels() == LABELS_OF_2
    before = identities()
    result = synth()
    assert result.exit_code == 0 and result.stderr == "2 of 4 flights were already there.\n"
    assert before.items() <= identities().items() and labels() == LABELS_OF_4
    for path in OUT.glob("quick-0002.*"):
        path.unlink()
    assert synth().stderr == "3 of 4 flights were already there.\n"
    before = identities()
    (OUT / "labels.csv").unlink()
    result = synth("--overwrite", at_0="error", at_1="error")
    assert result.exit_code == 0 and identities() == before and labels() == LABELS_OF_4
    # Fewer flights do not take others off the list.
    result = synth(count=2)
    assert result.exit_code == 2 and "lists other videos, such as quick-0002.mp4" in result.stderr
    assert labels() == LABELS_OF_4


@pytest.mark.parametrize(
    ("arguments", "differing"),
    [(["--size", "48x16"], "--size"), (["--agile"], "--agile"), (["--seed", 1], "seed")],
)
def test_flights_of_other_settings_are_refused(synth, arguments, differing):
    synth(count=2)
    before = files_of(OUT)
    result = synth(*arguments, count=2)
    assert result.exit_code == 2
    assert f"quick-0000.yaml: another flight already exists here ({differing})" in result.stderr
    assert files_of(OUT) == before
    assert synth(*arguments, "--overwrite", count=2).exit_code == 0
    assert files_of(OUT).keys() == before.keys() and files_of(OUT) != before


def test_files_of_others_are_refused(synth):
    OUT.mkdir()
    (OUT / "quick-0003.csv").write_text("mine")
    result = synth()
    assert result.exit_code == 2 and "quick-0003.csv: already exists" in result.stderr
    assert [path.name for path in OUT.iterdir()] == ["quick-0003.csv"]


def test_a_record_without_a_target_is_a_label_without_one(synth):
    synth(count=1)
    record = OUT / "quick-0000.yaml"
    record.write_text(record.read_text().replace("target: wall", "target: ~\nmanner: walk"))
    assert synth(count=1).exit_code == 0 and labels() == HEADER + "quick-0000.mp4,,,rendered,walk\n"


@pytest.mark.parametrize(
    ("damage", "why"),
    [
        *((one, "(damaged)") for one in ("no mp4", "no csv", "collision_frame: -3")),
        *((one, "already exists") for one in ("scene: [", "target: wall")),
    ],
)
def test_a_damaged_flight_is_none(synth, damage, why):
    synth(count=2)
    record = OUT / "quick-0001.yaml"
    if damage.startswith("no "):
        record.with_suffix(f".{damage[3:]}").unlink()
    elif damage.startswith("collision_frame"):
        record.write_text(record.read_text().replace("collision_frame: 12", damage))
    else:
        record.write_text(f"{damage}\n")
    result = synth(count=2)
    assert result.exit_code == 2 and "quick-0001" in result.stderr and why in result.stderr
    assert synth("--overwrite", count=2).exit_code == 0
    assert labels() == LABELS_OF_2


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (HEADER + "quick-0001.mp4,3\nother.mp4,5\n", "lists other videos, such as other.mp4"),
        ("", "contains no labels"),
        (HEADER + "quick-0001.mp4,soon\n", "line 2 is not a label"),
    ],
)
def test_labels_of_others_are_refused(synth, text, why):
    OUT.mkdir()
    (OUT / "labels.csv").write_text(text)
    result = synth()
    assert result.exit_code == 2 and f"labels.csv: {why}. Add --overwrite" in result.stderr
    assert files_of(OUT) == {"labels.csv": text.encode()}
    assert synth("--overwrite").exit_code == 0 and labels() == LABELS_OF_4


# Ending before the end


def test_one_that_fails_keeps_the_others(synth):
    result = synth(at_1="error")
    assert result.exit_code == 1
    first, last = result.stderr.splitlines()
    assert first.startswith("Error: quick-0001: here: ")
    assert last.startswith("Error: 1 of 4 flights failed; the other 3 are in ")
    assert labels() == LABELS_OF_4.replace("quick-0001.mp4,12,wall,rendered,\n", "")
    assert not list(OUT.glob("quick-0001*"))
    assert synth().exit_code == 0 and labels() == LABELS_OF_4


def test_what_a_killed_process_left_is_removed(synth):
    (OUT / ".dlgmd-abc").mkdir(parents=True)
    (OUT / ".dlgmd-abc" / "video.mp4").touch()
    (OUT / ".dlgmd-quick-0001.csv").touch()
    assert synth(count=1).exit_code == 0
    assert len(os.listdir(OUT)) == 4


def test_a_flight_too_short_for_the_frames_fails_alone(synth):
    result = synth("--seed", SHORT - 1, "--frames", 15, count=3)
    assert result.exit_code == 1 and result.stderr.startswith("Error: quick-0001: ")
    assert "--frames: the flight ends aft" in result.stderr
    assert labels() == HEADER + "quick-0000.mp4,,wall,rendered,\nquick-0002.mp4,,wall,rendered,\n"


@pytest.mark.parametrize(
    ("fault", "code", "message"),
    [("bug", 1, "internal error (IndexError)"), ("interrupt", 130, "Interrupted.\n")],
)
def test_an_early_end_keeps_what_is_there(synth, fault, code, message):
    result = synth(at_2=fault)
    assert result.exit_code == code and message in result.stderr
    assert f"{OUT} holds 2 of 4 flights; run the same command again" in result.stderr
    assert labels() == LABELS_OF_2
    assert len(os.listdir(OUT)) == 7
    before = identities()
    again = synth()
    assert again.exit_code == 0 and again.stderr == "2 of 4 flights were already there.\n"
    assert labels() == LABELS_OF_4 and before.items() <= identities().items()


def test_an_interrupt_before_the_first_flight_leaves_nothing(synth):
    result = synth(at_0="interrupt")
    assert result.exit_code == 130 and result.stderr == "Interrupted.\n"
    assert result.stdout == "" and not OUT.exists()
