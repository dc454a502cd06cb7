"""`dlgmd reproduce` as a program: flights, a sweep, Table IV and the timing, and Ctrl-C."""

import csv
import os
import signal
import subprocess
import sys
import time

import pytest

from dlgmd_cli.parameters import FORMULATIONS
from dlgmd_cli.reproduce.claims import load_claims, select

pytestmark = pytest.mark.slow
COMMAND = (sys.executable, "-m", "dlgmd_cli", "reproduce", "--quick")


def test_a_quick_report(tmp_path):
    only = "fig6,fig8,fig11,fig13,fig15,table4"
    out = tmp_path / "paper"
    subprocess.run([*COMMAND, "--only", only, "--out", out, "--jobs", "2"], check=True, timeout=600)
    specs = select(load_claims()[0], only.split(","))
    with (out / "claims.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    ids = [key for spec in specs.values() for key in spec.claims]
    assert list(dict.fromkeys(row["id"] for row in rows)) == ids
    verdict = {(row["id"], row["formulation"]): row["holds"] for row in rows}
    for key in ids:
        assert (key, "any") in verdict or all((key, f) in verdict for f in FORMULATIONS)
    # What the formulations are known to differ in.
    assert verdict["fig8-capsules", "default"] == "yes"
    assert verdict["fig8-capsules", "equations"] == "no"
    assert verdict["fig11-alone", "released"] == verdict["fig13a-emd-group1", "any"] == "yes"
    for name in ("fig6.png", "fig11.pdf", "fig13b.png", "table4-da.png", "report.html"):
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
