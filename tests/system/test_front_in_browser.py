"""The ranking in a browser: order, cards, files, figures on top of each other, accessibility."""

import csv
import io
import json
from pathlib import Path
from typing import Any

import pytest

from sabench.evaluation.leaderboard import board
from sabench.evaluation.record_schema import Record
from tests.helpers.browser import Browser
from tests.system.test_board import draw, record
from tests.system.test_board_in_browser import DRAWN

DASH = "\u2013"
EVIL = '=1+1"><img src=x onerror="document.title=1">'
PLACES = (
    "[...document.querySelectorAll('.board tbody tr:not(.truth)')]"
    ".map(row => [row.querySelector('.place').textContent, row.querySelector('.name').textContent])"
)
RANKS = (
    "[...document.querySelectorAll('.board tbody tr:not(.truth)')]"
    ".map(row => [...row.querySelectorAll('.rank')].map(cell => cell.textContent))"
)
# what a press would save: the page makes a blob of it and follows a link
CATCH = (
    "(() => { const blob = window.Blob; window.saved = []; "
    "window.Blob = function (parts, options) { saved.push([options.type, parts.join('')]); "
    "return new blob(parts, options); }; "
    "HTMLAnchorElement.prototype.click = function () { saved.push(this.download); }; "
    "return true; })()"
)
STEPS = [[1, 2.0, 0.6], [2, 3.0, 0.7], [3, 4.0, 0.75]]  # iterations, their seconds and scores
VIEWS = ("", "#view=table", "#view=time", "#view=why", "#view=case&case=standard-standard-splat")


def trial() -> list[Record]:
    """Four solvers in three cases of five seeds, and in two that change the density."""
    levels = {"easy": 0.9, "standard": 0.8, "hard": 0.5}
    solvers = {"good": 0.0, "close": -0.001, "fair": -0.2, EVIL: -0.3}
    curve = {f"peak_f1_within_{number / 10:g}": number / 10 for number in range(1, 11)}
    head: dict[str, Any] = {"suite": "trial", "reference_s": 0.5, "rms_px": 0.2, **curve}
    records = [
        record(
            solver,
            base + change + 0.03 * ((seed * (3 if solver == "close" else 1)) % 5 - 2),
            **{"case": level, "scene_hash": level, "difficulty": level, "seed": seed},
            dataset=f"{level}-{seed}",
            seconds=10.0 * (1.0 + change),
            pictures=level if seed == 1 else None,
            iterations=STEPS if solver == "good" else None,
            **head,
        )
        for level, base in levels.items()
        for solver, change in solvers.items()
        if (level, solver) != ("hard", "fair")
        for seed in range(1, 6)
    ]
    dense = [
        record(
            solver,
            0.8 + change - ppp + 0.01 * seed,
            **{"case": f"dense-{ppp}", "scene_hash": f"dense-{ppp}", "seed": seed},
            **{"axis": "density", "axes": {"particles.per_pixel": ppp}, "seconds": 1.0},
            dataset=f"{ppp}-{seed}",
            **head,
        )
        for ppp in (0.05, 0.1, 0.2)
        for solver, change in solvers.items()
        for seed in range(1, 4)
    ]
    return [*records, *dense, record("alone", task="see_through", read_percent=90.0)]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("front")
    names = [f"{solver}-01234567" for solver in ("good", "close")]
    for level in ("easy", "standard", "hard"):
        files = ["truth.png", *(f"{n}.png" for n in names), *(f"{n}.error.png" for n in names)]
        draw(folder / "pictures" / level, files)
    board.build_page(trial(), folder / "pictures", folder / "index.html")
    return folder / "index.html"


# The ranking


