"""The leaderboard in a browser: it sorts, filters, plots, compares, and fits a phone."""

import csv
import io
import json
import re
from pathlib import Path
from typing import Any

import pytest

from sabench.evaluation.leaderboard import board
from sabench.evaluation.record_schema import Record
from sabench.utils.confidence import mean_of
from tests.helpers.browser import Browser
from tests.system.test_board import HOSTILE, draw, record

SOLVERS = (
    "[...document.querySelectorAll('#content tbody tr:not(.details) > th .name')]"
    ".map(cell => cell.textContent)"
)
STATUS = "document.getElementById('status').textContent"
DRAWN = (
    "document.querySelectorAll('.plot').length > 0 && "
    "[...document.querySelectorAll('.plot')].every(plot => plot.dataset.drawn)"
)
LOG, CASE = "#view=table", "#view=case&case=tank-5c5c5c5c-splat"
EVIL = '"><img src=x onerror="document.title=1">'
# over seeds 1 to 3 of the standard case
Q = {"a": (0.50, 0.55, 0.52), "b": (0.40, 0.43, 0.42), "c": (0.51, 0.53, 0.55)}


def heading(text: str) -> str:
    return f"//th/button[text()='{text}']"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    files = [f"{name}-01234567{kind}.png" for name in ("add", "ten") for kind in ("", ".error")]
    draw(folder / "pictures" / "tank-1", ["truth.png", *files])
    shown = {"pictures": "tank-1"}
    long = {"a_very_long_parameter_name_without_a_space": "x" * 60}
    known = {"command": "sabench run quick --solver ten", "code_hash": "c0de" * 16}
    evil = {"parameters": {"a": EVIL}, "command": EVIL, "machine": {"cpu": EVIL}}
    sent = {"split": "hidden", "submission": {"name": EVIL, "date": "2026-01-02"}}
    records = [
        record("add", 0.5, seconds=9.0, peak_mb=100.0, parameters=long, **shown),
        record("ten", 0.25, seconds=10.0, peak_mb=None, **shown, **known),
        record(HOSTILE, None, seconds=200.0, peak_mb=99.5, **shown, **evil),
        record("broken", error=f"solver broken: {EVIL}"),
        record("add", 0.7, scene="x" * 100, **sent),
        record("sees", task="see_through", read_percent=90.0),
    ]
    board.build_page(records, folder / "pictures", folder / "index.html")
    return folder / "index.html"


def levels() -> list[Record]:
    cases: tuple[tuple[dict[str, Any], float], ...] = (
        ({"case": "easy", "difficulty": "easy", "axis": None}, 0.1),
        ({"case": "standard", "difficulty": "standard", "axis": None}, 0.0),
        ({"case": "dense", "difficulty": "standard", "axis": "density"}, -0.2),
        ({"case": "dim", "difficulty": "standard", "axis": "light"}, -0.1),
    )
    head = {"suite": "volumes", "reference_s": 0.5}
    return [
        record(name, q + change, seed=seed, seconds=10.0**number, **about, **head)
        for number, (name, values) in enumerate(Q.items())
        for about, change in cases
        for seed, q in enumerate(values, 1)
    ]


@pytest.fixture(scope="module")
def graded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("graded")
    alone = [
        record("late", 0.6, seed=seed, case="standard", difficulty="standard", suite="volumes")
        for seed in (3, 4, 5)
    ]
    board.build_page([*levels(), *alone], folder / "pictures", folder / "index.html")
    return folder / "index.html"


@pytest.mark.slow
def test_a_click_sorts_numbers_as_numbers_and_nulls_last(browser: Browser, page: Path) -> None:
    browser.open(page, "#q=tank")
    assert browser.ask(SOLVERS) == ["add", "ten", HOSTILE, "broken"]
    browser.press(heading("seconds"))
    assert browser.ask(SOLVERS) == ["add", "ten", HOSTILE, "broken"]
    browser.press(heading("seconds"))
    assert browser.ask(SOLVERS) == ["ten", "add", HOSTILE, "broken"]
    browser.press(heading("peak MB"))
    assert browser.ask(SOLVERS) == ["add", "ten", HOSTILE, "broken"]
    browser.press(heading("peak MB"))
    assert browser.ask(SOLVERS) == ["add", "ten", HOSTILE, "broken"]


