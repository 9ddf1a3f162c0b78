"""Figures in the pages of results are those of the records."""

from __future__ import annotations

import json
import runpy
from typing import Any

from tests.docs.pages import ROOT


def test_tables_over_the_density_are_those_of_the_records() -> None:
    script: dict[str, Any] = runpy.run_path(str(ROOT / "docs" / "results" / "fill_density.py"))
    text = script["PAGE"].read_text(encoding="utf-8")
    assert script["filled"](text) == text, "run python docs/results/fill_density.py"
    first_cells = {line.split("|")[1].strip() for line in text.split("\n") if line.startswith("| ")}
    assert {words for words, _ in script["CASES"]} - first_cells <= {"equal light, 0.50 ppp"}
    assert set(script["PARTS"]) <= first_cells


def test_the_table_of_trackers_is_that_of_the_record() -> None:
    script: dict[str, Any] = runpy.run_path(str(ROOT / "docs" / "results" / "fill_tracking.py"))
    text = script["PAGE"].read_text(encoding="utf-8")
    assert script["filled"](text) == text, "run python docs/results/fill_tracking.py"
    assert all(f"\n| {words} | `shake_the_box` | " in text for words in script["CASES"])


def test_tables_on_correlated_ghosts_are_those_of_the_record() -> None:
    script: dict[str, Any] = runpy.run_path(str(ROOT / "docs" / "results" / "fill_ghost_bias.py"))
    for page in script["PAGES"]:
        text = page.read_text(encoding="utf-8")
        assert "<!-- ghost bias: " in text
        assert script["filled"](text) == text, "run python docs/results/fill_ghost_bias.py"


def test_tables_of_the_standard_suite_are_those_of_the_bundled_records() -> None:
    script: dict[str, Any] = runpy.run_path(str(ROOT / "docs" / "results" / "fill_standard.py"))
    text = script["PAGE"].read_text(encoding="utf-8")
    assert text.count("<!-- standard: ") == 6
    assert script["filled"](text) == text, "run python docs/results/fill_standard.py"


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
