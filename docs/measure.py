"""Measure tables of the pages with today's code, and write them into the pages.

    python docs/measure.py               # the tables, how old they are, and how long they take
    python docs/measure.py NAME ...      # measure these, and write them into their pages
    python docs/measure.py --check       # name the tables that are older than the code; never fails

A table stands between `<!-- measured: NAME VERSION DIGEST -->` and `<!-- end -->`. The digest is of
the files that its numbers come from (`SOURCES`): if it is another one now, the table is older.
Flights are rendered into FOLDER once and used again: `--work FOLDER` (default: build/measure).
Tables of real clips read them from the folder that DLGMD_REFERENCE names.
"""

import argparse
import hashlib
import re
import subprocess
from pathlib import Path

import measured
from measured import ROOT, TABLES

import dlgmd_cli

MARK = re.compile(r"<!-- measured: (\S+) (\S+) (\S+) -->\n.*?<!-- end -->", re.DOTALL)
# What numbers of alarms come from: models, rendered flights, scores.
SOURCES = (
    "dlgmd_cli/frame.py",
    "dlgmd_cli/models",
    "dlgmd_cli/scenes/flights",
    "dlgmd_cli/results/scoring.py",
    "dlgmd_cli/tasks/evaluate",
    "configs/flight.yaml",
    "configs/flight-small.yaml",
)


def digest() -> str:
    """A digest of `SOURCES`."""
    sha = hashlib.sha256()
    for name in SOURCES:
        place = ROOT / name
        for path in [place] if place.is_file() else sorted(place.rglob("*")):
            if path.suffix in (".py", ".yaml"):
                sha.update(path.read_bytes())
    return sha.hexdigest()[:8]


def version() -> str:
    """The version of this checkout, with its commit."""
    command = ["git", "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout
    return f"{dlgmd_cli.__version__}+{commit.strip()}"


def pages() -> list[Path]:
    """The pages that may have tables."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def stamps() -> dict[str, tuple[Path, str, str]]:
    """The page, the version and the digest of each table that stands in a page."""
    return {
        name: (page, version, stamp)
        for page in pages()
        for name, version, stamp in MARK.findall(page.read_text(encoding="utf-8"))
    }


def write(name: str) -> None:
    """Measure a table, and write it into its page with today's stamp."""
    page, *_ = stamps()[name]
    measured_table = TABLES[name][0]()
    head = f"<!-- measured: {name} {version()} {digest()} -->"
    block = f"{head}\n\n{measured_table}\n\n*Measured with {version()}.*\n<!-- end -->"
    pattern = rf"<!-- measured: {re.escape(name)} \S+ \S+ -->\n.*?<!-- end -->"
    text = page.read_text(encoding="utf-8")
    page.write_text(re.sub(pattern, lambda _: block, text, flags=re.DOTALL), encoding="utf-8")


def main() -> None:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--work", type=Path, default=measured.WORK)
    given = parser.parse_args()
    measured.WORK = given.work.resolve()
    known = stamps()
    if unknown := {*given.names} - {*known}:
        raise SystemExit(f"No page has the table {', '.join(unknown)}. Known: {', '.join(known)}.")
    for name in given.names:
        write(name)
        print(f"{name}: written")
    if given.names:
        return
    today = digest()
    for name, (page, version, stamp) in known.items():
        age = "as the code is" if stamp == today else "older than the code"
        if not given.check or stamp != today:
            minutes = TABLES[name][1]
            print(f"{name}: {page.name}, of {version}, {age}; about {minutes} min to measure")


if __name__ == "__main__":
    main()