def test_the_page_opens_with_the_ranking_and_curves(browser: Browser, page: Path) -> None:
    browser.open(page)
    assert browser.ask(PLACES) == [["1", "good"], ["1", "close"], ["3", EVIL], [DASH, "fair"]]
    assert browser.ask(RANKS) == [["=1"] * 3, ["=1"] * 3, ["4", "4", "3"], ["3", "3", DASH]]
    assert browser.texts(".board b.score") == ["0.900 ± 0.059", "0.800 ± 0.059", "0.500 ± 0.059"]
    browser.wait(DRAWN)
    count = "document.querySelectorAll('.plot').length"
    assert browser.ask(count) == 2  # over the density and over the tolerance
    bands = "document.querySelectorAll('.plot')[0].querySelectorAll('.mark-area path').length"
    assert browser.ask(bands) == 4
    points = "document.querySelectorAll('.plot')[1].querySelectorAll('.mark-symbol path').length"
    assert browser.ask(points) == 4 * 10
    heads = "[...document.querySelectorAll('h3')].map(head => head.textContent)"
    over = ("one property of the scene", "the matching tolerance, standard")
    assert browser.ask(heads) == [f"Score over {one}" for one in over]
    assert browser.complaints() == []


@pytest.mark.slow
def test_accuracy_against_time_has_a_line_through_iterations(browser: Browser, page: Path) -> None:
    browser.open(page, "#view=time&case=standard-standard-splat")
    browser.wait(DRAWN)
    count = "document.querySelectorAll('.plot .mark-line path').length"
    assert browser.ask(count) == 1
    label = "document.querySelector('[aria-label*=\"after 2 iterations\"]').ariaLabel"
    assert browser.ask(label) == "good: Q 0.700, 3.00 s, after 2 iterations"
    assert browser.complaints() == []


# Files


def saved(browser: Browser, name: str) -> str:
    """The content that a button would save."""
    browser.ask(CATCH)
    browser.press(f"(//button[starts-with(@aria-label, 'save') and text()='{name}'])[1]")
    browser.wait("window.saved.length === 2")
    return str(browser.ask("window.saved[0][1]"))


@pytest.mark.slow_but_first
@pytest.mark.parametrize("view", ["", "#view=table"])
def test_what_is_shown_is_saved(browser: Browser, page: Path, view: str) -> None:
    browser.open(page, view)
    lines = list(csv.DictReader(io.StringIO(saved(browser, "CSV"))))
    assert {line["solver"] for line in lines} == {"good", "close", "fair", f"'{EVIL}"}
    browser.open(page, view)
    assert {line["solver"] for line in json.loads(saved(browser, "JSON"))} >= {"good", EVIL}
    browser.open(page, view)
    tex = saved(browser, "LaTeX")
    assert tex.startswith("\\begin{tabular}")
    assert tex.count("&") > 4 * len(lines)
    assert "%" not in tex.replace("\\%", "")


@pytest.mark.slow
def test_plots_are_saved_as_svg_and_png(browser: Browser, page: Path) -> None:
    browser.open(page)
    browser.wait(DRAWN)
    browser.ask(CATCH)
    browser.press("(//button[text()='SVG'])[1]")
    browser.wait("window.saved.length === 2")
    assert browser.ask("window.saved[0][1].startsWith('<svg')")
    browser.press("(//button[text()='PNG'])[1]")
    browser.wait("window.saved.length === 4")
    assert str(browser.ask("window.saved[3]")).endswith(".png")
    assert browser.complaints() == []


# Figures on top of each other


@pytest.mark.slow
def test_a_slider_uncovers_one_of_two_figures_and_both_zoom(browser: Browser, page: Path) -> None:
    browser.open(page, VIEWS[-1])
    names = "[...document.querySelectorAll('.swipe span')].map(one => one.textContent)"
    assert browser.ask(names) == ["truth", "good"]
    browser.press("//select/option[text()='close: errors']/..")
    right = "//section[@id='viewer']//label[span='Right']//option[text()='close: errors']"
    browser.press(right)
    assert browser.ask(names) == ["truth", "close: errors"]
    cover = "document.querySelector('.cover').style.clipPath"
    assert "50%" in browser.ask(cover)
    browser.press("//input[@type='range']", "\ue012")  # arrow to the left
    assert "49%" in browser.ask(cover)
    browser.press("//button[starts-with(text(), '4')]")
    browser.press("//div[contains(@class, 'frame')]", "\ue014")  # arrow to the right
    moved = "[...document.querySelectorAll('.frame img')].map(one => one.style.transform)"
    assert browser.ask(moved) == ["scale(4) translate(-2.5%, 0%)"] * 2


