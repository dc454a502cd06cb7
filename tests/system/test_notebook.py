"""The notebooks among the samples run as they are, and hold what they make."""

import os
import re
import shutil
from pathlib import Path

import pytest

from dlgmd_cli import load_config

pytestmark = pytest.mark.slow

takes_long = pytest.mark.skipif(
    not os.environ.get("DLGMD_THOROUGH"), reason="takes a minute: set DLGMD_THOROUGH=1"
)
SAMPLES = Path(__file__).parents[2] / "sample_videos"
MADE = {
    "notebook": "group2-overview.pdf",
    "own_clips": "my-drone.pdf",
    "looming": "looming.pdf",
}


def kinds(notebook):
    """What every cell shows."""
    return [
        [(output["output_type"], *sorted(output.get("data", ()))) for output in cell["outputs"]]
        for cell in notebook.cells
        if cell["cell_type"] == "code"
    ]


def texts(notebook):
    """What its outputs say."""
    return [
        o.get("data", {}).get("text/plain", "")
        for c in notebook.cells
        for o in c.get("outputs", ())
    ]


def frames(notebook):
    """The frames of alarms and peaks that its outputs name."""
    return re.findall(r"'(\w+_frame)': (\d+)", "".join(texts(notebook)))


@pytest.mark.filterwarnings("default")  # of what Jupyter's packages deprecate
@pytest.mark.parametrize(
    ("name", "n_figures"),
    [
        ("notebook", 4),
        pytest.param("own_clips", 2, marks=takes_long),
        pytest.param("looming", 2, marks=takes_long),
    ],
)
def test_a_notebook_runs_and_shows_what_it_shows_here(tmp_path, name, n_figures):
    nbformat = pytest.importorskip("nbformat", reason="the notebook needs nbclient")
    nbclient = pytest.importorskip("nbclient", reason="the notebook needs nbclient")
    pytest.importorskip("ipykernel", reason="the notebook needs ipykernel")
    pytest.importorskip("pandas", reason="the notebook needs pandas")
    for clip in SAMPLES.glob("*.mp4"):
        shutil.copy(clip, tmp_path)
    path = SAMPLES / f"{name}.ipynb"
    kept, run = (nbformat.read(path, as_version=4) for _ in range(2))
    where = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(run, timeout=300, resources=where).execute()  # raises a cell's error
    assert kinds(run) == kinds(kept) and frames(run) == frames(kept)
    figures = [kind for cell in kinds(run) for kind in cell if "image/png" in kind]
    assert len(figures) == n_figures
    assert (tmp_path / MADE[name]).read_bytes().startswith(b"%PDF")
    if name == "own_clips":
        assert load_config(tmp_path / "my-drone.yaml").values["n_sp"] == 1
    if name == "looming":
        assert texts(run) == texts(kept)  # its regressions
    assert path.stat().st_size < 350_000
