"""Sphinx's settings: the pages are Markdown (MyST), the API pages are made from numpydoc docstrings."""

import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(Path(__file__).parent / "extensions")]

project = "fringebench"
release = version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_copybutton",
    "scene_reference",
    "api_reference",
]

# Every link is checked but two kinds in annotations: other projects' classes, because nothing is fetched to look them
# up, and classes inside a room that its face does not export.
nitpicky = True
nitpick_ignore_regex = [
    ("py:.*", r"(?!(scenes|render|decode|evaluation|fringebench)\.).*"),
    ("py:.*", r"\w+\.\w+\..*"),
]

myst_enable_extensions = ["attrs_inline", "attrs_block"]
myst_heading_anchors = 3
# The text of a link to a heading is always written out.
suppress_warnings = ["myst.xref_ambiguous"]

autosummary_generate = False
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_class_signature = "mixed"
numpydoc_show_class_members = False
# Single backticks in a docstring are names and short formulas.
default_role = "code"
# Console examples are copied without prompt and output.
copybutton_prompt_text = "$ "
copybutton_line_continuation_character = "\\"

toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = "fringebench"
html_static_path = ["static"]
html_css_files = ["extra.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False
