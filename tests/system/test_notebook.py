"""The notebook among the samples runs as it is, and holds what it makes."""

import shutil
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

SAMPLES = Path(__file__).parents[2] / "sample_videos"
NOTEBOOK = SAMPLES / "notebook.ipynb"


def kinds(notebook):
    """What every cell shows."""
    return [
        [(output["output_type"], *sorted(output.get("data", ()))) for output in cell["outputs"]]
        for cell in notebook.cells
        if cell["cell_type"] == "code"
    ]


@pytest.mark.filterwarnings("default")  # of what Jupyter's packages deprecate
def test_the_notebook_runs_and_shows_what_it_shows_here(tmp_path):
    nbformat = pytest.importorskip("nbformat", reason="the notebook needs nbclient")
    nbclient = pytest.importorskip("nbclient", reason="the notebook needs nbclient")
    pytest.importorskip("ipykernel", reason="the notebook needs ipykernel")
    pytest.importorskip("pandas", reason="the notebook needs pandas")
    for clip in ("group2.mp4", "looming-cube.mp4"):
        shutil.copy(SAMPLES / clip, tmp_path)
    kept, run = (nbformat.read(NOTEBOOK, as_version=4) for _ in range(2))
    where = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(run, timeout=300, resources=where).execute()  # raises a cell's error
    assert kinds(run) == kinds(kept)
    figures = [kind for cell in kinds(run) for kind in cell if "image/png" in kind]
    assert len(figures) == 4
    assert (tmp_path / "group2-overview.pdf").read_bytes().startswith(b"%PDF")
    assert NOTEBOOK.stat().st_size < 300_000
