"""Check the built site: every link leads somewhere, and nothing is loaded from the network.

Run python docs/site/check.py build/site. Where there is a Chromium, axe-core looks at every page,
too, wide and light, or narrow and dark in turn.
"""

import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

sys.path.append(str(Path(__file__).resolve().parents[2]))
from tests.helpers.browser import chromium

_GRAVE = ("critical", "serious")
_LOADING = {"script", "img", "link", "source", "iframe", "video", "audio"}  # tags that load files


class Reference(NamedTuple):
    """A link or a file that a page loads."""

    tag: str
    target: str


class _Page(HTMLParser):
    """References and anchors of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.references: list[Reference] = []
        self.anchors: set[str] = {"", "top"}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.anchors |= {given[key] or "" for key in ("id", "name") if key in given}
        self.references += [
            Reference(tag, given[key] or "") for key in ("href", "src") if key in given
        ]


def read(path: Path) -> _Page:
    """Parse a page."""
    page = _Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def faults(site: Path) -> Iterator[str]:
    """Yield a sentence for each link that leads nowhere and each file from the network."""
    pages = {path.resolve(): read(path) for path in sorted(site.rglob("*.html"))}
    for path, page in pages.items():
        name = path.relative_to(site.resolve())
        for reference in page.references:
            fault = _fault(path, reference, pages)
            if fault:
                yield f"{name}: {reference.target}: {fault}"
    for path in sorted(site.rglob("*.css")):
        for target in re.findall(r"url\(['\"]?((?:https?:)?//[^)]*)", path.read_text("utf-8")):
            yield f"{path.relative_to(site)}: {target}: expected a file of the site"


def _fault(path: Path, reference: Reference, pages: dict[Path, _Page]) -> str:
    """Say what is wrong with a reference of a page; empty if nothing is."""
    parts = urlsplit(reference.target)
    if parts.scheme == "data" or parts.scheme == "mailto":
        return ""
    if parts.scheme or parts.netloc:
        return "expected a file of the site" if reference.tag in _LOADING else ""
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if not target.is_file():
        return "expected an existing file"
    if target in pages and unquote(parts.fragment) not in pages[target].anchors:
        return "expected an existing heading"
    return ""


def hurdles(site: Path) -> Iterator[str]:
    """Yield what keeps keyboards and screen readers out of pages: axe-core's findings."""
    with chromium() as browser:
        if browser is None:
            print(f"{site}: expected chromium and chromedriver to ask axe-core; there are none")
            return
        for number, path in enumerate(_lasting(site.resolve())):
            width, mode = ((1400, "light"), (390, "dark"))[number % 2]
            browser.prefer(mode)
            browser.open(path, width=width)
            for one in browser.violations():
                if one.startswith(_GRAVE):
                    yield f"{path.relative_to(site.resolve())} ({width} px, {mode}): {one}"


def _lasting(site: Path) -> list[Path]:
    """List the pages that do not lead on to another one at once."""
    pages = sorted(site.rglob("*.html"))
    return [path for path in pages if 'http-equiv="refresh"' not in path.read_text("utf-8")]


def main(site: str) -> int:
    """Print all faults; returns the exit code."""
    found = [*faults(Path(site)), *hurdles(Path(site))]
    print("\n".join(found) or f"{site}: all links lead somewhere, nothing is from the network")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