@pytest.mark.parametrize("key", ["\ue007", " "], ids=["enter", "space"])
def test_a_key_sorts_and_the_heading_keeps_focus(browser: Browser, page: Path, key: str) -> None:
    sorted_by = (
        "[...document.querySelectorAll('[aria-sort]')].map(th => [th.textContent, th.ariaSort])"
    )
    browser.open(page, "#q=tank")
    assert browser.ask(sorted_by) == []
    browser.press(heading("solver"), key)
    assert browser.ask(sorted_by) == [["solver", "ascending"]]
    assert browser.ask("document.activeElement.textContent") == "solver"
    browser.press(heading("solver"), key)
    assert browser.ask(sorted_by) == [["solver", "descending"]]
    assert browser.ask(SOLVERS) == ["ten", "add", HOSTILE, "broken"]


def test_details_and_the_command_are_there_to_be_copied(browser: Browser, page: Path) -> None:
    browser.open(page, "#solver=ten")
    browser.press("//button[text()='details']")
    shown = browser.ask("document.querySelector('tr.details').textContent")
    parts = ("sabench run quick --solver ten", "c0de" * 16, "da" * 32, "5c" * 32)
    assert all(part in shown for part in (*parts, "0123456789abcdef", "numpy 2.0"))
    expanded = "document.querySelector('tbody button[aria-expanded]').ariaExpanded"
    assert browser.ask(expanded) == "true"
    permissions = ["clipboardReadWrite", "clipboardSanitizedWrite"]
    browser.devtools("Browser.grantPermissions", permissions=permissions)
    browser.press("//button[text()='copy']")
    browser.wait("[...document.querySelectorAll('.copy')].some(p => p.textContent === 'copied')")
    assert browser.ask("navigator.clipboard.readText()") == "sabench run quick --solver ten"
    browser.press("//button[text()='details']")
    assert browser.count("tr.details") == 0


@pytest.mark.slow
def test_filters_are_kept_in_the_fragment_of_a_link(browser: Browser, graded: Path) -> None:
    browser.open(graded, LOG)
    browser.press("//input[@type='search']", "standard a")
    browser.press("//select[option[text()='all axes']]/option[@value='density']")
    browser.press(heading("Q"))
    fragment, shown = browser.ask("location.hash"), browser.ask(SOLVERS)
    assert fragment == "#view=table&q=standard+a&axis=density&sort=q"
    assert shown == []
    browser.press("//select[option[text()='all axes']]/option[@value='-']")
    browser.press("//select[option[text()='all difficulties']]/option[@value='standard']")
    fragment, shown = browser.ask("location.hash"), browser.ask(SOLVERS)
    assert shown == ["b", "a", "c", "late"]
    browser.open(graded, fragment)
    assert browser.ask(SOLVERS) == shown
    assert browser.ask("document.querySelector('input[type=search]').value") == "standard a"
    browser.press("//button[text()='clear']")
    assert browser.ask(STATUS) == "13 of 13 results"


@pytest.mark.slow_but_first
@pytest.mark.parametrize(
    "fragment", ["", LOG, "#view=time", CASE, f"#view=case&case={'x' * 100}-5c5c5c5c-splat-hidden"]
)
def test_hostile_texts_are_shown_as_text(browser: Browser, page: Path, fragment: str) -> None:
    browser.open(page, fragment)
    browser.ask(
        "[...document.querySelectorAll('tbody button[aria-expanded]')]"
        ".forEach(button => button.click())"
    )
    assert browser.ask(
        "[document.scripts.length, document.title, "
        "document.querySelectorAll('[onerror], b img').length]"
    ) == [4, "sabench leaderboard", 0]
    assert browser.ask("[...document.images].every(image => image.src.startsWith('data:image/'))")
    assert browser.complaints() == []
    if fragment == LOG:
        text = browser.ask("document.body.innerText")
        parts = ("failed: solver broken:", "a", "by", "cpu")
        assert all(part in text for part in (HOSTILE, *(f"{one} {EVIL}" for one in parts)))


