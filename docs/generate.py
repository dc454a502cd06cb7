"""Write what is generated into the pages: tables of names, what commands print, and pictures.

Usage: generate.py [--check]. With --check, nothing is written: stale pages are named, exit code 1.
Comments mark a table (`generated: parameters dlgmd`), a file that commands need (`file: my.yaml`),
and, after a block `sh`, what its commands print (`printed`) or draw (`made: out/mp.png`). Blocks
without a mark are not run.
"""

import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import tables
from PIL import Image

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("*/*.md"), *ROOT.glob("docs/lab/**/*.md")])
MARKED = re.compile(
    r"^<!-- generated: (?P<table>[^\n]+) -->\n.*?^<!-- end -->$"
    r"|^<!-- file: (?P<file>\S+) -->\n```\w*\n(?P<content>.*?)^```$"
    r"|^```sh\n(?P<commands>[^`]+)^```\n\n(?=<!-- (?:printed|made: \S+) -->)"
    r"|^<!-- (?P<printed>printed) -->\n.*?^<!-- end -->$"
    r"|^<!-- made: (?P<made>\S+) -->\n+!\[[^\]]*\]\((?P<picture>\S+)\)$",
    re.DOTALL | re.MULTILINE,
)
MAX_WIDTH_PX, MAX_BYTES = 960, 80_000
_TIMEOUT_S = 600


def _run(commands: str, folder: Path) -> str:
    """What commands print, without machine paths; of a line that installs first, its last one."""
    printed = ""
    for line in re.sub(r"\\\n *", "", commands).splitlines():
        command = shlex.split(line.split(" && ")[-1], comments=True)
        words = [sys.executable, "-m", "dlgmd_cli", *command[1:]]
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=_TIMEOUT_S)
        if done.returncode:
            raise SystemExit(f"{line}: exit code {done.returncode}\n{done.stderr}")
        printed += done.stdout.replace(f"{folder}/", "")
    return "\n".join(line.rstrip() for line in printed.splitlines()).strip("\n")


def _save_picture(made: Path, path: Path) -> None:
    """Save a picture in 160 colours, narrower until it is small."""
    path.parent.mkdir(exist_ok=True)
    picture, width = Image.open(made).convert("RGB"), MAX_WIDTH_PX
    while True:
        picture.thumbnail((width, picture.height), Image.Resampling.LANCZOS)
        coded = io.BytesIO()
        picture.quantize(160, kmeans=2).save(coded, "PNG", optimize=True)
        if coded.tell() <= MAX_BYTES:
            return path.write_bytes(coded.getvalue())
        width = int(0.9 * width)


def renewed(page: Path, *, tables_only: bool = False, pictures: bool = False) -> str:
    """The text of a page as it should be; with `pictures`, they are saved, else they must exist."""
    with tempfile.TemporaryDirectory() as name:
        folder, printed = Path(name).resolve(), ""
        if not tables_only:
            shutil.copytree(ROOT / "sample_videos", folder / "sample_videos")

        def renew(found: re.Match) -> str:
            nonlocal printed
            if found["table"]:
                kind, *arguments = found["table"].split()
                table = tables.TABLES[kind](*arguments)
                return f"<!-- generated: {found['table']} -->\n\n{table}\n\n<!-- end -->"
            if tables_only:
                return found[0]
            if found["file"]:
                (folder / found["file"]).write_text(found["content"], encoding="utf-8")
            elif found["commands"]:
                printed = _run(found["commands"], folder)
            elif found["printed"]:
                return f"<!-- printed -->\n```text\n{printed}\n```\n<!-- end -->"
            elif pictures:
                _save_picture(folder / found["made"], page.parent / found["picture"])
            elif not (page.parent / found["picture"]).exists():
                raise SystemExit(f"{page}: no {found['picture']}")
            return found[0]

        return MARKED.sub(renew, page.read_text(encoding="utf-8"))


def coarse(text: str) -> str:
    """Text whose numbers have three digits: versions of libraries differ in later ones."""
    return re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.3g}", text)


def main() -> None:
    """Rewrite or check all pages."""
    check, stale = sys.argv[1:] == ["--check"], []

    def renew(page: Path) -> str:
        # What is only drawn is not compared: the tests run its commands, Sphinx looks for pictures.
        is_compared = not check or "<!-- printed -->" in page.read_text(encoding="utf-8")
        return renewed(page, tables_only=not is_compared, pictures=not check)

    with ThreadPoolExecutor(os.cpu_count()) as pool:  # a page at a time each, in its own folder
        for page, new in zip(PAGES, pool.map(renew, PAGES), strict=True):
            old = page.read_text(encoding="utf-8")
            if check and coarse(old) != coarse(new):
                stale.append(page.relative_to(ROOT).as_posix())
            elif not check and old != new:
                page.write_text(new, encoding="utf-8")
    if stale:
        raise SystemExit(f"Stale: {', '.join(stale)}. Run: python docs/generate.py")


if __name__ == "__main__":
    main()
