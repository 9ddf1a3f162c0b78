"""Sphinx configuration of the documentation site: make docs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(Path(__file__).parent), str(ROOT)]

import access  # noqa: E402
import docstrings  # noqa: E402
import navigation  # noqa: E402
import notebooks  # noqa: E402
import tables  # noqa: E402

import sabench  # noqa: E402
from reproduction import page  # noqa: E402

if TYPE_CHECKING:
    from sphinx.application import Sphinx

project = "sabench"
author = "sabench contributors"
release = version = sabench.__version__
html_title = f"sabench {release}"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "README"
include_patterns = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/**"]
exclude_patterns = ["docs/site"]
default_role = "literal"  # docstrings name code in single backquotes
myst_heading_anchors = 4  # the anchors of GitHub
napoleon_use_ivar = True  # else attributes are described twice
autodoc_typehints = "description"
autodoc_member_order = "groupwise"
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_search_summary = False  # a browser may not read other pages opened as files
html_show_sphinx = False
html_additional_pages = {"index": "redirect.html"}  # to README.html, the first page
templates_path = ["templates"]


def setup(app: Sphinx) -> None:
    """Make tables and navigation, read docstrings, and complete pages."""
    app.connect("source-read", tables.add_tables)
    app.connect("source-read", navigation.add_toctrees)
    app.connect("source-read", page.add_results)
    app.connect("source-read", notebooks.add_outputs)
    app.connect("autodoc-process-docstring", docstrings.describe_names, priority=100)
    app.connect("autodoc-skip-member", docstrings.skip_aliases)
    app.connect("build-finished", access.complete_all)
