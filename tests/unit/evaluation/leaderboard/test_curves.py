"""Curves: cases that differ in one property alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from sabench.evaluation.leaderboard.board import over_seeds
from sabench.evaluation.leaderboard.curves import curves_of
from sabench.evaluation.leaderboard.page_content import cases_of
from sabench.evaluation.record_schema import Record
from sabench.evaluation.records import latest, read_records
from tests.system.test_board import record

RECORDS = Path(__file__).resolve().parents[4] / "leaderboard" / "records"


def found(records: list[Record]) -> list[tuple[str, list[tuple[float, str]]]]:
    """Quantity of every curve, with its values and the names of its cases."""
    cases = cases_of(over_seeds(records))
    return [
        (one.quantity, [(value, cases[place][0]["case"]) for value, place in one.points])
        for one in curves_of(cases)
    ]


def varied(name: str, axes: dict[str, Any], **changes: Any) -> Record:
    head: dict[str, Any] = {"case": name, "scene_hash": name, "suite": "trial", "axes": axes}
    return record("a", 0.5, **{**head, **changes})


def test_varied_values_make_a_curve_for_each_value_of_the_others() -> None:
    records = [
        varied(f"{ppp}-{n}", {"particles.per_pixel": ppp, "frames": n})
        for ppp in (0.1, 0.05, 0.2)
        for n in (1, 3)
    ]
    curves = found(records)
    assert [curve for curve in curves if curve[0] == "particles per pixel"] == [
        ("particles per pixel", [(ppp, f"{ppp}-{n}") for ppp in (0.05, 0.1, 0.2)]) for n in (1, 3)
    ]
    assert [name for name, _ in curves] == ["particles per pixel"] * 2 + ["frames"] * 3


@pytest.mark.parametrize("key", ["suite", "scene", "renderer", "split"])
def test_cases_of_other_suites_scenes_and_renderers_are_apart(key: str) -> None:
    other = {"split": "hidden"}.get(key, "other")
    records = [varied("a", {"x": 1.0}), varied("b", {"x": 2.0}, **{key: other})]
    assert found(records) == []


@pytest.mark.parametrize("value", ["text", True, None, [1.0], {"kind": "grid"}])
def test_what_is_no_number_makes_no_curve(value: Any) -> None:
    assert found([varied("a", {"x": value}), varied("b", {"x": 2.0})]) == []


def test_recorded_cases_and_cases_without_values_make_no_curve() -> None:
    records = [varied("a", {}), varied("b", {})]
    assert found(records) == []
    head: dict[str, Any] = {"recorded": True, "task": "particles"}
    assert found([varied(name, {"x": n}, **head) for n, name in enumerate("ab")]) == []


def test_bundled_scenes_are_compared_as_a_whole() -> None:
    records = latest(read_records(RECORDS))
    curves = dict(found([one for one in records if one["task"] == "reconstruction"]))
    assert curves["cameras"] == [(4, "reconstruction-cameras"), (9, "reconstruction-standard")]
    assert curves["calibration error, px"][0] == (0.0, "reconstruction-standard")
    assert {"reconstruction-easy", "reconstruction-hard"}.isdisjoint(
        name for points in curves.values() for _, name in points
    )
