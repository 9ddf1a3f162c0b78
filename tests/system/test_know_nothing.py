"""No score from nothing. Rationale: an estimate chooses where it lies, how much it contains, what
it leaves out, and how large its numbers are. Expected behaviour: whatever it chooses, without
knowing the observations it ranks no better than the worst possible estimate, or is refused with one
sentence; its figure is drawn."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.layout_engine import ConstrainedLayoutEngine

from sabench import tasks
from sabench.api.solvers import TaskName
from sabench.dataset.reader import Dataset
from sabench.dataset.results import open_result, result_writer
from sabench.tasks import know_nothing
from sabench.tasks.conformance import example
from sabench.tasks.solve_and_score import score
from tests.helpers.refusals import check_sentence, refused

SHOWN = [(name, tasks.of(name).shown) for name in tasks.NAMES]
CASES = [
    pytest.param(*case, marks=() if case[0] == "see_through" else pytest.mark.slow)
    for case in (*SHOWN, ("calibration", "particles"))
]
# the rounding of a calibration that is moved along the wall, which no image shows
ROUNDING = 1e-9


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("examples")


def rank_after(own: tuple[bool, float], other: tuple[bool, float]) -> bool:
    return own[0] > other[0] or (own[0] == other[0] and own[1] >= other[1] - ROUNDING)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "sees"), CASES)
def test_who_knows_nothing_ranks_no_better_than_nothing(
    name: str, sees: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # what is drawn counts here, not where panels lie, which takes half of the time of a figure
    monkeypatch.setattr(ConstrainedLayoutEngine, "execute", lambda self, figure: None)
    task = tasks.of(name)
    data = example(task, sees, folder)
    worst = task.rank(task.score(data, "empty"))
    out, better = tmp_path / "nothing.h5", []
    for trial in know_nothing.try_all(task, data, out):
        if trial.figures is None:
            assert str(out) in trial.refusal, trial
            assert "\n" not in trial.refusal
            check_sentence(trial.refusal)
            continue
        if not rank_after(task.rank(trial.figures), worst):
            better.append((trial.name, task.rank(trial.figures), worst))
        numbers = [one for one in trial.figures.values() if isinstance(one, float)]
        assert np.isfinite(numbers).all(), trial
        if name == "reconstruction":  # peaks and intensities from nothing are bad, too
            assert (trial.figures["peak_f1"] or 0.0) < 0.05, trial
            assert trial.figures["intensity_error"] is not None
            assert trial.figures["intensity_error"] > 0.8, trial
        task.picture(data, open_result(out, data))
    assert not better


@pytest.mark.slow_but_first
@pytest.mark.parametrize(
    ("name", "shown"),
    [("see_through", "reconstruction"), ("bubbles", "reconstruction"), ("particles", "bubbles")],
)
def test_a_result_of_a_task_that_the_data_set_cannot_serve_is_named(
    name: TaskName, shown: str, folder: Path, tmp_path: Path
) -> None:
    task = tasks.of(shown)
    data: Dataset = example(task, task.shown, folder)
    out = tmp_path / "result.h5"
    with result_writer(out, data, "nobody", name, {}) as writer:
        writer.add(task.empty(data, 0), 0)
    with refused("task", name):
        score(data, out)
