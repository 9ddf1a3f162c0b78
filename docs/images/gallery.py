"""Draw the pictures of the gallery by the code of its cards.

Run python docs/images/gallery.py [NAME ...]. A card is a picture and the block of Python below it;
blocks run in the order of the page. The picture is the figure of a block, or the page that it saves.
"""

import base64
import contextlib
import io
import re
import sys
import tempfile
from pathlib import Path

import matplotlib
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "docs" / "site")]

import notebooks  # noqa: E402

from tests.helpers.browser import chromium  # noqa: E402

_PAGE = ROOT / "docs" / "reference" / "gallery.md"
_CARD = re.compile(r"!\[[^\]]*\]\(([^)]*)\)\n\n```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_STYLE = {"figure.figsize": (5.0, 4.0), "savefig.dpi": 144, "figure.constrained_layout.use": True}


def photograph(page: Path) -> bytes:
    """Take a picture of the drawing in space of a page, in a browser."""
    with chromium() as browser:
        assert browser is not None, "expected chromium and chromedriver"
        browser.open(page.resolve(), width=720)
        shot = browser.devtools("Page.captureScreenshot", format="png")
        return base64.b64decode(shot["data"])


def main(*names: str) -> None:
    """Run the cards in an empty folder, and write the pictures of those named, or all."""
    cards = _CARD.findall(Path(names[0]).read_text() if names and names[0].endswith(".md") else _PAGE.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for (picture, code), outputs in zip(cards, notebooks.run([c for _, c in cards]), strict=True):
            shown = [one["data"]["image/png"] for one in outputs if "image/png" in one.get("data", {})]
            png = base64.b64decode(shown[-1]) if shown else photograph(next(Path().rglob("*.html")))
            Image.open(io.BytesIO(png)).convert("RGB").save((_PAGE.parent / picture).resolve(), quality=75, method=6)
            print(picture, flush=True)


if __name__ == "__main__":
    matplotlib.use("Agg")
    matplotlib.rcParams |= _STYLE
    main(*sys.argv[1:])