# Narrow screens, no script, accessibility


@pytest.mark.slow
def test_a_narrow_screen_shows_cards_with_scores_first(browser: Browser, page: Path) -> None:
    browser.open(page, "", 390)
    assert browser.ask("document.documentElement.scrollWidth") <= 390
    boxes = (
        "[...document.querySelectorAll('.cards tbody tr:not(.details)')]"
        ".map(row => row.getBoundingClientRect()).map(box => [box.left, box.right])"
    )
    assert all(0 <= left < right <= 390 for left, right in browser.ask(boxes))
    top = "document.querySelector('.board b.score').getBoundingClientRect().top"
    assert browser.ask(top) < 844
    browser.open(page, "#view=table", 390)
    order = (
        "[...document.querySelector('.cards tbody tr').children].map(cell => [cell.dataset.label, "
        "cell.getBoundingClientRect().top]).sort((a, b) => a[1] - b[1]).map(cell => cell[0])"
    )
    assert browser.ask(order)[1:4] == ["Q", "seconds", "case"]
    assert browser.ask("document.documentElement.scrollWidth") <= 390


def test_without_scripts_a_static_table_is_there(browser: Browser, page: Path) -> None:
    browser.devtools("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(page)
        nodes = browser.devtools("Accessibility.getFullAXTree")["nodes"]
    finally:
        browser.devtools("Emulation.setScriptExecutionDisabled", value=False)
    read = [one for one in nodes if not one["ignored"]]
    headers = [one["name"]["value"] for one in read if one["role"]["value"] == "rowheader"]
    assert headers == ["good", "close", EVIL, "fair", "alone"]
    browser.open(page)
    assert browser.count(".static") == 0


@pytest.mark.parametrize(("mode", "width"), [("light", 1400), ("dark", 390)])
@pytest.mark.parametrize(
    "view", [VIEWS[0], *(pytest.param(view, marks=pytest.mark.slow) for view in VIEWS[1:])]
)
def test_axe_finds_nothing(browser: Browser, page: Path, view: str, width: int, mode: str) -> None:
    browser.prefer(mode)
    browser.open(page, view, width)
    browser.ask("document.querySelectorAll('details').forEach(details => { details.open = true })")
    if view != "#view=table":
        browser.wait(DRAWN)
    found = browser.violations()
    browser.prefer(None)
    assert found == []


def test_marks_of_results_are_kept_in_the_ranking(browser: Browser, tmp_path: Path) -> None:
    """A program's seconds, a solver that was not confined in one case, a sender, a copy."""
    sent = {"submission": {"name": "Ann", "date": "2026-01-02"}}
    records = [
        record("program", 0.9, seconds=2.0, reference_s=1.0, whole_process=True, rms_px=0.1),
        record("open", 0.8, case="one", suite="tank", isolated=True),
        record("open", 0.8, case="two", suite="tank", scene_hash="two", isolated=False),
        record("sent", 0.7, **sent),
        record("copy", 0.9, rms_px=0.1, **sent),
    ]
    records = [{**one, "suite": "trial"} for one in records]
    board.build_page(records, tmp_path, tmp_path / "index.html")
    browser.open(tmp_path / "index.html")
    chips = (
        "Object.fromEntries([...document.querySelectorAll('.board tbody tr')].map(row => "
        "[row.querySelector('.name').textContent, "
        "[...row.querySelectorAll('.chip')].map(chip => chip.textContent)]))"
    )
    assert browser.ask(chips) == {
        "program": ["also sent as copy by Ann"],
        "open": ["not isolated"],
        "sent": ["by Ann"],
    }
    assert "\u2020" in browser.ask("document.querySelector('.board').textContent")
