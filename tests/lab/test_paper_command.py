"""`dlgmd lab paper` as a command: flights, a sweep, Table IV, the authors' frames, errors."""

import os
import re
import sys

import cv2
import numpy as np
import pytest
from conftest import csv_rows

from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.lab.fly.fly import Flight, fly
from dlgmd_cli.lab.paper import clips, free, stimuli, table4
from dlgmd_cli.lab.paper.claims import COLUMNS, NO, YES, load_claims, select
from dlgmd_cli.lab.paper.clips import VERSIONS, Clip
from dlgmd_cli.lab.paper.paper import EXHIBITS
from dlgmd_cli.lab.paper.plan import ANY, Plan, Started, compute, needed, trials_of

PHASES = {"take off": (9, 40), "pitch": (40, 50), "accelerate": (50, 125), "decelerate": (125, 140)}


def ball(scene, *, seed, size, fps):
    """A flight in which a dark square grows before noise, until frame 140, without a renderer."""
    frames = np.random.default_rng(seed).integers(120, 140, (145, 27, 48)).astype(np.uint8)
    for n, frame in enumerate(frames):
        half = min(13, 26 // max(1, 141 - n))
        frame[13 - half : 13 + half, 24 - half : 24 + half] = 20
    return Flight(frames, fps, None, None, 140, {"phases": PHASES})


@pytest.fixture
def quick(monkeypatch):
    """Two seeds, of small flights that nothing renders, in this process."""
    monkeypatch.setattr("dlgmd_cli.lab.paper.plan.FEW_SEEDS", 2)
    monkeypatch.setattr(clips, "fly", ball)


def test_a_quick_report(tmp_path, runs, quick):
    only = "fig6-fast,fig15"
    runs("lab", "paper", "--quick", "--only", only, "--out", "paper", "--jobs", 1)
    out = tmp_path / "paper"
    rows = csv_rows(out / "claims.csv")
    specs = select(load_claims()[0], only.split(",")).values()
    each = {key: claim for spec in specs for key, claim in spec.claims.items()}
    assert list(dict.fromkeys(row["id"] for row in rows)) == list(each)
    read = {(row["id"], row["reading"]) for row in rows}
    assert {(c.id, r.label) for c in each.values() for r in c.readings.values()} < read
    assert ("fig15-silent", "level held for 2 frames") in read
    rows = [row for row in rows if not row["reading"]]
    verdict = {(row["id"], row["formulation"]): row["at_first"] for row in rows}
    for key in each:
        seen = {(key, ANY), *((key, version) for version in VERSIONS)} & verdict.keys()
        assert len(seen) in (1, len(VERSIONS))
    # What the versions are known to differ in.
    assert verdict["fig6-fast", "nearest-unlimited"] == YES
    assert verdict["fig6-fast", "default"] == NO
    each = [row for row in rows if (row["id"], row["formulation"]) == ("fig15-rising", "default")]
    assert [row["seed"] for row in each] == ["0", "1"]
    assert len({row["input_sha256"] for row in each}) == 2 and {row["input"] for row in each}
    assert all(row["dlgmd"] and row["cpu"] and row["os"] for row in rows)
    for name in ("fig6.png", "fig15.pdf", "report.html"):
        assert (out / name).stat().st_size > 1000
    assert not [name for name in os.listdir(out) if name.startswith(".dlgmd")]


@pytest.mark.parametrize("name", ["fig1", "fig9", "fig14"])
def test_each_free_constant_that_an_exhibit_reads_is_tried(name, quick, monkeypatch):
    read = set()

    class Read(dict):
        def get(self, key, default=None):
            read.add(key)
            return default

    started = Started(EXHIBITS[name], Plan(quick=True))
    data = compute(needed([started]), 1, lambda n, name: None)
    monkeypatch.setattr(free, "_TRIED", Read())
    started.evidence(data)
    assert read == {trial.constant for trial in trials_of(name, Plan(quick=True))}


def test_the_authors_frames_decide(tmp_path, runs):
    (tmp_path / "frames/looming_ball").mkdir(parents=True)
    for index, frame in enumerate(
        clips.seen(Clip.of("looming-ball", size="40x30", frames=25)).frames
    ):
        cv2.imwrite(str(tmp_path / f"frames/looming_ball/{index + 1:03d}.png"), frame)
    runs("lab", "paper", "--only", "fig10,fig5-excitation", "--reference", "frames", "--quick")
    rows = csv_rows(tmp_path / "dlgmd-paper/claims.csv")
    frames = {(row["id"], row["shown_on"]) for row in rows}
    assert {one for key, one in frames if key == "fig10-rising"} == {"authors' frames"}
    assert {one for key, one in frames if key == "fig5-excitation"} == {"own frames"}
    page = (tmp_path / "dlgmd-paper/report.html").read_text("utf-8")
    assert "on: authors&#39; frames" in page


def test_what_needs_no_flight_needs_no_renderer(dlgmd, runs, tmp_path, monkeypatch):
    monkeypatch.setattr(clips, "fly", None)
    runs("lab", "paper", "--only", "fig5-kernel, fig5", "--quick", "--out", "paper")
    rows = csv_rows("paper/claims.csv")
    assert tuple(rows[0]) == COLUMNS
    holds = {(row["id"], row["formulation"]): row["holds"] for row in rows}
    assert holds["fig5-rises", ANY] == YES
    assert holds["fig5-excitation", "released-2020"] == holds["fig5-excitation", "equations"] == YES
    assert holds["fig5-kernel-r6", ANY] == NO
    html = (tmp_path / "paper/report.html").read_text("utf-8")
    assert not re.search(r'(?:src|href)="(?!data:|#)|http', html) and "url(" not in html
    assert html.count("data:image/png;base64,") == 1 and "Group 5 ends" in html
    again = dlgmd("lab", "paper", "--only", "fig5", "--out", "paper")
    assert again.exit_code == 2 and "already exists" in again.stderr
    runs("lab", "paper", "--only", "fig5", "--out", "paper", "--overwrite")


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--only", "fig99"], "the paper has no 'fig99'"),
        (["--reference", "."], "neither looming_ball nor ball_and_capsules"),
        (["--reference", "nowhere"], "does not exist"),
        (["--jobs", "0"], "'--jobs'"),
    ],
    ids=" ".join,
)
def test_refusals_are_one_line(dlgmd, arguments, why):
    result = dlgmd("lab", "paper", *arguments)
    assert result.exit_code == 2 and why in result.stderr.splitlines()[-1]


def test_without_jinja_one_line_says_what_to_install(dlgmd, monkeypatch):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    result = dlgmd("lab", "paper", "--only", "fig5")
    assert result.exit_code == 1 and "jinja2" in result.stderr and "pip install" in result.stderr


def test_flights_have_what_the_claims_ask_for():
    try:
        fly("group1", size="32x18")
    except DlgmdError as error:
        pytest.skip(f"no flights here: {error}")
    found = clips.run_clip(Clip.of("group2", size="96x54", seed=0), {"lgmd": "lgmd"})
    assert found.phases["decelerate"][0] == 125 and found.collision_frame == 140
    assert {"pitch", "accelerate"} <= found.phases.keys()
    frame, level = table4.false_positive(found), stimuli.sigmoid(found.results["lgmd"])
    first, last = found.phases["pitch"][0], found.collision_frame - free.frames("approach")
    assert first <= frame < last and level[frame] == level[frame - 1 : frame + 2].max()
