"""`dlgmd lab measure`: each table of numbers in the pages has a known source."""

from functools import partial
from pathlib import Path

import pytest

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.lab.measure import pages, tables

ROOT = Path(__file__).parents[2]
NUMBERS = "| model | saved |\n|---|---|\n| a | 3 of 4 |\n| b | **−0.5** |\n"
WORDS = "| key | default |\n|---|---|\n| a | 3 |\n| b | none given |\n| c | `x` |\n"
BLOCK = "<!-- measured: real 1.0 0 -->\n\n{}\n<!-- end -->\n"


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """A clone with two pages, in which the given text is added to one: `clone("| a |")`."""
    docs = tmp_path / "docs"
    docs.mkdir()
    (docs / "index.md").write_text("# Index\n", encoding="utf-8")
    (tmp_path / "printed.py").write_text("print(1)\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tables, "TABLES", {"real": tables.Measured(lambda: NUMBERS.strip(), 1)})

    def write(text, title="# Read me\n"):
        (tmp_path / "README.md").write_text(f"{title}\n{text}", encoding="utf-8")
        return tmp_path

    write(BLOCK.format(NUMBERS))
    return write


@pytest.fixture
def measure(dlgmd, clone):
    """Call `dlgmd lab measure` in the clone."""
    return partial(dlgmd, "lab", "measure")


def test_a_table_of_numbers_has_more_of_them_than_of_words():
    assert pages.is_of_numbers(NUMBERS) and not pages.is_of_numbers(WORDS)
    assert not pages.is_of_numbers("| a | b |\n|---|---|\n| 3 | |\n")  # the first column is names
    assert pages.is_of_numbers(
        "| a | b |\n|---|---|\n| x | – |\n| y | <!-- --> 5 |\n| z | ≤ 4 |\n| w | ~2 |\n"
    )


KNOWN = {
    "generated": "<!-- generated: sets -->\n\n" + NUMBERS + "<!-- end -->\n",
    "the paper": "<!-- source: the paper, Table IV -->\n" + NUMBERS,
    "a line between": "<!-- source: the code -->\n\n" + NUMBERS,
    "a script": "<!-- source: printed.py --random 12 -->\n" + NUMBERS,
    "no numbers": WORDS,
}
UNKNOWN = {
    "no mark": (NUMBERS, "no mark says where its numbers come from"),
    "not measured": (
        BLOCK.replace("real", "flights").format(NUMBERS),
        "nothing measures 'flights'",
    ),
    "elsewhere": ("<!-- source: a friend -->\n" + NUMBERS, "'a friend' is not a known source"),
    "no such script": ("<!-- source: gone.py -->\n" + NUMBERS, "'gone.py' is not a known source"),
    "after an end": (KNOWN["generated"] + "\n" + NUMBERS, "no mark says"),
    "a mark of another": (KNOWN["the paper"] + "\nWords.\n\n" + NUMBERS, "no mark says"),
}


@pytest.mark.parametrize("name", KNOWN)
def test_known_sources_pass(measure, clone, name):
    clone(BLOCK.format(NUMBERS) + "\n" + KNOWN[name])
    result = measure("--check")
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize("name", UNKNOWN)
def test_a_table_of_unknown_source_fails_the_check(measure, clone, name):
    text, why = UNKNOWN[name]
    folder = clone(BLOCK.format(NUMBERS) + "\n" + text)
    result = measure("--check")
    assert result.exit_code == 1 and why in result.stdout and "README.md:" in result.stdout
    assert result.stderr.startswith("Error: ") and result.stderr.count("\n") == 1
    line = int(result.stdout.rpartition("README.md:")[2].split(":")[0])
    assert (folder / "README.md").read_text(encoding="utf-8").splitlines()[line - 1].startswith("|")
    assert measure().exit_code == 0  # without --check, it tells


def test_a_mark_above_the_title_holds_for_the_page(measure, clone):
    clone(BLOCK.format(NUMBERS) + "\n" + NUMBERS, "<!-- source: dlgmd lab paper -->\n\n# Claims\n")
    assert measure("--check").exit_code == 0


def test_a_table_that_no_page_has_fails_the_check(measure, clone):
    clone("Nothing.\n")
    result = measure("--check")
    assert result.exit_code == 1 and "no page has 'real'" in result.stdout
    result = measure("real")
    assert result.exit_code == 1 and "no page has the table 'real'" in result.stderr


def test_age_is_told_and_fails_nothing(measure, clone, monkeypatch):
    result = measure("--check")
    assert result.exit_code == 0 and "1.0, older than the code" in " ".join(result.stdout.split())
    monkeypatch.setattr(pages, "digest", lambda at: "0")
    assert "1.0, as the code is" in " ".join(measure().stdout.split())


def test_a_table_is_measured_and_written_with_todays_version(measure, clone):
    folder = clone("Before.\n\n" + BLOCK.format("| old |") + "\nAfter.\n")
    assert measure("real").stdout == "real: README.md\n"
    text = (folder / "README.md").read_text(encoding="utf-8")
    stamp = f"<!-- measured: real {pages.version(folder)} {pages.digest(folder)} -->"
    assert stamp in text and NUMBERS in text and "| old |" not in text
    assert text.startswith("# Read me") and text.endswith("<!-- end -->\n\nAfter.\n")
    assert "as the code is" in measure("--check").stdout


def test_an_unknown_name_and_a_folder_that_is_no_clone(measure, clone, tmp_path):
    result = measure("rael")
    assert result.exit_code == 2 and "Choose from real" in result.stderr
    (tmp_path / "docs" / "index.md").unlink()
    result = measure()
    assert result.exit_code == 1 and "not a clone of dlgmd" in result.stderr


def test_the_pages_of_this_clone_have_known_sources(monkeypatch):
    monkeypatch.chdir(ROOT)
    found = [table for page in pages.pages(ROOT) for table in pages.tables_of(page)]
    faults = {
        f"{table.page.name}:{table.line}": pages.unknown_source(table, ROOT, tables.TABLES)
        for table in found
    }
    assert not {place: fault for place, fault in faults.items() if fault}
    assert all((ROOT / name).exists() for name in pages.CODE)


def test_errors_of_real_clips_need_their_place(monkeypatch):
    monkeypatch.delenv("DLGMD_REFERENCE", raising=False)
    with pytest.raises(ParameterError, match="DLGMD_REFERENCE"):
        tables.real()
