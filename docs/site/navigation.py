"""Navigation of the site: the sections of docs/index.md with the pages that they link to."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

INDEX = "docs/index"
_LINK = re.compile(r"\[[^\]]*\]\(([^()\s#]+\.(?:md|rst))(?:#[^()\s]*)?\)")


def sections(text: str, folder: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the headings of a page and the pages that each section links to, in their order.

    The page lies in `folder`; pages are named from the root, without their suffix.
    """
    for part in re.split(r"^#+ ", text, flags=re.MULTILINE)[1:]:
        heading, _, body = part.partition("\n")
        targets = (posixpath.join(folder, target) for target in _LINK.findall(body))
        names = [posixpath.normpath(target).rpartition(".")[0] for target in targets]
        if names:
            yield heading.strip(), list(dict.fromkeys(names))


def toctrees(text: str, folder: str) -> str:
    """Write one table of contents for each section; a page stands in the first that names it."""
    seen: set[str] = set()
    parts = []
    for heading, names in sections(text, folder):
        fresh = [name for name in names if name not in seen]
        seen.update(fresh)
        parts += ["```{toctree}", ":hidden:", f":caption: {heading}", ""]
        parts += [f"/{name}" for name in fresh] + ["```", ""]
    return "\n".join(parts)


def add_toctrees(app: Sphinx, name: str, source: list[str]) -> None:
    """Add the tables of contents to the first page."""
    if name == app.config.root_doc:
        index = app.srcdir / f"{INDEX}.md"
        own = f"```{{toctree}}\n:hidden:\n\n/{INDEX}\n```\n"
        trees = toctrees(index.read_text(encoding="utf-8"), posixpath.dirname(INDEX))
        source[0] += f"\n\n{own}\n{trees}"