def test_the_policy_stops_what_comes_from_outside(browser: Browser, page: Path) -> None:
    browser.open(page, LOG)
    browser.ask("document.body.append(Object.assign(new Image(), {src: 'absent.png'}))")
    assert any("Content Security Policy" in complaint for complaint in browser.complaints())
    for banned in (
        "document.body.insertAdjacentHTML('beforeend', '<b>x</b>')",
        "document.createElement('script').src = 'data:,1'",
    ):
        caught = f"(() => {{ try {{ {banned}; return false; }} catch {{ return true; }} }})()"
        assert browser.ask(caught)
        said = " ".join(browser.complaints())
        assert "Trusted" in said or "Content Security Policy" in said


def labels(browser: Browser, plot: int) -> list[str]:
    found = browser.ask(
        f"[...document.querySelectorAll('.plot')[{plot}].querySelectorAll('.mark-symbol "
        "path')].map(path => path.getAttribute('aria-label'))"
    )
    return sorted(found)


def test_accuracy_against_time_has_points_with_tips(browser: Browser, graded: Path) -> None:
    browser.open(graded, LOG)
    assert browser.count(".plot") == 0
    browser.follow("//a[text()='Accuracy against time']")
    browser.wait(DRAWN)
    points = [label.split(",")[0] for label in labels(browser, 0)]
    assert points == ["a: Q 0.523 ± 0.063", "b: Q 0.417 ± 0.038", "c: Q 0.530 ± 0.050"]
    assert browser.texts(".legend li") == ["a", "b", "c"]
    marks = "path => path.getAttribute('d') + path.getAttribute('fill')"
    paths = "[...document.querySelectorAll('.legend path')]"
    assert browser.ask(f"new Set({paths}.map({marks})).size") == 3
    browser.hover("//*[name()='path' and starts-with(@aria-label, 'b: Q')]")
    browser.wait("document.getElementById('tip')")
    assert browser.ask("document.getElementById('tip').textContent").startswith(
        "b: Q 0.417 ± 0.038, 10.00 ± 0.00 s, some processor, llvm"
    )
    browser.press("//select/option[@value='kernels']")
    browser.wait(DRAWN)
    assert "of the reference" in browser.ask("document.querySelector('.plot').textContent")
    assert browser.complaints() == []


@pytest.mark.slow
def test_difficulty_and_axes_show_scores_and_losses(browser: Browser, graded: Path) -> None:
    browser.open(graded, "#view=why")
    browser.wait(DRAWN)
    by_level = labels(browser, 0)
    own = [label for label in by_level if label.startswith("a: ")]
    assert own == ["a: Q 0.523 ± 0.063, standard", "a: Q 0.623 ± 0.063, easy"]
    assert len(by_level) == 7  # `late` in the standard case alone
    lost = labels(browser, 1)
    half = 2.0**0.5 * mean_of(Q["a"]).half_width  # type: ignore[union-attr]
    assert len(lost) == 6
    assert lost[:2] == [
        f"a: Q -0.{size}00 ± {half:.3f} against the standard case, in {case}"
        for size, case in ((1, "dim"), (2, "dense"))
    ]
    browser.open(graded, "#view=why&difficulty=easy")
    assert "No solver has this score in a case of an axis" in browser.ask(
        "document.getElementById('content').textContent"
    )


