"""Sphinx's configuration: `sphinx-build -W --keep-going -n docs docs/_build/html`."""

import inspect
import re
import shutil
from importlib.metadata import metadata
from pathlib import Path
from typing import Any

import click
from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

import dlgmd_cli
from dlgmd_cli.commands.app import COMMANDS, HIDDEN, cli

HERE = Path(__file__).parent

project = "dlgmd"
author = "The dlgmd developers"
copyright = f"2026, {author}"
version = release = dlgmd_cli.__version__

extensions = [
    "myst_nb",  # pages in Markdown, and notebooks
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_click",
    "sphinx_copybutton",
]
exclude_patterns = ["_build"]
templates_path = ["_templates"]

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
# Notebooks are shown as they are kept; the slow tests run them, and compare what they show.
nb_execution_mode = "off"

# Sphinx reads only files below its folder. A copy follows its notebook.
notebooks = HERE / "notebooks"
notebooks.mkdir(exist_ok=True)
for stale in notebooks.glob("*.ipynb"):
    stale.unlink()
for notebook in (HERE.parent / "sample_videos").glob("*.ipynb"):
    shutil.copy2(notebook, notebooks)

# A page for each command.
COMMAND = """.. click:: {home}:{name}
   :prog: dlgmd {name}
   :nested: full
"""
commands = HERE / "commands"
commands.mkdir(exist_ok=True)
for name in (*COMMANDS, *HIDDEN):
    home = "dlgmd_cli.lab.commands" if name == "lab" else f"dlgmd_cli.commands.{name}"
    page = COMMAND.format(name=name, home=home)
    (commands / f"{name}.rst").write_text(page, encoding="utf-8")

# The docstrings state types and shapes.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
# Beside `layers`, where file names know no capital letters.
autosummary_filename_map = {"dlgmd_cli.Layers": "dlgmd_cli.Layers-class"}
# A name in backquotes is a link if it is public, else code.
default_role = "py:obj"

smartquotes = False
# What the signature of a class without a public parameter class names.
nitpick_ignore_regex = [("py:class", r"dlgmd_cli\.parameters\..*")]

# From `[project.urls]` in pyproject.toml; without `Source`, pages have no link to edit them.
addresses = dict(one.split(", ") for one in metadata(project).get_all("Project-URL") or ())
html_theme = "furo"
html_theme_options = {
    "source_repository": addresses.get("Source", ""),
    "source_branch": "main",
    "source_directory": "docs/",
}
html_title = f"dlgmd {version}"
html_static_path = ["_static"]
html_favicon = "_static/favicon.svg"
html_search_scorer = str(HERE / "_static" / "scorer.js")
html_math_renderer = "mathml"
html_css_files = ["dlgmd.css"]
html_show_sourcelink = False
html_show_sphinx = False
copybutton_exclude = ".linenos, .gp, .go"


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


def _no_markup(line: str) -> str:
    """Patterns in the help of commands are no emphasis, and addresses no links."""
    return line.replace("*", r"\*").replace("://", r"\://")


def _with_examples(app: Any, ctx: Any, lines: list[str]) -> None:
    """The text of a command's help; each of its examples is a block of code below its comment."""
    text: list[str] = []
    for line in lines:
        if line.startswith("|   "):
            command, _, comment = line[1:].strip().partition("  # ")
            text += [f"{comment[0].upper()}{comment[1:]}:", ""] if comment else []
            text += [".. code-block:: sh", "", f"   {command.strip()}", ""]
        else:
            text += [""] if line == "| Examples:" else [_no_markup(line)]
    lines[:] = text


def _in_sections(app: Any, ctx: click.Context, lines: list[str]) -> None:
    """The options of a command, in the sections of its help."""
    below = click.Context(ctx.command, info_name=ctx.info_name, parent=click.Context(cli))
    for title, records in ctx.command.sections(below).items():
        lines += [title, "~" * len(title), ""]
        for names, text in records:
            lines += [f".. option:: {names}", "", f"   {_no_markup(text)}", ""]


def _option_texts(command: str) -> dict[str, str]:
    """The options of a command -> their help, with the form of a text such as WxH+X+Y."""
    found = cli.get_command(click.Context(cli), command)
    texts = {}
    for one in () if found is None else found.params:
        form = f" As ``{one.metavar}``." if re.search("[a-z]", one.metavar or "") else ""
        if isinstance(one, click.Option) and one.help:
            texts[one.name] = one.help + form
    return texts


def _spell_options(app: Any, what: str, name: str, of: Any, how: Any, lines: list[str]) -> None:
    """The arguments below `options`, each with its type and the text that a command has for it."""
    if what != "function" or "options" not in lines or "Parameters" not in lines:
        return
    end = lines.index("", lines.index("options"))
    own = {entry.strip() for line in lines[:end] for entry in line.partition(" : ")[0].split(",")}
    texts = _option_texts("run") | _option_texts("live") | _option_texts(name.rpartition(".")[2])
    for one in inspect.signature(of).parameters.values():
        if one.name not in own and one.kind is one.KEYWORD_ONLY and one.name in texts:
            types = re.sub(r"(\w+\.)+", "", inspect.formatannotation(one.annotation)).strip("'")
            words = types.replace(" | None", "").replace(" | ", " or ")
            meaning = re.sub(r"--([a-z-]+)", lambda f: f[1].replace("-", "_"), texts[one.name])
            lines[end:end] = [f"{one.name} : {words}, optional", f"    {_no_markup(meaning)}"]
            end += 2


def _short_defaults(
    app: Any, what: str, name: str, of: Any, how: Any, given: str | None, back: Any
) -> Any:
    """A signature with the bare name of a function or a class that is a default."""
    default = r"<(?:function|class) '?(?:\w+\.)*(\w+)[^>]*>"
    return given and re.sub(default, r"\1", given), back


def _for_the_site(app: Any, name: str, source: list[str]) -> None:
    """What differs from the pages as the repository shows them."""
    if name == "changelog":
        source[0] = (HERE.parent / "CHANGELOG.md").read_text(encoding="utf-8")
        source[0] = source[0].replace("](docs/", "](")
    source[0] = re.sub(r"\]\(\.\./sample_videos/(?=\w+\.ipynb)", "](notebooks/", source[0])
    if name == "index":  # the sidebar has the pages that each section links to
        source[0] = re.sub(r"^## (.+)\n(?:(?!## ).*\n)+", _with_toctree, source[0], flags=re.M)


def _with_toctree(section: re.Match) -> str:
    pages = re.findall(r"\]\(([\w/-]+)\.(?:md|rst|ipynb)\)", section[0])
    entries = "\n".join(dict.fromkeys(pages))
    return f"{section[0]}\n```{{toctree}}\n:caption: {section[1]}\n:hidden:\n\n{entries}\n```\n"


def setup(app: Any) -> None:
    """Add these hooks to Sphinx."""
    # Browsers show MathML by themselves: no script from elsewhere is loaded.
    app.add_html_math_renderer("mathml", (_inline_math, None), (_block_math, None))
    app.connect("missing-reference", _as_code)
    app.connect("source-read", _for_the_site)
    app.connect("autodoc-process-docstring", _spell_options, priority=100)
    app.connect("autodoc-process-signature", _short_defaults)
    app.connect("sphinx-click-process-description", _with_examples)
    for part in ("options", "arguments"):  # the sections and the usage have these
        app.connect(f"sphinx-click-process-{part}", lambda app, ctx, lines: lines.clear())
    app.connect("sphinx-click-process-epilog", _in_sections)
