"""Every relative link of the documents leads somewhere."""

from __future__ import annotations

import re

import pytest

from tests.docs.pages import PAGES, ROOT, anchors, links


@pytest.mark.parametrize("page", [*PAGES, "CHANGELOG.md"])
def test_every_link_leads_to_a_file_and_a_heading(page: str) -> None:
    lost = [f"{page}:{line}: {target}" for line, target in links(page) if not _leads(page, target)]
    assert not lost


def _leads(page: str, target: str) -> bool:
    """Return True if a link's file exists, and its anchor in that file."""
    if target.startswith(("https://", "http://", "mailto:")):
        return True
    name, _, anchor = target.partition("#")
    path = (ROOT / page).parent / name if name else ROOT / page
    if not path.exists():
        return False
    return not anchor or anchor in anchors(path.resolve().relative_to(ROOT).as_posix())


def test_every_page_is_in_the_index() -> None:
    folder = ROOT / "docs"
    linked = {(folder / target.partition("#")[0]).resolve() for _, target in links("docs/index.md")}
    pages = set(folder.rglob("*.md")) - {folder / "index.md"}
    assert not {path.relative_to(ROOT).as_posix() for path in pages - linked}


def test_every_page_that_code_names_exists() -> None:
    folders = ("sabench", "solvers", "generators", "scenes", "examples", "benchmarks", "tests")
    files = [
        ROOT / "pyproject.toml",
        *(file for one in folders for file in (ROOT / one).rglob("*")),
    ]
    named = {
        (file.relative_to(ROOT).as_posix(), page)
        for file in files
        if file.suffix in (".py", ".toml", ".cpp")
        for page in re.findall(r"\bdocs/[\w/-]+\.md", file.read_text(encoding="utf-8"))
    }
    assert named
    assert not {(file, page) for file, page in named if not (ROOT / page).is_file()}
