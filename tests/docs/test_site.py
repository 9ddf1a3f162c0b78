"""The documentation site: its navigation, its docstrings, and the check of its links."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

from tests.docs.pages import ROOT, read


def script(name: str) -> dict[str, Any]:
    """Return the names of a module of the site."""
    return runpy.run_path(str(ROOT / "docs" / "site" / f"{name}.py"))


def test_the_navigation_has_every_page_of_the_documentation() -> None:
    sections = list(script("navigation")["sections"](read("docs/index.md"), "docs"))
    assert [heading for heading, _ in sections][:2] == ["Start", "Reference"]
    found = {name for _, names in sections for name in names}
    pages = {path.relative_to(ROOT) for path in (ROOT / "docs").rglob("*.md")}
    assert {path.with_suffix("").as_posix() for path in pages} - {"docs/index"} <= found
    assert {"CONTRIBUTING", "docs/reference/api"} <= found


def test_a_page_stands_in_the_first_section_that_links_to_it() -> None:
    text = "# Top\n## One\n[a](a.md), [b](../b.md#x)\n## Two\n[c](sub/c.md#y) [a](a.md)\n## None\n"
    trees = script("navigation")["toctrees"](text, "docs")
    assert trees.count("/docs/a\n") == 1
    assert trees.index("/docs/a") < trees.index("caption: Two") < trees.index("/docs/sub/c")
    assert "caption: None" not in trees


def test_meanings_move_below_the_names_of_parameters() -> None:
    lines = ["Do it.", "", "Parameters", "----------", "a, b : two of them.", "", "x : y"]
    assert script("docstrings")["rewritten"](lines) == [
        *lines[:4], "a", "    See `b`.", "b", "    two of them.", "", "x", "    y"
    ]  # fmt: skip
    assert script("docstrings")["rewritten"](["x : y"]) == ["x : y"]


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A site of two pages without faults."""
    (tmp_path / "one.html").write_text(
        '<h1 id="top-of-it">One</h1><a href="two.html#there">two</a><img src="a%20b.png">'
        '<a href="https://example.org">elsewhere</a><a href="#top-of-it">up</a>'
    )
    (tmp_path / "two.html").write_text('<p id="there">Two</p><a href="one.html">one</a>')
    (tmp_path / "a b.png").write_bytes(b"")
    return tmp_path


def test_a_good_site_has_no_faults(site: Path) -> None:
    assert not list(script("check")["faults"](site))


@pytest.mark.parametrize(
    ("tag", "fault"),
    [
        ('<a href="three.html">', "three.html: expected an existing file"),
        ('<a href="two.html#nowhere">', "two.html#nowhere: expected an existing heading"),
        ('<script src="https://a.org/a.js">', "https://a.org/a.js: expected a file of the site"),
        ('<link href="//a.org/a.css">', "//a.org/a.css: expected a file of the site"),
    ],
)
def test_a_bad_reference_is_found(site: Path, tag: str, fault: str) -> None:
    (site / "bad.html").write_text(tag)
    assert list(script("check")["faults"](site)) == [f"bad.html: {fault}"]


def test_a_font_from_the_network_is_found(site: Path) -> None:
    (site / "a.css").write_text("@font-face { src: url('https://a.org/font.woff2') }")
    assert len(list(script("check")["faults"](site))) == 1


def test_what_scrolls_takes_the_focus_and_headings_have_a_level() -> None:
    page = '<p class="caption" role="heading"><pre>x</pre><p><img src="a.png"></p><p>b</p>'
    done = script("access")["complete"](page)
    assert done == (
        '<p class="caption" role="heading" aria-level="2"><pre tabindex="0">x</pre>'
        '<p tabindex="0"><img src="a.png"></p><p>b</p>'
    )
    assert script("access")["complete"](done) == done