def test_pictures_come_with_their_case_only(browser: Browser, page: Path) -> None:
    browser.open(page, LOG)
    assert browser.ask("document.images.length") == 0
    browser.follow("//a[text()='tank']")
    assert browser.ask("document.activeElement.textContent") == "tank"
    assert (
        browser.texts("#viewer option") == ["truth", "add", "add: errors", "ten", "ten: errors"] * 2
    )
    browser.wait("[...document.images].every(image => image.complete)")
    # the cameras, the truth next to errors and estimates, and two figures on top of each other
    assert browser.ask("[...document.images].map(image => image.naturalWidth > 0)") == [True] * 9
    assert browser.texts(".row figcaption b") == ["truth", "add", "ten"] * 2
    assert browser.ask("[...document.images].every(image => image.alt)")


def differences(browser: Browser) -> dict[str, list[str]]:
    lines = browser.ask(
        "[...document.querySelectorAll('.differences tbody tr')].map(row => [row.dataset.key, "
        "[...row.cells].slice(1).map(cell => cell.textContent)])"
    )
    return dict(lines)


@pytest.mark.slow
def test_two_solvers_are_compared_over_their_common_seeds(browser: Browser, graded: Path) -> None:
    browser.open(graded, "#view=case&case=standard-5c5c5c5c-splat")
    option = "//section[@id='compare']//label[span='{}']//option[contains(., '. {}')]"
    browser.press(option.format("First", "a"))
    browser.press(option.format("Second", "b"))
    exact = mean_of([one - other for one, other in zip(Q["a"], Q["b"], strict=True)])
    assert exact is not None
    expected = ["0.523 ± 0.063", "0.417 ± 0.038", exact.text(4), "3", "yes"]
    assert differences(browser)["q"] == expected
    fragment = browser.ask("location.hash")
    browser.press(option.format("Second", "c"))
    assert differences(browser)["q"][-1] == "no"
    browser.press(option.format("Second", "late"))
    assert differences(browser)["q"][2:] == ["-0.0800", "1", "one common seed: no interval"]
    browser.open(graded, fragment)
    assert differences(browser)["q"][2] == exact.text(4)


@pytest.mark.slow
@pytest.mark.parametrize("width", [320, 1200])
@pytest.mark.parametrize("fragment", ["#all=1", "#view=time", "#view=why", CASE])
def test_tables_alone_scroll_sideways(
    browser: Browser, page: Path, width: int, fragment: str
) -> None:
    browser.open(page, fragment, width)
    browser.ask("document.querySelectorAll('details').forEach(details => { details.open = true })")
    browser.ask(
        "document.querySelectorAll('button[aria-expanded=false]').forEach(button => button.click())"
    )
    assert browser.ask("innerWidth") == width
    assert browser.ask("document.documentElement.scrollWidth") <= width
    boxes = "[...document.querySelectorAll('.box')]"
    assert browser.ask(f"{boxes}.every(box => getComputedStyle(box).overflowX === 'auto')")


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("large")
    about = [{"case": f"case-{n}", "difficulty": ("easy", "hard")[n % 2]} for n in range(500)]
    records = [
        record(f"solver_{solver}", (solver * 37 + case * 11) % 1000 / 1000.0, seconds=1.0 + solver)
        | about[case]
        for solver in range(20)
        for case in range(500)
    ]
    board.build_page(records, folder / "pictures", folder / "index.html")
    return folder / "index.html"


@pytest.mark.slow
def test_ten_thousand_records_make_a_small_page_of_elements(browser: Browser, large: Path) -> None:
    browser.open(large, LOG)
    assert browser.ask(STATUS) == "10000 of 10000 results"
    assert browser.count("*") < 1500
    browser.press(heading("Q"))
    first = browser.ask(
        "[...document.querySelectorAll('tbody tr')].map(row => "
        "Number(row.querySelectorAll('.number')[1].textContent))"
    )
    values = ((solver * 37 + case * 11) % 1000 for solver in range(20) for case in range(500))
    assert first == [value / 1000.0 for value in sorted(values)[:25]]
    browser.press("//button[text()='last']")
    assert browser.ask("document.querySelector('.pager span').textContent") == "page 400 of 400"
    browser.press("//input[@type='search']", "case-499 solver_1")
    assert set(browser.ask(SOLVERS)) == {f"solver_{number}" for number in (1, *range(10, 20))}
    assert browser.ask(STATUS) == "11 of 10000 results"
    assert re.fullmatch(r"#view=table&q=case-499\+solver_1&sort=q", browser.ask("location.hash"))
    assert browser.count("*") < 1500
    assert browser.complaints() == []


