"""What the pages take from the code: tables, output and figures of commands, and MathML.

Every figure and every output of a command is made while the pages are built, and every table of
names is read from the code, so that none can be out of date. A command that fails is a warning, and
with `-W` an error.
"""

import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util.docutils import SphinxDirective
from tables import TABLES

ROOT = Path(__file__).parents[1]
# Where commands run: a folder for each page, with the sample videos in it.
MADE = Path(__file__).with_name("_build") / "made"
# Pages of 'dlgmd view', which go into the root of the built site.
PAGES = MADE / "pages"
_TIMEOUT_S = 120


class Generated(SphinxDirective):
    """A table from the code: ``{generated} parameters dlgmd``."""

    required_arguments, optional_arguments = 1, 1

    def run(self) -> list[nodes.Node]:
        """Parse the table where it stands."""
        name, *arguments = self.arguments
        return self.parse_text_to_nodes(TABLES[name](*arguments))


class _InFolder(SphinxDirective):
    """A directive that works in the folder of its page."""

    has_content = True

    @property
    def folder(self) -> Path:
        """The folder, fresh and with the sample videos at the page's first directive."""
        folder = MADE / self.env.docname
        if not self.env.temp_data.get("dlgmd_folder"):
            self.env.temp_data["dlgmd_folder"] = True
            shutil.rmtree(folder, ignore_errors=True)
            keep = shutil.ignore_patterns("*.png", "*.ipynb", "*.md")
            shutil.copytree(ROOT / "sample_videos", folder / "sample_videos", ignore=keep)
        return folder

    def block(self, text: str, language: str) -> nodes.literal_block:
        """Text as it is."""
        return nodes.literal_block(text, text, language=language)


class File(_InFolder):
    """A file that the commands of the page need: ``{file} my.yaml``."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Write the file, and show it with its name."""
        name, text = self.arguments[0], "\n".join(self.content)
        (self.folder / name).write_text(f"{text}\n", encoding="utf-8")
        caption = nodes.caption(name, name)
        language = Path(name).suffix.lstrip(".")
        block = self.block(text, {"csv": "text", "service": "ini"}.get(language, language))
        return [nodes.container("", caption, block, literal_block=True, classes=["file"])]


class Made(_InFolder):
    """Commands, and the figures or the page that they make; else, or with `:print:`, the output."""

    optional_arguments = 3
    option_spec: ClassVar[dict[str, Any]] = {
        "alt": directives.unchanged_required,
        "print": directives.flag,
    }

    def run(self) -> list[nodes.Node]:
        """Run the commands."""
        folder = self.folder
        printed = "".join(self._output(line, folder) for line in self.content)
        printed = "\n".join(line.rstrip() for line in printed.splitlines()).strip("\n")
        found: list[nodes.Node] = [self.block("\n".join(self.content), "sh")]
        if "print" in self.options or not self.arguments:
            found.append(self.block(printed, "text"))
        return found + [self._shown(folder / name) for name in self.arguments]

    def _shown(self, made: Path) -> nodes.Node:
        """A figure, a film, or a link to a page."""
        if made.suffix == ".mp4":
            PAGES.mkdir(exist_ok=True)
            shutil.copy(made, PAGES)
            film = f'<video controls preload="metadata" width="100%" src="{made.name}"></video>'
            return nodes.raw("", film, format="html")
        if made.suffix != ".html":
            uri = f"/{made.relative_to(self.env.srcdir).as_posix()}"
            return nodes.image(uri=uri, alt=self.options["alt"])
        PAGES.mkdir(exist_ok=True)
        shutil.copy(made, PAGES)
        linked = made.with_name(f"{made.stem}-pages")
        if linked.is_dir():
            shutil.copytree(linked, PAGES / linked.name, dirs_exist_ok=True)
        link = nodes.reference("", self.options["alt"], refuri=made.name)
        return nodes.paragraph("", "", link)

    def _output(self, line: str, folder: Path) -> str:
        """What a command prints."""
        words = [sys.executable, "-m", "dlgmd_cli", *shlex.split(line)[1:]]
        done = subprocess.run(
            words, cwd=folder, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False
        )
        if done.returncode:
            raise self.error(f"{line}: exit code {done.returncode}\n{done.stderr}")
        return done.stdout


def _inline_math(writer: Any, node: nodes.Element) -> None:
    writer.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def _block_math(writer: Any, node: nodes.Element) -> None:
    """An equation, with its number in the margin."""
    text, tag, number = node.astext().partition(r"\tag{")
    margin = f"<span>({number.rstrip(' }')})</span>" if tag else ""
    made = tex2mathml(text.strip()).replace("<math ", '<math display="block" ', 1)
    writer.body.append(f'<div class="math">{made}{margin}</div>\n')
    raise nodes.SkipNode


def _as_code(app: Any, env: Any, node: nodes.Element, content: nodes.Element) -> Any:
    """A name in backquotes that is not a public one."""
    return content if node.get("reftype") == "obj" else None


def _no_markup(app: Any, ctx: Any, lines: list[str]) -> None:
    """Patterns in the help of commands are no emphasis, and addresses no links."""
    lines[:] = [line.replace("*", r"\*").replace("://", r"\://") for line in lines]


def _notebooks_here(app: Any, name: str, source: list[str]) -> None:
    """Links to notebooks lead to their pages, see conf.py."""
    source[0] = source[0].replace("](../sample_videos/", "](notebooks/")


def setup(app: Any) -> dict[str, bool]:
    """Add all of these to Sphinx."""
    app.add_directive("generated", Generated)
    app.add_directive("file", File)
    app.add_directive("made", Made)
    # Browsers show MathML by themselves: no script from elsewhere is loaded.
    app.add_html_math_renderer("mathml", (_inline_math, None), (_block_math, None))
    app.connect("missing-reference", _as_code)
    app.connect("source-read", _notebooks_here)
    for part in ("description", "options", "epilog"):
        app.connect(f"sphinx-click-process-{part}", _no_markup)
    return {"parallel_read_safe": False, "parallel_write_safe": True}
