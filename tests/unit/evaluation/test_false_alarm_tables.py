"""Tables of false alarms in the documentation, against their record."""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.false_alarms import RECORD, SENSORS, tables

PAGE = Path(__file__).resolve().parents[3] / "docs/using/detection.md"


def test_the_page_shows_the_record() -> None:
    record = json.loads(RECORD.read_text(encoding="utf-8"))
    page = PAGE.read_text(encoding="utf-8").splitlines()
    assert [line for line in tables(record).splitlines() if line not in page] == []
    assert set(record["sensors"]) == set(SENSORS)
