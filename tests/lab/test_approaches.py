"""The tables of real approaches, on made-up truth and measurements."""

from types import SimpleNamespace

import numpy as np
import pytest

import dlgmd_cli
from dlgmd_cli.lab.measure import approaches
from dlgmd_cli.models.rules import LEAST_QUALITY
from dlgmd_cli.results.labels import NEAR_1_S, read_cases

TRUTH = """frame,time_s,distance_m,closing_m_s
0,0.0,4.0,1.0
1,1.0,2.0,1.0
2,2.0,1.0,2.5
3,3.0,0.04,0.5
4,9.0,1.0,0.1
5,9.5,,
"""


@pytest.fixture
def case(tmp_path):
    """A labelled clip, without its video, whose closest approach is at frame 4."""
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "clip.csv").write_text(TRUTH, encoding="utf-8")
    labels = tmp_path / "labels.csv"
    labels.write_text("video,collision_frame\nclip.mp4,4\nnone.mp4,\n", encoding="utf-8")
    return read_cases(labels)[0]


def test_constants_are_those_of_the_alarm():
    assert approaches.QUALITY == LEAST_QUALITY
    assert dlgmd_cli.load_config("flight").values["expansion_alarm"] == approaches.ALARM


def test_truth_too_near_or_too_fast_is_left_out(case):
    assert approaches.truth_of(case) == {0: 0.25, 1: 0.5, 4: 0.1}
    without = SimpleNamespace(path=case.path.replace("clip", "none"), name="none.mp4")
    assert approaches.truth_of(without) == {}


def test_the_oracle_needs_a_true_rate_shortly_before(case):
    assert NEAR_1_S == 0.45 and 1 in case.near
    assert not approaches.reached((case, 4))  # 6 s after the last fast frame
    assert approaches.reached((case, 3)) and not approaches.reached((case, 0))


def compared(true, measured, quality):
    true = np.array(true, float)
    parts = np.array(measured, float), np.array(quality, float), np.arange(len(true)) / 10
    return approaches.Compared(true, *parts)


def test_ratios_and_shares():
    true = [0.0, 0.0, 0.5, 0.5, 0.5, 1.0, 1.0, -1.0]
    measured = [-0.1, 0.1, 0.25, 0.5, 0.75, 0.9, np.nan, 5.0]
    cells = approaches._ratios(compared(true, measured, [1, 1, 1, 1, 0.3, 1, 0, 1]))
    still, slow, fast, frames, good = cells
    assert still == "0.00 (-0.08 to 0.08)"
    assert slow == "1.00 (0.60 to 1.40)" and fast.startswith("0.90 ")
    assert (frames, good) == ("5", "60")


def test_figures_are_drawn(monkeypatch, tmp_path):
    frames = compared(np.ones(10), np.ones(10), np.arange(10) / 10)
    monkeypatch.setattr(approaches, "of_group", lambda group: frames)
    monkeypatch.setattr(approaches, "compared", lambda path, fps: frames)
    names = (*approaches.MISSED, *approaches.FALSE)
    clips = [SimpleNamespace(name=f"{one}.mp4", path=one, collisions=(4,)) for one in names]
    monkeypatch.setattr(approaches, "cases", lambda: clips)
    approaches.draw(tmp_path)
    written = {path.stem for path in tmp_path.glob("*.png")}
    assert written == {"approaches", "approaches-missed", "approaches-false"}
