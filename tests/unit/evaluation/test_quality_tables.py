"""Table of figures without truth against true scores."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.quality_without_truth import PAIRS, RECORD, correlations, make_scene, table

PAGE = Path(__file__).resolve().parents[3] / "docs/using/quality.md"


def cases(sign: float) -> list[dict[str, Any]]:
    return [
        {
            "solver": "bayesian_ipr",
            "figures": {key: float(n) if key != "followed" else None for key, _ in PAIRS},
            "true": {true: sign * float(np.exp(n)) for _, true in PAIRS},
        }
        for n in range(5)
    ]


def test_ranks_are_compared_where_both_are_known() -> None:
    for sign in (1.0, -1.0):
        for key, _, value, count in correlations(cases(sign)):
            known = key != "followed"
            assert count == (5 if known else 0)
            assert value == pytest.approx(sign) if known else np.isnan(value)


def test_the_page_shows_the_record() -> None:
    record = json.loads(RECORD.read_text(encoding="utf-8"))["cases"]
    page = PAGE.read_text(encoding="utf-8").splitlines()
    assert [line for line in table(record) if line not in page] == []


def test_scenes_of_cases() -> None:
    scene = make_scene(0.03, "dim", "cameras off")
    assert scene.frames == 4
    assert scene.calibration is not None
    assert scene.calibration.shift_px == 0.4
    assert make_scene(0.03, "bright", "true cameras").calibration is None
