"""`dlgmd reproduce` as a program: flights, a sweep, Table IV and the timing, and Ctrl-C."""

import os
import re
import signal
import subprocess
import sys
import time

import cv2
import pytest
from conftest import csv_rows

from dlgmd_cli.lab.paper import clips, flights, stimuli, table4
from dlgmd_cli.lab.paper.claims import COLUMNS, NO, YES, load_claims, select
from dlgmd_cli.lab.paper.clips import VERSIONS, Clip, other_models
from dlgmd_cli.lab.paper.plan import ANY, FOLDER
from dlgmd_cli.plots.style import width_in

pytestmark = pytest.mark.slow
COMMAND = (sys.executable, "-m", "dlgmd_cli", "reproduce", "--quick")


@pytest.fixture
def few_seeds(monkeypatch):
    """Two seeds in this process; a report in another one has six."""
    monkeypatch.setattr("dlgmd_cli.lab.paper.plan.FEW_SEEDS", 2)


def test_a_quick_report(tmp_path, runs, few_seeds):
    only = "fig6,fig8,fig11,fig13,table4"
    runs("reproduce", "--quick", "--only", only, "--out", "paper", "--jobs", 2)
    out = tmp_path / "paper"
    specs = select(load_claims()[0], only.split(","))
    rows = csv_rows(out / "claims.csv")
    larger = ("best", "smaller", "reduced", "turns", "r2", "r2-only")
    at_full_size = {f"table4-da-{name}" for name in larger}
    ids = [key for spec in specs.values() for key in spec.claims if key not in at_full_size]
    assert list(dict.fromkeys(row["id"] for row in rows)) == ids
    verdict = {(row["id"], row["formulation"]): row["verdict"] for row in rows}
    for key in ids:
        seen = {(key, ANY), *((key, version) for version in VERSIONS)} & verdict.keys()
        assert len(seen) in (1, len(VERSIONS)) or key.startswith("table4-time")
    # What the versions are known to differ in.
    assert verdict["fig6-fast", "nearest-unlimited"] == YES
    assert verdict["fig6-fast", "default"] == NO
    each = [
        row for row in rows if (row["id"], row["formulation"]) == ("table4-da-above-1", "default")
    ]
    assert [row["seed"] for row in each] == ["0", "1"]
    assert len({row["input_sha256"] for row in each}) == 2 and {row["input"] for row in each}
    # None of these holds without inhibition.
    held = {(row["id"], row["formulation"]) for row in rows if row["null_holds"] == YES}
    assert not held & {(key, "default") for key in ("fig6-fast", "fig8-capsules")}
    for name in ("fig6.png", "fig11.pdf", "fig13-ffi.png", "table4-da.png", "report.html"):
        assert (out / name).stat().st_size > 1000
    left = {name for name in os.listdir(out) if name.startswith(".dlgmd") or name == FOLDER}
    assert not left


def test_an_interrupted_report_continues(tmp_path):
    command = [*COMMAND, "--only", "fig1", "--out", tmp_path / "paper", "--jobs", "2"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    kept = tmp_path / "paper" / FOLDER
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and not [*kept.glob("*.npz")]:
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)
    assert "Interrupted." in process.communicate(timeout=60)[1]
    assert process.returncode == 130 and os.listdir(tmp_path / "paper") == [FOLDER]
    before = {path.name: path.stat().st_mtime_ns for path in kept.glob("*.npz")}
    assert before
    subprocess.run(command, check=True, timeout=300)
    assert (tmp_path / "paper/report.html").is_file() and not kept.exists()


def test_the_authors_frames_stand_beside_ours(tmp_path, runs):
    (tmp_path / "frames/looming_ball").mkdir(parents=True)
    with clips.open_clip(Clip.of("looming-ball", size=(30, 40), frames=25)) as video:
        for frame in video:
            path = tmp_path / f"frames/looming_ball/{frame.index + 1:03d}.png"
            cv2.imwrite(str(path), frame.grey)
    runs("reproduce", "--only", "fig10,fig6-fast", "--reference", "frames", "--quick")
    rows = csv_rows(tmp_path / "dlgmd-paper/claims.csv")
    frames = {(row["id"], row["shown_on"]) for row in rows}
    both = {"own frames", "authors' frames"}
    assert {one for key, one in frames if key == "fig10-rising"} == both
    assert {one for key, one in frames if key == "fig6-fast"} == {"own frames"}
    assert "judged on: authors&#39; frames" in (tmp_path / "dlgmd-paper/report.html").read_text()
    assert "own frames: " in (tmp_path / "dlgmd-paper/report.html").read_text("utf-8")


def test_latency_without_models(dlgmd, runs, tmp_path):
    common = ("reproduce", "--only", "fig5, fig6-fast", "--quick", "--out", "paper")
    runs(*common, "--dpi", 60)
    width_px = cv2.imread("paper/fig6.png").shape[1]
    assert width_px == pytest.approx(60 * width_in("two"), abs=2)
    rows = csv_rows("paper/claims.csv")
    assert tuple(rows[0]) == COLUMNS
    holds = {(row["id"], row["formulation"]): row["holds"] for row in rows}
    assert holds["fig5-rises", ANY] == YES
    assert holds["fig5-excitation", "released-2020"] == holds["fig5-excitation", "equations"] == YES
    assert holds["fig5-kernel-r6", ANY] == NO
    html = (tmp_path / "paper/report.html").read_text("utf-8")
    assert not re.search(r'(?:src|href)="(?!data:|#)|http', html) and "url(" not in html
    assert html.count("data:image/png;base64,") == 4 and "Group 5 ends" in html
    for name in ("fig6.png", "fig5.pdf"):
        assert (tmp_path / "paper" / name).stat().st_size > 1000
    again = dlgmd("reproduce", "--only", "fig5", "--out", "paper")
    assert again.exit_code == 2 and "already exists" in again.stderr
    runs("reproduce", "--only", "fig5", "--out", "paper", "--overwrite")


def test_group_2_brakes_at_the_papers_frame():
    found = clips.run_clip(Clip.of("group2-late", size=(18, 32), seed=0), other_models("lgmd"))
    assert found.phases["decelerate"][0] == 125 and found.collision_frame == 140


def test_the_lgmds_first_false_peak():
    clip = clips.run_clip(Clip.of("group1", size=(54, 96), seed=0), other_models("lgmd"))
    frame = table4.false_positive(clip)
    level = stimuli.sigmoid(clip.results["lgmd"])
    first, last = clip.phases["pitch"][0], clip.collision_frame - flights.APPROACH_FRAMES
    assert first <= frame < last and level[frame] == level[frame - 1 : frame + 2].max()
