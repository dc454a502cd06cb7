"""`dlgmd synth --avoid`: a film of two flights, with the alarm in the loop and without."""

import sys
from pathlib import Path

import pytest
from conftest import csv_rows

sys.path.append(str(Path(__file__).parents[1] / "unit"))
from test_avoid import CONTACT_S, scene  # noqa: F401

pytestmark = pytest.mark.slow


def test_the_film_and_its_table(dlgmd, runs, scene):  # noqa: F811
    options = ("--size", "96x54", "--frames", 54, "--out", "a", "--name", "one")
    result = runs("synth", "wall", "--avoid", "flight", *options)
    assert result.stdout.startswith("a/one-avoid.mp4\na/one-avoid.png\na/one-avoid.csv\nWithout: ")
    assert "hits at 2.0 m/s. With flight:" in result.stdout.replace("\n", " ")
    rows = csv_rows(Path("a/one-avoid.csv"))
    by_flight = {word: [r for r in rows if r["flight"] == word] for word in ("without", "with")}
    alarms = [float(row["time_s"]) for row in by_flight["with"] if row["alarm"] == "1"]
    assert alarms and alarms[0] < CONTACT_S
    assert {(row["rule"], row["threshold"]) for row in rows} == {("expansion", "0.52")}
    is_above = [float(row["expansion"] or "nan") >= 0.52 for row in rows]
    assert is_above == [row["alarm"] == "1" for row in rows]
    assert float(by_flight["with"][50]["expansion"]) != 0.0
    assert float(by_flight["without"][30]["time_to_contact_s"]) == pytest.approx(CONTACT_S - 1.0)
    assert float(by_flight["without"][30]["distance_m"]) == pytest.approx(3.0)
    again = dlgmd("synth", "wall", "--avoid", "flight", "--out", "a", "--name", "one")
    assert again.exit_code == 2 and "already exists" in again.stderr
