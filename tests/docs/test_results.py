"""Tables of results: made from records, for every page that names one."""

from __future__ import annotations

import json
import re

import pytest

from tests.docs.pages import PAGES, ROOT, built, read, site

_FILLED = [page for page in PAGES if "<!-- table: " in read(page)]


@pytest.mark.parametrize("page", _FILLED)
def test_every_table_of_a_page_has_rows_of_the_same_length(page: str) -> None:
    for words in site("tables")["MARKER"].findall(read(page)):
        table = site("tables")["filled"](f"<!-- table: {words} -->")
        rows = [line for line in table.split("\n") if line.startswith("|")]
        assert len(rows) > 3
        if words != "scene":
            assert len({row.count("|") for row in rows}) == 1


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
    shown = [
        ("particles", "image_s"),
        ("bubbles", "nine_images_s"),
        ("refocusing", "additive_s"),
        ("refocusing", "multiplicative_s"),
        ("gradient", "usual_s"),
    ]
    for part, key in shown:
        llvm, cuda = (record[part][kind][key] for kind in ("llvm", "cuda"))
        assert f"| {llvm:g} | {cuda:g} |" in page
    assert f"{record['gradient']['llvm']['particles']:,.0f} particles" in page
