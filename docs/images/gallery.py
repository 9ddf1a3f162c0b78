"""Draw the pictures of the gallery by the code of its cards: python docs/images/gallery.py.

A card is a picture and the block of Python below it; blocks run in the order of the page. The
picture is the figure of a block, or the drawing in space of the page that it saves.
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
_STYLE = {
    "figure.figsize": (5.0, 4.0),
    "savefig.dpi": 144,
    "savefig.bbox": "tight",
    "figure.constrained_layout.use": True,
}


def photograph(page: Path) -> bytes:
    """Take a picture of the drawing in space of a page, in a browser."""
    with chromium() as browser:
        assert browser is not None, "expected chromium and chromedriver"
        browser.open(page.resolve(), width=720)
        browser.wait("document.querySelector('main canvas')")
        own = "document.querySelector('main canvas').getBoundingClientRect()"
        clip = {key: browser.ask(f"{own}.{key}") for key in ("x", "y", "width", "height")}
        clip |= {"scale": 1}
        shot = browser.devtools("Page.captureScreenshot", format="png", clip=clip)
        return base64.b64decode(shot["data"])


def main() -> None:
    """Run the cards in an empty folder, and write their pictures."""
    cards = _CARD.findall(_PAGE.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        runs = notebooks.run([code for _, code in cards])
        for (picture, _), outputs in zip(cards, runs, strict=True):
            figures = [one for one in outputs if one["output_type"] == "display_data"]
            shown = figures[0]["data"]["image/png"] if figures else None
            png = base64.b64decode(shown) if shown else photograph(next(Path().rglob("*.html")))
            image = Image.open(io.BytesIO(png)).convert("RGB")
            image.save((_PAGE.parent / picture).resolve(), quality=75, method=6)
            print(picture, flush=True)


if __name__ == "__main__":
    matplotlib.use("Agg")
    matplotlib.rcParams |= _STYLE
    main()
