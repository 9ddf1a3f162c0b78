"""Ranks of figures, and the gates that decide which figures have one."""

import pytest

from sabench import tasks
from sabench.tasks.task import Gate, check_number
from tests.helpers.refusals import refused


def test_gates_admit_figures_from_the_least_on() -> None:
    gate = Gate("yield_percent", 50.0)
    assert gate.admits({"yield_percent": 50.0})
    assert not gate.admits({"yield_percent": 49.999})
    assert not gate.admits({"yield_percent": None})
    assert not gate.admits({"yield_percent": float("nan")})
    assert gate.admits({})  # a record of an earlier version


@pytest.mark.parametrize("name", tasks.NAMES)
def test_a_better_first_score_ranks_before_and_a_missing_one_last(name: str) -> None:
    task = tasks.of(name)
    first, gate = task.columns[0], task.gate
    passed = {gate.key: gate.least} if gate else {}
    low, high = (task.rank({**passed, first.key: value}) for value in (70.0, 80.0))
    assert (high < low) == (first.better == "larger")
    missing = task.rank({**passed, first.key: None})
    assert max(low, high) < missing
    if gate and gate.key != first.key:
        assert task.rank({gate.key: 0.99 * gate.least, first.key: 70.0}) == missing


def test_far_too_many_detections_are_named() -> None:
    check_number(10_500, 5, "r.h5: frames/0000")
    with refused("r.h5: frames/0000"):
        check_number(10_501, 5, "r.h5: frames/0000")
