"""The script that labels the approaches of ODA, on a straight course of known time to contact."""

import runpy
import sys
from pathlib import Path

import numpy as np

from dlgmd_cli.results.labels import read_cases

SCRIPT = Path(__file__).parents[1] / "benchmarks/label_oda.py"
OVERVIEW = """Sequence,Obstacle x,Obstacle y,Obstacle z,Lux,OptiTrack offset,Incl. Video
7,3.0,2.0,0.0,100,0,1
8,3.0,2.0,2.0,1,0,1
8,3.0,2.0,-2.0,1,0,1
9,3.0,2.0,0.0,100,0,0
"""


def test_a_straight_course(tmp_path, monkeypatch):
    (tmp_path / "trial_overview.csv").write_text(OVERVIEW)
    time_s = np.arange(0, 2, 0.0125)
    for number in "789":  # along x from 0 with 1.5 m/s: at a pole, or 2 m beside two
        (tmp_path / number).mkdir()
        poses = np.stack([time_s * 1e9, 1.5 * time_s, 0 * time_s, 0 * time_s], axis=1)
        np.savetxt(tmp_path / number / "optitrack.csv", poses, delimiter=",", header="t,x,y,z")
    out = tmp_path / "out"
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), str(tmp_path), str(out)])
    runpy.run_path(str(SCRIPT))
    near, far = read_cases(out / "labels.csv")
    manners = [case.labels[0].manner for case in (near, far)]
    assert (near.collisions, far.collisions) == ((59,), ())  # the last frame, or none
    assert manners == ["1 pole(s), 100 lux", "2 pole(s), 1 lux"]
    assert near.labels[0].speed_m_s == 1.5 and near.near and not far.near
    truth = np.genfromtxt(out / "truth/7.csv", delimiter=",", names=True)
    ahead = truth["time_s"] < (3.0 - 0.45) / 1.5
    left_s = (3.0 - 0.45) / 1.5 - truth["time_s"]
    np.testing.assert_allclose(truth["time_to_contact_s"][ahead], left_s[ahead], atol=1e-6)
    np.testing.assert_allclose(truth["distance_m"], 3.0 - 0.45 - 1.5 * truth["time_s"], atol=1e-6)
    np.testing.assert_allclose(truth["closing_m_s"], 1.5, atol=1e-5)
    truth = np.genfromtxt(out / "truth/8.csv", delimiter=",", names=True)
    assert np.isnan(truth["time_to_contact_s"]).all()
