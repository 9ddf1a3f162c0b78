"""Completion of built pages for keyboards and screen readers.

Parts that scroll sideways take the focus, so that arrow keys move them; headings of the navigation
have a level, and its parts have names.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_MISSING = {
    '<p class="caption" role="heading">': '<p class="caption" role="heading" aria-level="2">',
    '<aside class="sidebar-drawer">': '<aside class="sidebar-drawer" aria-label="All pages">',
    '<aside class="toc-drawer': '<aside aria-label="This page" class="toc-drawer',
    "<pre>": '<pre tabindex="0">',
    '<div class="table-wrapper': '<div tabindex="0" class="table-wrapper',
    '<th class="head"><p></p></th>': '<td class="head"></td>',
}
_FIGURE = re.compile(r"<p>(<img [^>]*>)</p>")


def complete(page: str) -> str:
    """Put into a page's HTML what it lacks."""
    for lacking, whole in _MISSING.items():
        page = page.replace(lacking, whole)
    return _FIGURE.sub(r'<p tabindex="0">\1</p>', page)


def complete_all(app: Sphinx, error: Exception | None) -> None:
    """Complete all pages of a built site."""
    for path in sorted(Path(app.outdir).rglob("*.html")) if error is None else ():
        path.write_text(complete(path.read_text(encoding="utf-8")), encoding="utf-8")
