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

from dlgmd_cli.lab.reproduce import clips, flights, stimuli
from dlgmd_cli.lab.reproduce.claims import COLUMNS, NO, YES, load_claims, select
from dlgmd_cli.lab.reproduce.clips import LATE, VERSIONS, Clip, other_models
from dlgmd_cli.lab.reproduce.plan import ANY
from dlgmd_cli.plots.style import width_in

pytestmark = pytest.mark.slow
COMMAND = (sys.executable, "-m", "dlgmd_cli", "reproduce", "--quick")


def test_a_quick_report(tmp_path):
    only = "fig6,fig8,fig11,fig13,fig15,table4"
    out = tmp_path / "paper"
    subprocess.run([*COMMAND, "--only", only, "--out", out, "--jobs", "2"], check=True, timeout=600)
    specs = select(load_claims()[0], only.split(","))
    rows = csv_rows(out / "claims.csv")
    ids = [key for spec in specs.values() for key in spec.claims]
    assert list(dict.fromkeys(row["id"] for row in rows)) == ids
    verdict = {(row["id"], row["formulation"]): row["holds"] for row in rows}
    for key in ids:
        seen = {(key, ANY), *((key, version) for version in VERSIONS)} & verdict.keys()
        assert len(seen) in (1, len(VERSIONS)) or key == "table4-time"
    # What the versions are known to differ in.
    assert verdict["fig8-capsules", "default"] == verdict["fig6-fast", "nearest"] == YES
    assert verdict["fig8-capsules", "equations"] == verdict["fig6-fast", "default"] == NO
    assert verdict["fig11-alone", "released"] == verdict["fig13-emd-group1", ANY] == YES
    # None of these holds without inhibition.
    held = {(row["id"], row["formulation"]) for row in rows if row["null_holds"] == YES}
    assert not held & {
        (key, "default") for key in ("fig6-fast", "fig8-capsules", "fig15-attenuates")
    }
    for name in ("fig6.png", "fig11.pdf", "fig13-ffi.png", "table4-da.png", "report.html"):
        assert (out / name).stat().st_size > 1000
    assert not [name for name in os.listdir(out) if name.startswith(".dlgmd")]


def test_an_interruption_leaves_nothing(tmp_path):
    process = subprocess.Popen(
        [*COMMAND, "--out", tmp_path / "paper", "--jobs", "2"],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    time.sleep(8)
    os.killpg(process.pid, signal.SIGINT)
    assert "Interrupted." in process.communicate(timeout=60)[1]
    assert process.returncode == 130 and not (tmp_path / "paper").exists()


def test_latency_without_models(dlgmd, tmp_path):
    common = ("reproduce", "--only", "fig5, fig2-size", "--quick", "--out", "paper")
    result = dlgmd(*common, "--dpi", 60)
    assert result.exit_code == 0, result.output
    width_px = cv2.imread("paper/fig2.png").shape[1]
    assert width_px == pytest.approx(60 * width_in("two"), abs=2)
    rows = csv_rows("paper/claims.csv")
    assert tuple(rows[0]) == COLUMNS
    holds = {(row["id"], row["formulation"]): row["holds"] for row in rows}
    assert holds["fig2-size", ANY] == holds["fig5-rises", ANY] == YES
    assert holds["fig5-excitation", "released"] == NO
    assert holds["fig5-excitation", "equations"] == YES
    html = (tmp_path / "paper/report.html").read_text("utf-8")
    assert not re.search(r'(?:src|href)="(?!data:|#)|http', html) and "url(" not in html
    assert html.count("data:image/png;base64,") == 4 and "Group 5 ends" in html
    for name in ("fig2.png", "fig5.pdf"):
        assert (tmp_path / "paper" / name).stat().st_size > 1000
    again = dlgmd("reproduce", "--only", "fig5", "--out", "paper")
    assert again.exit_code == 2 and "already exists" in again.stderr
    assert dlgmd("reproduce", "--only", "fig5", "--out", "paper", "--overwrite").exit_code == 0


def test_group_2_brakes_at_the_papers_frame():
    found = clips.run_clip(Clip.of(LATE, size=(18, 32), seed=0), other_models("lgmd"))
    assert found.phases["decelerate"][0] == 125 and found.collision_frame == 140


def test_the_lgmds_first_false_peak():
    clip = clips.run_clip(Clip.of("group1", size=(54, 96), seed=0), other_models("lgmd"))
    frame = flights.false_positive(clip)
    level = stimuli.sigmoid(clip.results["lgmd"])
    first, last = clip.phases["pitch"][0], clip.collision_frame - flights.APPROACH_FRAMES
    assert first <= frame < last and level[frame] == level[frame - 1 : frame + 2].max()
