"""The reference of scenes describes every key."""

from __future__ import annotations

from typing import Any

from tests.docs.pages import anchors, site


def script() -> dict[str, Any]:
    """Return the names of the module that writes the reference."""
    names: dict[str, Any] = vars(site("tables")["scene_reference"])
    return names


def test_every_key_has_a_description_and_a_typical_value() -> None:
    found = script()["sections"]()
    assert len(found) > 50
    assert sum(len(section.keys) for section in found) > 300
    assert not script()["faults"](found)


def test_the_page_has_a_section_for_every_table() -> None:
    names = anchors("docs/reference/scene.md")
    assert {"calibration", "timing", "sensor", "bubbles-generator-bubble_field"} <= names


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
