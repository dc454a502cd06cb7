"""Sphinx's configuration: `sphinx-build -W --keep-going -n docs docs/_build/html`."""

import shutil
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import dlgmd_cli  # noqa: E402

project = "dlgmd"
author = "The dlgmd developers"
copyright = f"2026, {author}"
version = release = dlgmd_cli.__version__

extensions = [
    "myst_nb",  # pages in Markdown, and notebooks
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx_click",
    "sphinx_copybutton",
    "generated",  # in this folder
]
(HERE / "_build/made/pages").mkdir(parents=True, exist_ok=True)
exclude_patterns = ["_build"]

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

# The docstrings state types and shapes.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
# A name in backquotes is a link if it is public, else code.
default_role = "py:obj"

smartquotes = False
# What the signature of a class without a public parameter class names.
nitpick_ignore_regex = [("py:class", r"dlgmd_cli\.parameters\..*")]

html_theme = "furo"
html_title = f"dlgmd {version}"
html_static_path = ["_static"]
html_math_renderer = "mathml"
# Pages of 'dlgmd view', made by a command in a page.
html_extra_path = ["_build/made/pages"]
html_css_files = ["dlgmd.css"]
html_show_sourcelink = False
html_show_sphinx = False
copybutton_exclude = ".linenos, .gp, .go"