def judged(solver: str, explained: float | None, **changes: Any) -> Record:
    figures = {"explained": explained, "followed": 0.5}
    quality = {"frames": 1, "again": False, "figures": figures}
    head: dict[str, Any] = {"recorded": True, "renderer": "recorded", "seed": 0, "case": "tank"}
    return record(solver, **head, task="particles", quality=quality, **changes)


@pytest.mark.slow
def test_recorded_cases_have_a_table_of_their_own(browser: Browser, tmp_path: Path) -> None:
    records = [
        judged("a", 0.5, seconds=2.0),
        judged("b", 0.9, seconds=1.0),
        record("c", task="particles", f1=0.7, seconds=1.0),
    ]
    board.build_page(records, tmp_path / "pictures", tmp_path / "index.html")
    browser.open(tmp_path / "index.html", LOG)
    tables = "[...document.querySelectorAll('#tasks a')].map(one => one.firstChild.textContent)"
    assert browser.ask(tables) == ["particles", "particles, recorded"]
    assert browser.ask(SOLVERS) == ["c"]
    browser.follow("//nav[@id='tasks']/a[2]")
    assert browser.ask(SOLVERS) == ["a", "b"]  # no ranks: in the order of their names
    assert browser.texts(".chip") == ["recorded, no truth"] * 2
    browser.press(heading("explained"))
    browser.press(heading("explained"))
    assert browser.ask(SOLVERS) == ["b", "a"]
    browser.follow("//td/a[text()='tank']")
    assert "Recorded images have no truth" in browser.ask(
        "document.getElementById('content').textContent"
    )
    assert "renderer" not in browser.ask("document.querySelector('p.quiet').textContent")
    browser.wait(DRAWN)
    assert browser.complaints() == []


DASH = "\u2013"
FORMULA = '=1+1"><img src=x onerror="document.title=1">'
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
MEASURED = {"date": "2026-01-02", "versions": {"sabench": "9.8"}, "code_hash": "c0de" * 16}
STEPS = [[1, 2.0, 0.6], [2, 3.0, 0.7], [3, 4.0, 0.75]]  # iterations, their seconds and scores
VIEWS = ("", "#view=table", "#view=time", "#view=why", "#view=case&case=standard-standard-splat")


def trial() -> list[Record]:
    """Four solvers in three cases of five seeds, and in two that change the density."""
    levels = {"easy": 0.9, "standard": 0.8, "hard": 0.5}
    solvers = {"good": 0.0, "close": -0.001, "fair": -0.2, FORMULA: -0.3}
    curve = {f"peak_f1_within_{number / 10:g}": number / 10 for number in range(1, 11)}
    head: dict[str, Any] = MEASURED | {"reference_s": 0.5, "rms_px": 0.2, "suite": "trial"} | curve
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
        for ppp in (0.05, 0.1, 0.15, 0.2)
        for solver, change in solvers.items()
        for seed in range(1, 4)
    ]
    return [*records, *dense, record("alone", task="see_through", read_percent=90.0)]


