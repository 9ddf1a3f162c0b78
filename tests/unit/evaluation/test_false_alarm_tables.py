"""Record of false alarms, against the sensors that the benchmark measures."""

from __future__ import annotations

import json

from benchmarks.false_alarms import RECORD, SENSORS, tables


def test_the_record_has_every_sensor() -> None:
    record = json.loads(RECORD.read_text(encoding="utf-8"))
    assert set(record["sensors"]) == set(SENSORS)
    assert tables(record)
