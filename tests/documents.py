"""What stands in the documents: their code blocks, commands, tables and links."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = ["README.md", "configs/README.md", "sample_videos/README.md"]
_DOCS = sorted([*(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "lab").rglob("*.md")])
PAGES += [path.relative_to(ROOT).as_posix() for path in _DOCS]


def text_of(page):
    """A page."""
    return (ROOT / page).read_text(encoding="utf-8")


def blocks(page):
    """The code blocks of a page: kind, name of a file or an empty text, and content."""
    block = r"^(?:<!-- file: (\S+) -->\n)?```(\S+)\n(.*?)^```$"
    for name, kind, content in re.findall(block, text_of(page), re.DOTALL | re.MULTILINE):
        yield kind, name, content


def code_of(page, file):
    """The content of a file that a page shows."""
    return next(content for _, name, content in blocks(page) if name == file)


def commands(page, *kinds):
    """The dlgmd commands in the blocks of these kinds, as lines, and the file that each fills."""
    for kind, name, content in blocks(page):
        yield from commands_in(content if kind in kinds and not name else "")


def commands_in(content):
    """The dlgmd commands in a block, as lines, and the file that each fills."""
    for line in re.sub(r"\\\n *", "", content).splitlines():
        words = shlex.split(line.split(" && ")[-1], comments=True)
        if words[:1] in (["dlgmd"], [".venv/bin/dlgmd"]):
            command, _, target = shlex.join(["dlgmd", *words[1:]]).partition(" '>' ")
            yield command, target


def section_of(page, heading):
    """What stands below a heading, up to the next."""
    (section,) = re.findall(
        rf"^#+ {re.escape(heading)}\n(.*?)(?=^#|\Z)", text_of(page), re.DOTALL | re.MULTILINE
    )
    return section


def table_below(page, heading):
    """The rows of the first tables in a section, as their cells without backquotes."""
    lines = section_of(page, heading).splitlines()
    rows = [line.strip("|").split("|") for line in lines if line.startswith("|")]
    return [[cell.strip() for cell in row] for row in rows if not set(row[0]) <= {"-", " "}]


def names_in(cell):
    """The names in backquotes."""
    return re.findall(r"`([^`]+)`", cell)