@pytest.fixture(scope="module")
def ranking(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("front")
    names = [f"{solver}-01234567" for solver in ("good", "close")]
    for level in ("easy", "standard", "hard"):
        files = ["truth.png", *(f"{n}.png" for n in names), *(f"{n}.error.png" for n in names)]
        draw(folder / "pictures" / level, files)
    board.build_page(trial(), folder / "pictures", folder / "index.html")
    return folder / "index.html"


def test_the_page_opens_with_the_ranking_and_curves(browser: Browser, ranking: Path) -> None:
    browser.open(ranking)
    assert browser.ask(PLACES) == [["1", "good"], ["1", "close"], ["3", FORMULA], [DASH, "fair"]]
    assert browser.ask(RANKS) == [["=1"] * 3, ["=1"] * 3, ["4", "4", "3"], ["3", "3", DASH]]
    assert browser.texts(".board b.score") == ["0.900 ± 0.059", "0.800 ± 0.059", "0.500 ± 0.059"]
    browser.wait(DRAWN)
    assert "measured 2026-01-02sabench 9.8, code c0dec0de" in browser.texts(".board th")[-1]
    assert {"asa", "msa"} <= set(re.findall(r"\w+", browser.texts(".unmeasured")[0]))
    wide = "[...document.querySelectorAll('.board img')].map(image => image.clientWidth >= 240)"
    assert browser.ask(wide) == [True] * (3 + 6)  # the truth, and two solvers, in three cases
    assert browser.count(".plot") == 2  # over the density and over the tolerance
    first, second = (f"#content > figure:nth-of-type({number}) " for number in (1, 2))
    assert browser.count(f"{first} .mark-area path") == 4
    lines = f"[...document.querySelectorAll('{first} .mark-line path')]"
    dashes = browser.ask(f"{lines}.map(path => path.getAttribute('stroke-dasharray'))")
    assert len(set(dashes)) == 4
    assert browser.count(f"{second} .mark-symbol path") == 4 * 10
    over = ("one property of the scene", "the matching tolerance, standard")
    assert browser.texts("h3") == [f"Score over {one}" for one in over]
    assert browser.complaints() == []


@pytest.mark.slow
def test_fewer_than_four_points_are_side_by_side(browser: Browser, tmp_path: Path) -> None:
    few = [one for one in trial() if one.get("case") not in ("dense-0.1", "dense-0.2")]
    board.build_page(few, tmp_path, tmp_path / "index.html")
    browser.open(tmp_path / "index.html")
    browser.wait(DRAWN)
    marks = "[...document.querySelector('.plot').querySelectorAll('.mark-symbol path')]"
    places = browser.ask(f"{marks}.map(one => one.getBoundingClientRect().left)")
    assert len(set(places)) == len(places) == 2 * 4


@pytest.mark.slow
def test_accuracy_against_time_has_a_line_through_iterations(
    browser: Browser, ranking: Path
) -> None:
    browser.open(ranking, "#view=time&case=standard-standard-splat")
    browser.wait(DRAWN)
    assert browser.count(".plot .mark-line path") == 1
    label = "document.querySelector('[aria-label*=\"after 2 iterations\"]').ariaLabel"
    assert browser.ask(label) == "good: Q 0.700, 3.00 s, after 2 iterations"
    assert browser.complaints() == []


def saved(browser: Browser, name: str) -> str:
    browser.ask(CATCH)
    browser.press(f"(//button[starts-with(@aria-label, 'save') and text()='{name}'])[1]")
    browser.wait("window.saved.length === 2")
    return str(browser.ask("window.saved[0][1]"))


@pytest.mark.slow_but_first
@pytest.mark.parametrize("view", ["", "#view=table"])
def test_what_is_shown_is_saved(browser: Browser, ranking: Path, view: str) -> None:
    browser.open(ranking, view)
    lines = list(csv.DictReader(io.StringIO(saved(browser, "CSV"))))
    assert {line["solver"] for line in lines} == {"good", "close", "fair", f"'{FORMULA}"}
    browser.open(ranking, view)
    assert {line["solver"] for line in json.loads(saved(browser, "JSON"))} >= {"good", FORMULA}
    browser.open(ranking, view)
    tex = saved(browser, "LaTeX")
    assert tex.startswith("\\begin{tabular}")
    assert tex.count("&") > 4 * len(lines)
    assert "%" not in tex.replace("\\%", "")


@pytest.mark.slow
def test_plots_are_saved_as_svg_and_png(browser: Browser, ranking: Path) -> None:
    browser.open(ranking)
    browser.wait(DRAWN)
    browser.ask(CATCH)
    browser.press("(//button[text()='SVG'])[1]")
    browser.wait("window.saved.length === 2")
    assert browser.ask("window.saved[0][1].startsWith('<svg')")
    browser.press("(//button[text()='PNG'])[1]")
    browser.wait("window.saved.length === 4")
    assert str(browser.ask("window.saved[3]")).endswith(".png")
    assert browser.complaints() == []


@pytest.mark.slow
def test_a_slider_uncovers_one_of_two_figures_and_both_zoom(
    browser: Browser, ranking: Path
) -> None:
    browser.open(ranking, VIEWS[-1])
    assert browser.texts(".swipe span") == ["truth", "good"]
    browser.press("//select/option[text()='close: errors']/..")
    right = "//section[@id='viewer']//label[span='Right']//option[text()='close: errors']"
    browser.press(right)
    assert browser.texts(".swipe span") == ["truth", "close: errors"]
    cover = "document.querySelector('.cover').style.clipPath"
    assert "50%" in browser.ask(cover)
    browser.press("//input[@type='range']", "\ue012")  # arrow to the left
    assert "49%" in browser.ask(cover)
    browser.press("//button[starts-with(text(), '4')]")
    browser.press("//div[contains(@class, 'frame')]", "\ue014")  # arrow to the right
    moved = "[...document.querySelectorAll('.frame img')].map(one => one.style.transform)"
    assert browser.ask(moved) == ["scale(4) translate(-2.5%, 0%)"] * 2


@pytest.mark.slow
def test_a_narrow_screen_shows_cards_with_scores_first(browser: Browser, ranking: Path) -> None:
    browser.open(ranking, "", 390)
    assert browser.ask("document.documentElement.scrollWidth") <= 390
    boxes = (
        "[...document.querySelectorAll('.cards tbody tr:not(.details)')]"
        ".map(row => row.getBoundingClientRect()).map(box => [box.left, box.right])"
    )
    assert all(0 <= left < right <= 390 for left, right in browser.ask(boxes))
    top = "document.querySelector('.board b.score').getBoundingClientRect().top"
    assert browser.ask(top) < 844
    browser.open(ranking, "#view=table", 390)
    order = (
        "[...document.querySelector('.cards tbody tr').children].map(cell => [cell.dataset.label, "
        "cell.getBoundingClientRect().top]).sort((a, b) => a[1] - b[1]).map(cell => cell[0])"
    )
    assert browser.ask(order)[1:4] == ["Q", "seconds", "case"]
    assert browser.ask("document.documentElement.scrollWidth") <= 390


def test_without_scripts_a_static_table_is_there(browser: Browser, ranking: Path) -> None:
    browser.devtools("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(ranking)
        nodes = browser.devtools("Accessibility.getFullAXTree")["nodes"]
    finally:
        browser.devtools("Emulation.setScriptExecutionDisabled", value=False)
    read = [one for one in nodes if not one["ignored"]]
    headers = [one["name"]["value"] for one in read if one["role"]["value"] == "rowheader"]
    assert headers == ["good", "close", FORMULA, "fair", "alone"]
    browser.open(ranking)
    assert browser.count(".static") == 0


@pytest.mark.parametrize(("mode", "width"), [("light", 1400), ("dark", 390)])
@pytest.mark.parametrize(
    "view", [VIEWS[0], *(pytest.param(view, marks=pytest.mark.slow) for view in VIEWS[1:])]
)
def test_axe_finds_nothing(
    browser: Browser, ranking: Path, view: str, width: int, mode: str
) -> None:
    browser.prefer(mode)
    browser.open(ranking, view, width)
    browser.ask("document.querySelectorAll('details').forEach(details => { details.open = true })")
    if view != "#view=table":
        browser.wait(DRAWN)
    found = browser.violations()
    browser.prefer(None)
    assert found == []


@pytest.mark.slow
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
