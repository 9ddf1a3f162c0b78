"""The reference of scenes describes every key, and is that of the schema."""

from __future__ import annotations

import runpy
from functools import cache
from typing import Any

from tests.docs.pages import ROOT


@cache
def script() -> dict[str, Any]:
    """Return the names of the script that writes the page."""
    return runpy.run_path(str(ROOT / "docs" / "reference" / "fill_scene.py"))


def test_every_key_has_a_description_and_a_typical_value() -> None:
    found = script()["sections"]()
    assert len(found) > 50
    assert sum(len(section.keys) for section in found) > 300
    assert not script()["faults"](found)


def test_the_page_is_that_of_the_schema() -> None:
    text = script()["PAGE"].read_text(encoding="utf-8")
    assert text == script()["page"](), "run python docs/reference/fill_scene.py"


def test_a_key_without_a_description_or_a_typical_value_is_named() -> None:
    key, section = script()["Key"], script()["Section"]
    keys = [
        key("good", "length of it", "-", "number", "1.0", "1.0"),
        key("silent", "", "-", "number", "1.0", "1.0"),
        key("bare", "length of it", "-", "number", "none", ""),
    ]
    assert script()["faults"]([section("`table`", "A table.", keys)]) == [
        "`table`: silent: expected a description",
        "`table`: bare: expected a typical value",
    ]


def test_units_follow_from_suffixes() -> None:
    unit_of = script()["unit_of"]
    names = ("size_mm", "peak_mm_s", "gain_dn_e", "per_mm3", "gradient_1_s", "f_number", "s")
    assert [unit_of(name) for name in names] == [
        "mm", "mm/s", "grey values/electron", "1/mm^3", "1/s", "-", "-"
    ]  # fmt: skip


def test_values_that_a_key_may_have_are_read_from_the_schema() -> None:
    allowed = script()["allowed"]
    number = {"type": "number", "exclusiveMinimum": 0.0}
    assert allowed(number) == "number > 0"
    three = {"type": "array", "prefixItems": [number] * 3, "minItems": 3, "maxItems": 3}
    assert allowed(three) == "3 numbers > 0"
    assert allowed({"anyOf": [{"enum": ["a", "b"]}, {"type": "null"}]}) == "`a` or `b`"
