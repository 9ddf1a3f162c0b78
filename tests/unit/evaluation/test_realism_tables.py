"""Tables of suite `realism`: costs are paired by seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy import stats

from benchmarks.realism import Scores, cost, effects_of, read_scores, table

SCORES: Scores = {
    ("clean", "good"): {1: 0.9, 2: 0.8, 3: 0.95},
    ("mie", "good"): {1: 0.7, 2: 0.7, 9: 0.1},
    ("clean", "bad"): {1: 0.5},
}


def test_a_cost_is_the_mean_over_the_seeds_of_both_cases() -> None:
    width = stats.t.interval(0.95, 1, scale=stats.sem([-0.2, -0.1]))[1]
    assert cost(SCORES, "mie", "good") == f"-0.150 ± {width:.3f}"
    assert cost(SCORES, "clean", "good").startswith(f"{np.mean([0.9, 0.8, 0.95]):.3f} ± ")
    assert cost(SCORES, "mie", "bad") == "-"


def test_the_best_solver_in_clean_images_comes_first() -> None:
    lines = table(SCORES, ["clean", "mie"]).splitlines()
    assert lines[0] == "| effect | `good` | `bad` |"
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| clean: the score", "| mie"]


def test_both_families_have_the_same_effects() -> None:
    assert effects_of("volume") == effects_of("particle")
    assert effects_of("volume")[0] == "clean"


def test_no_records_are_no_scores(tmp_path: Path) -> None:
    assert read_scores([tmp_path], "volume", "q") == {}
