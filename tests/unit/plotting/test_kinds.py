"""Found, missed, ghost and duplicate have one colour each on all pages, figures and exports."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

import sabench
from sabench.interop.export import write_state
from sabench.plotting.drawing import Circles, Figure, Panel, draw
from sabench.plotting.kinds import COLOURS, DEFINITION, rgb
from sabench.plotting.pictures import class_slice
from tests.architecture.plan import ROOT

HOME = "sabench/plotting/kinds.py"
SHOWS = ("sabench", "solvers", "leaderboard/page", "docs", "examples", "templates")
TEXTS = {".py", ".js", ".css", ".j2", ".ipynb", ".html"}
# a kind's name, then at once a colour: ghost: "#f00", --ghost: rgb(, GHOSTS = (0.0, MISSED: [1
OWN = re.compile(
    r"\b_?(found|missed|ghosts?|duplicates?)(_colou?r)?[\"']?(: \w+)?\s*[:=]\s*"
    r"[\"']?(#[0-9a-f]{3}|rgb|hsl|[(\[]\s*[\d.]+\s*,)",
    re.IGNORECASE,
)


def luminance(colour: tuple[int, ...]) -> float:
    """Relative luminance of WCAG 2."""
    share = np.array(colour) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("kind", COLOURS)
def test_colours_are_seen_on_white_and_on_black(kind: str) -> None:
    assert 1.05 / (luminance(rgb(kind)) + 0.05) >= 3.0
    assert (luminance(rgb(kind)) + 0.05) / 0.05 >= 3.0


def test_no_other_file_gives_a_kind_a_colour() -> None:
    assert OWN.search("  --ghost: #D55E00;")
    assert OWN.search("GHOSTS: Colour = (0.0, 159.0, 230.0)")
    files = [file for room in SHOWS for file in (ROOT / room).rglob("*") if file.suffix in TEXTS]
    own = [
        f"{file.relative_to(ROOT)}: {match[0]}"
        for file in files
        if file.relative_to(ROOT).as_posix() != HOME
        for match in OWN.finditer(file.read_text(encoding="utf-8"))
    ]
    assert len(files) > 300
    assert not own


def test_pages_and_exports_have_these_colours(tmp_path: Path) -> None:
    page, (folder, state) = sabench.view("quick").html, (tmp_path, tmp_path / "state.py")
    write_state(folder, folder)
    for kind, colour in COLOURS.items():
        assert f"--{kind}: {colour};" in page
        assert f"'{kind}': {rgb(kind)}" in state.read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", COLOURS)
def test_figures_have_these_colours(kind: str) -> None:
    one = np.zeros((1, 4, 4), dtype=np.float32)
    one[0, 1, 2] = 1.0
    circles = Circles(kind, np.zeros(1), np.zeros(1), np.ones(1))
    slices = class_slice({kind: one}, (slice(0, 1), slice(0, 4), slice(0, 4)))
    for png in (slices, draw(Figure("f", "a figure", (Panel("", "x", "y", (circles,)),)))):
        image = cv2.imdecode(np.frombuffer(png, dtype=np.uint8), cv2.IMREAD_COLOR)
        assert (np.asarray(image)[..., ::-1] == rgb(kind)).all(axis=2).any()


def test_the_glossary_has_the_definition() -> None:
    assert DEFINITION in (ROOT / "docs/reference/glossary.md").read_text(encoding="utf-8")
