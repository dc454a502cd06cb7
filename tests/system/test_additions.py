"""What "To add …" of docs/contributing.md shows: each example touches two files, and is enough."""

import os
import re
import shutil
import subprocess
import sys

import pytest
from conftest import csv_rows, looming_frames, write_video
from documents import ROOT, text_of

pytestmark = pytest.mark.slow
DIFFS = re.findall(
    r"^```diff\n(.*?)^```$", text_of("docs/contributing.md"), re.DOTALL | re.MULTILINE
)
COLUMN, RULE = DIFFS
TOLD = "import tables; print(tables.columns('run'), tables.rules(), tables.files('run.yaml'))"


def side_of(hunk, sign):
    """The lines of a hunk before (-) or after (+) the change."""
    return "".join(
        f"{line[1:]}\n" for line in hunk.split("\n")[1:-1] if line[:1] in (sign, " ", "")
    )


@pytest.fixture
def changed(tmp_path, monkeypatch):
    """A function that applies a diff to a copy of the package, where a clip lies as well."""
    leave_out = shutil.ignore_patterns("__pycache__", "lab")
    for name in ("dlgmd_cli", "configs", "docs"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=leave_out)
    write_video(tmp_path / "loom.avi", looming_frames(40, 240, 136))
    monkeypatch.chdir(tmp_path)

    def apply(diff):
        _, *parts = re.split(r"^\+\+\+ (\S+)\n", diff, flags=re.MULTILINE)
        assert len(parts) == 2 * 2  # two files
        for name, hunks in zip(parts[::2], parts[1::2], strict=True):
            text = (tmp_path / name).read_text(encoding="utf-8")
            for hunk in re.findall(r"^@@.*?(?=^@@|\Z)", hunks, re.DOTALL | re.MULTILINE):
                assert text.count(side_of(hunk, "-")) == 1, f"{name}: {hunk}"
                text = text.replace(side_of(hunk, "-"), side_of(hunk, "+"))
            (tmp_path / name).write_text(text, encoding="utf-8")

    return apply


def python(*words):
    """What Python prints with the copy."""
    paths = os.pathsep.join([os.getcwd(), os.path.abspath("docs")])
    command = [sys.executable, *words]
    done = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return " ".join(done.stdout.split())


def run(*options):
    return python("-m", "dlgmd_cli", "run", "loom.avi", "--set", "9", "--out", "out", *options)


def test_a_column(changed):
    changed(COLUMN)
    run("--format=none")
    cells = [row["n_active"] for row in csv_rows("out/loom/mp.csv")]
    numbers = [float(cell) for cell in cells if cell]
    assert cells[0] == "" and 0 < max(numbers) < 240 * 136 and len({*numbers}) > 5
    assert "- `n_active`: number of cells with S > 0" in python("-c", TOLD)
    stored = "import dlgmd_cli; print(max(dlgmd_cli.read_result('out/loom').n_active[9:]))"
    assert float(python("-c", stored)) == max(numbers)


def test_a_rule(changed):
    changed(RULE)
    run("--format=none", "--alarm", "both", "--param", "kappa=3e-4")
    (alarm,) = csv_rows("out/loom/alarms.csv")
    assert alarm["rule"] == "both" and float(alarm["peak_signal"]) >= 0.47
    assert "- `both`: a spike at expansion_alarm or more" in python("-c", TOLD)
    assert "both: a spike at expansion_alarm or more" in run("--help")
