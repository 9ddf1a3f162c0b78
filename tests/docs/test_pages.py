"""Pages of the documentation: links, references, tables, the site and the changelog."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from sabench import plugins, tasks
from tests.docs import score_tables
from tests.docs.pages import PAGES, ROOT, anchors, built, links, read, site
from tests.helpers.refusals import check_sentence


def test_the_navigation_has_every_page_of_the_documentation() -> None:
    sections = list(site("navigation")["sections"](read("docs/index.md"), "docs"))
    assert [heading for heading, _ in sections][:2] == ["Start", "Reference"]
    found = {name for _, names in sections for name in names}
    pages = {path.relative_to(ROOT) for path in (ROOT / "docs").rglob("*.md")}
    assert {path.with_suffix("").as_posix() for path in pages} - {"docs/index"} <= found
    assert {"CONTRIBUTING", "docs/reference/api"} <= found


def test_a_page_stands_in_the_first_section_that_links_to_it() -> None:
    text = "# Top\n## One\n[a](a.md), [b](../b.md#x)\n## Two\n[c](sub/c.md#y) [a](a.md)\n## None\n"
    trees = site("navigation")["toctrees"](text, "docs")
    assert trees.count("/docs/a\n") == 1
    assert trees.index("/docs/a") < trees.index("caption: Two") < trees.index("/docs/sub/c")
    assert "caption: None" not in trees


def test_meanings_move_below_the_names_of_parameters() -> None:
    lines = ["Do it.", "", "Parameters", "----------", "a, b : two of them.", "", "x : y"]
    assert site("docstrings")["rewritten"](lines) == [
        *lines[:4], "a", "    See `b`.", "b", "    two of them.", "", "x", "    y"
    ]  # fmt: skip
    assert site("docstrings")["rewritten"](["x : y"]) == ["x : y"]


@pytest.fixture
def two_pages(tmp_path: Path) -> Path:
    (tmp_path / "one.html").write_text(
        '<h1 id="top-of-it">One</h1><a href="two.html#there">two</a><img src="a%20b.png">'
        '<a href="https://example.org">elsewhere</a><a href="#top-of-it">up</a>'
    )
    (tmp_path / "two.html").write_text('<p id="there">Two</p><a href="one.html">one</a>')
    (tmp_path / "a b.png").write_bytes(b"")
    return tmp_path


def test_a_good_site_has_no_faults_and_a_font_from_the_network_is_one(two_pages: Path) -> None:
    assert not list(site("check")["faults"](two_pages))
    (two_pages / "a.css").write_text("@font-face { src: url('https://a.org/font.woff2') }")
    assert len(list(site("check")["faults"](two_pages))) == 1


@pytest.mark.parametrize(
    ("tag", "target"),
    [
        ('<a href="three.html">', "three.html"),
        ('<a href="two.html#nowhere">', "two.html#nowhere"),
        ('<script src="https://a.org/a.js">', "https://a.org/a.js"),
        ('<link href="//a.org/a.css">', "//a.org/a.css"),
    ],
)
def test_a_bad_reference_is_found(two_pages: Path, tag: str, target: str) -> None:
    (two_pages / "bad.html").write_text(tag)
    (fault,) = site("check")["faults"](two_pages)
    check_sentence(fault, f"bad.html: {target}")


def test_what_scrolls_takes_the_focus_and_headings_have_a_level() -> None:
    page = '<p class="caption" role="heading"><pre>x</pre><p><img src="a.png"></p><p>b</p>'
    done = site("access")["complete"](page)
    assert done == (
        '<p class="caption" role="heading" aria-level="2"><pre tabindex="0">x</pre>'
        '<p tabindex="0"><img src="a.png"></p><p>b</p>'
    )
    assert site("access")["complete"](done) == done


_FILLED = [page for page in PAGES if "<!-- table: " in read(page)]


@pytest.mark.slow_but_first
@pytest.mark.parametrize("page", _FILLED)
def test_every_table_of_a_page_has_rows_of_the_same_length(page: str) -> None:
    for words in site("tables")["MARKER"].findall(read(page)):
        table = site("tables")["filled"](f"<!-- table: {words} -->")
        rows = [line for line in table.split("\n") if line.startswith("|")]
        assert len(rows) > 3
        if words != "scene":
            assert len({row.count("|") for row in rows}) == 1


def test_every_bundled_scene_has_a_small_picture() -> None:
    files = (ROOT / "scenes" / "pictures").iterdir()
    sizes = {file.stem: file.stat().st_size for file in files}
    assert sorted(sizes) == sorted(plugins.list_scenes())
    assert max(sizes.values()) <= 25_000
    assert sum(sizes.values()) <= 1_000_000


def test_pages_of_results_hold_no_table_that_is_made() -> None:
    names = ["by-suite", "ranking", "particle-density", "particle-tracking", "realism", "scene"]
    assert {page.rpartition("/")[2].removesuffix(".md") for page in _FILLED} >= set(names)


def test_a_known_figure_is_that_of_its_record() -> None:
    record = json.loads((ROOT / "benchmarks" / "records" / "particle-tracking.json").read_text())
    rows = record["equal 0.05"]["shake_the_box"]
    recall = sum(row["frames"][frame]["recall"] for row in rows for frame in (10, 11))
    cell = f"| equal light, 0.05 ppp | `shake_the_box` | {recall / (2 * len(rows)):.2f} | "
    assert cell in built("docs/results/particle-tracking.md")


def test_every_case_of_the_records_of_densities_is_in_the_table() -> None:
    cases = site("tables")["particle_tables"].DENSITIES
    record = json.loads((ROOT / "benchmarks" / "records" / "particle-density.json").read_text())
    assert set(cases.values()) == set(record)


def test_the_map_of_the_code_has_the_size_of_twenty_files() -> None:
    text = built("docs/developing/design.md")
    rows = re.findall(r"^\| `([\w/]+\.py)` \|.*\| (\d+) \|$", text, re.MULTILINE)
    assert len(rows) == 20
    for name, lines in rows:
        assert len((ROOT / name).read_text(encoding="utf-8").splitlines()) == int(lines)


def test_the_best_solver_of_a_row_is_bold() -> None:
    table = built("docs/results/by-suite.md")
    assert "| 4 | 0.01 | 0.959 | **0.960** | **0.960** | 0.959 | " in table


def test_seconds_on_a_gpu_are_those_of_the_record() -> None:
    record = json.loads((ROOT / "benchmarks" / "records" / "gpu.json").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "using" / "generating.md").read_text(encoding="utf-8")
    shown = [("particles", "image_s"), ("bubbles", "nine_images_s"), ("gradient", "usual_s")]
    for part, key in [
        *shown,
        *(("refocusing", f"{kind}_s") for kind in ("additive", "multiplicative")),
    ]:
        llvm, cuda = (record[part][kind][key] for kind in ("llvm", "cuda"))
        assert f"| {llvm:g} | {cuda:g} |" in page
    assert f"{record['gradient']['llvm']['particles']:,.0f} particles" in page


def reference() -> dict[str, Any]:
    names: dict[str, Any] = vars(site("tables")["scene_reference"])
    return names


def test_every_key_has_a_description_and_a_typical_value_and_its_table_a_section() -> None:
    found = reference()["sections"]()
    assert len(found) > 50
    assert sum(len(section.keys) for section in found) > 300
    assert not reference()["faults"](found)
    names = anchors("docs/reference/scene.md")
    assert {"calibration", "timing", "sensor", "bubbles-generator-bubble_field"} <= names


def test_a_key_without_a_description_or_a_typical_value_is_named() -> None:
    key, section = reference()["Key"], reference()["Section"]
    words = ("good", "length of it", "1.0"), ("silent", "", "1.0"), ("bare", "length of it", "")
    keys = [key(name, text, "-", "number", value or "none", value) for name, text, value in words]
    silent, bare = reference()["faults"]([section("`table`", "A table.", keys)])
    check_sentence(silent, "`table`: silent")
    check_sentence(bare, "`table`: bare")


def test_units_follow_from_suffixes() -> None:
    unit_of = reference()["unit_of"]
    names = ("size_mm", "peak_mm_s", "gain_dn_e", "per_mm3", "gradient_1_s", "f_number", "s")
    assert [unit_of(name) for name in names] == [
        *("mm", "mm/s", "grey values/electron", "1/mm^3", "1/s", "-", "-")
    ]


def test_values_that_a_key_may_have_are_read_from_the_schema() -> None:
    allowed = reference()["allowed"]
    number = {"type": "number", "exclusiveMinimum": 0.0}
    assert allowed(number) == "number > 0"
    three = {"type": "array", "prefixItems": [number] * 3, "minItems": 3, "maxItems": 3}
    assert allowed(three) == "3 numbers > 0"
    assert allowed({"anyOf": [{"enum": ["a", "b"]}, {"type": "null"}]}) == "`a` or `b`"


@pytest.mark.parametrize("page", [*PAGES, "CHANGELOG.md"])
def test_every_link_leads_to_a_file_and_a_heading(page: str) -> None:
    lost = [f"{page}:{line}: {target}" for line, target in links(page) if not _leads(page, target)]
    assert not lost


def _leads(page: str, target: str) -> bool:
    if target.startswith(("https://", "http://", "mailto:")):
        return True
    name, _, anchor = target.partition("#")
    path = (ROOT / page).parent / name if name else ROOT / page
    if not path.exists():
        return False
    return not anchor or anchor in anchors(path.resolve().relative_to(ROOT).as_posix())


def test_every_page_that_code_names_exists() -> None:
    folders = ("sabench", "solvers", "generators", "scenes", "examples", "benchmarks", "tests")
    files = [ROOT / "pyproject.toml", *(f for one in folders for f in (ROOT / one).rglob("*"))]
    named = {
        (file.relative_to(ROOT).as_posix(), page)
        for file in files
        if file.suffix in (".py", ".toml", ".cpp")
        for page in re.findall(r"\bdocs/[\w/-]+\.md", file.read_text(encoding="utf-8"))
    }
    assert named
    assert not {(file, page) for file, page in named if not (ROOT / page).is_file()}


FIRST, LONGEST = 600, 20  # words of the first version, and of each later entry
_ENTRY = re.compile(r"- \S.*[^.]")


def faults(text: str) -> list[str]:
    *later, first = re.split(r"^## ", text, flags=re.MULTILINE)[1:]
    lines = [line for section in later for line in section.splitlines()[1:] if line]
    found = [
        f"expected an entry of at most {LONGEST} words on one line, got {line[:60]!r}"
        for line in lines
        if not _ENTRY.fullmatch(line) or len(line.split()) - 1 > LONGEST
    ]
    count = len(first.split())
    return found + [f"first version: expected {FIRST} words, got {count}"] * (count > FIRST)


def test_the_changelog_has_this_form() -> None:
    assert not faults(read("CHANGELOG.md"))


@pytest.mark.parametrize(
    ("entry", "count"),
    [
        ("- Solver `msa` reads half-covered images (scores change)", 0),
        ("- " + "word " * 20 + "more", 1),
        ("A paragraph", 1),
        ("- One line\n  and another", 1),
        ("- A sentence.", 1),
    ],
)
def test_other_forms_are_found(entry: str, count: int) -> None:
    text = f"# Changelog\n\n## Unreleased\n\n{entry}\n\n## 0.1.0\n\nIt exists.\n"
    assert len(faults(text)) == count


def _listed() -> dict[str, set[str]]:
    table = read("README.md").partition("<!-- solvers -->")[2].partition("<!-- end solvers -->")[0]
    rows = [line.split("|")[1:3] for line in table.splitlines() if "`" in line]
    return {task.split(":")[0].strip(): set(re.findall(r"`(\w+)`", names)) for task, names in rows}


def test_readme_lists_every_solver_under_its_task() -> None:
    found: dict[str, set[str]] = {}
    for name in plugins.names("solvers"):
        found.setdefault(plugins.load("solvers", name).task, set()).add(name)
    assert _listed() == found


def test_every_task_has_a_table_of_its_scores() -> None:
    names = [page.relative_to(ROOT).as_posix() for page in score_tables.outdated()]
    assert not names, f"run python -m tests.docs.score_tables --write: {', '.join(names)}"
    marked = re.findall(r"<!-- scores: (\w+) -->", "".join(read(page) for page in PAGES))
    assert sorted(marked) == sorted(tasks.NAMES)
