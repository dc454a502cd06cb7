"""`dlgmd run` against what the authors' released code printed, file against file."""

import csv

import pytest
from reference_data import reference_dir

pytestmark = pytest.mark.slow

TOLERANCE = 1e-5  # the released code computes in single precision


def rows(path):
    with path.open(newline="", encoding="ascii") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("number", range(1, 10))
@pytest.mark.parametrize("sequence", ["looming_ball", "ball_and_capsules"])
@pytest.mark.parametrize("engine", ["opencv", "numba"])
def test_every_row_agrees(dlgmd, tmp_path, engine, sequence, number):
    if engine == "numba":
        pytest.importorskip("numba", reason="the numba engine needs numba")
    folder = reference_dir()
    options = ["--formulation", "released", "--scale", 1, "--normalise", "sequence"]
    options += ["--engine", engine]
    result = dlgmd("run", folder / sequence, "--set", number, *options, "--no-plots")
    assert result.exit_code == 0, result.output
    out = tmp_path / "dlgmd-out" / sequence
    columns = {
        "s_sum": [row["s_sum"] for row in rows(out / "attenuation.csv")],
        "g_sum": [row["mp"] for row in rows(out / "mp.csv")],
    }
    reference = rows(folder / f"released_{sequence}_set{number}.csv")
    first = int(reference[0]["t"])
    assert all(cell == "" for column in columns.values() for cell in column[:first])
    assert len(reference) == len(columns["s_sum"]) - first
    for row in reference:
        for name, column in columns.items():
            expected = float(row[name])
            error = abs(float(column[int(row["t"])]) - expected) / max(abs(expected), 1.0)
            assert error < TOLERANCE, (row["t"], name)
