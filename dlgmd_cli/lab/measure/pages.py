"""The tables of numbers in README.md and docs/, and where each has its numbers from.

A table of numbers is one in which more than half of the filled cells, the first column apart, begin
with a digit. A mark above it says where its numbers are from:

- `<!-- measured: NAME VERSION DIGEST -->`, and `<!-- end -->` below: `dlgmd lab measure NAME` has
  measured and written it. The digest is that of `CODE` then; if it is another one now, the table is
  older than the code.
- `<!-- generated: … -->`, and `<!-- end -->` below: `docs/generate.py` writes it.
- `<!-- source: WHERE -->`, directly above it, or above the title for all tables of a page. WHERE
  begins with one of `SOURCES`, or with the path of a file of the repository that prints the table.
"""

import hashlib
import re
import subprocess
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import dlgmd_cli
from dlgmd_cli.errors import ResultError, SourceError

# Sources of tables that no function here measures.
SOURCES = {
    "the code": "numbers that the code defines, or that follow from them by a formula",
    "the paper": "printed by Zhao et al. (2023)",
    "dlgmd evaluate": "printed by that command, and copied",
    "dlgmd run": "read from the tables that it writes",
    "dlgmd lab paper": "printed by that command, and copied",
    "dlgmd lab bench": "printed by that command, and copied",
    "dlgmd lab fly": "flights that it renders, scored by `dlgmd evaluate`, and copied",
    "published": "numbers of other people, whom the page cites",
}
# What the measured numbers come from.
CODE = (
    "dlgmd_cli/frame.py",
    "dlgmd_cli/reduction.py",
    "dlgmd_cli/models",
    "dlgmd_cli/results",
    "dlgmd_cli/tasks/evaluate",
    "dlgmd_cli/lab/fly",
    "configs",
)
_TABLE = re.compile(r"(?:^\|.*\n?){2,}", re.MULTILINE)
# A mark at the end of the text above a table: one without its end, and one directly above.
_BETWEEN = re.compile(r"<!-- (measured|generated): ([^\n]+?) -->\n(?:(?!<!--).)*\Z", re.DOTALL)
_ABOVE = re.compile(r"<!-- (source): ([^\n]+?) -->\s*\Z")
_OF_PAGE = re.compile(r"<!-- (source): ([^\n]+?) -->\s*#")
_MEASURED = r"<!-- measured: {} \S+ \S+ -->\n.*?<!-- end -->"
_NUMBER = re.compile(r"[\s`*(<>≤≥~±+−–-]*\d")


@dataclass(frozen=True)
class Table:
    """A table in a page, the line where it begins, and the mark that holds for it, if any.

    `kind` is `measured`, `generated`, `source`, or empty; `text` is what the mark says.
    """

    page: Path
    line: int
    kind: str
    text: str


def root() -> Path:
    """The working folder, which must be the root of a clone; raises SourceError."""
    if not Path("README.md").is_file() or not Path("docs/index.md").is_file():
        raise SourceError("", "the working folder is not a clone of dlgmd", "Change to its root.")
    return Path.cwd()


def pages(at: Path) -> list[Path]:
    """README.md, and all pages below docs/ but those that Sphinx has made."""
    found = sorted((at / "docs").rglob("*.md"))
    return [at / "README.md", *(page for page in found if "_build" not in page.parts)]


def tables_of(page: Path) -> Iterator[Table]:
    """The tables of a page that have numbers, or stand between marks."""
    text = page.read_text(encoding="utf-8")
    for found in _TABLE.finditer(text):
        above = text[: found.start()]
        between = _BETWEEN.search(above)
        if between or is_of_numbers(found[0]):
            mark = between or _ABOVE.search(above) or _OF_PAGE.match(text)
            kind, says = mark.groups() if mark else ("", "")
            yield Table(page, above.count("\n") + 1, kind, says)


def is_of_numbers(table: str) -> bool:
    """Whether more than half of the filled cells, the first column apart, begin with a digit."""
    rows = [re.split(r"(?<!\\)\|", line.strip("| ")) for line in table.splitlines()[2:]]
    cells = [cell.strip() for row in rows for cell in row[1:]]
    filled = [cell for cell in cells if cell not in ("", "–", "none")]
    n_numbers = sum(bool(_NUMBER.match(cell)) for cell in filled)
    return 2 * n_numbers > len(filled)


def unknown_source(table: Table, at: Path, names: Collection[str]) -> str:
    """What is wrong with the source of a table; an empty text if it is known."""
    if table.kind == "generated":
        return ""
    if table.kind == "measured":
        name = table.text.split()[0]
        return "" if name in names else f"nothing measures {name!r}"
    if not table.kind:
        return "no mark says where its numbers come from"
    is_known = table.text.startswith(tuple(SOURCES)) or (at / table.text.split()[0]).is_file()
    return "" if is_known else f"{table.text!r} is not a known source"


@cache
def digest(at: Path) -> str:
    """A digest of `CODE`, without caches."""
    sha = hashlib.sha256()
    for name in CODE:
        place = at / name
        for path in [place] if place.is_file() else sorted(place.rglob("*")):
            if path.suffix in (".py", ".yaml"):
                sha.update(path.read_bytes())
    return sha.hexdigest()[:8]


def version(at: Path) -> str:
    """The version of this checkout, with its commit if Git knows it."""
    command = ["git", "rev-parse", "--short", "HEAD"]
    done = subprocess.run(command, check=False, capture_output=True, text=True, cwd=at)
    return f"{dlgmd_cli.__version__}+{done.stdout.strip() or 'unknown'}"


def age(table: Table, at: Path) -> str:
    """Whether a measured table is as the code is, and the version that measured it."""
    _, measured_with, of_code = table.text.split()
    is_fresh = of_code == digest(at)
    return f"{measured_with}, {'as the code is' if is_fresh else 'older than the code'}"


def write(name: str, text: str, at: Path) -> Path:
    """Write a measured table into its page, with today's version and digest.

    Raises ResultError if no page has the table.
    """
    pattern = re.compile(_MEASURED.format(re.escape(name)), re.DOTALL)
    head = f"<!-- measured: {name} {version(at)} {digest(at)} -->"
    block = f"{head}\n\n{text}\n\n*Measured with {version(at)}.*\n<!-- end -->"
    for page in pages(at):
        old = page.read_text(encoding="utf-8")
        new, n_found = pattern.subn(lambda _: block, old)
        if n_found:
            page.write_text(new, encoding="utf-8")
            return page
    hint = f"Put <!-- measured: {name} - - --> and <!-- end --> where it belongs."
    raise ResultError("", f"no page has the table {name!r}", hint)
