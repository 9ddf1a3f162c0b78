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
from sabench.utils.errors import InputError

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
            continue
        if not rank_after(task.rank(trial.figures), worst):
            better.append((trial.name, task.rank(trial.figures), worst))
        numbers = [one for one in trial.figures.values() if isinstance(one, float)]
        assert np.isfinite(numbers).all(), trial
        task.picture(data, open_result(out, data))
    assert not better


@pytest.mark.slow
def test_peaks_and_intensities_from_nothing_are_bad(folder: Path, tmp_path: Path) -> None:
    task = tasks.of("reconstruction")
    data = example(task, task.shown, folder)
    for trial in know_nothing.try_all(task, data, tmp_path / "nothing.h5"):
        if trial.figures is not None:
            f1, error = trial.figures["peak_f1"], trial.figures["intensity_error"]
            assert f1 is not None
            assert error is not None
            assert f1 < 0.05, trial
            assert error > 0.8, trial


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
    with pytest.raises(InputError, match=f"attribute task: expected .*, got {name}"):
        score(data, out)


@pytest.mark.slow
def test_cameras_that_are_none_are_refused(folder: Path, tmp_path: Path) -> None:
    task = tasks.of("calibration")
    data = example(task, task.shown, folder)
    refused = {one.name: one.refusal for one in know_nothing.try_all(task, data, tmp_path / "r.h5")}
    assert "principal_distance_mm: expected more than 0, got -100" in refused["distance -100"]
    assert "rotation: expected a rotation" in refused["rotation 0"]
    assert "expected finite numbers of at most 1e+12, got 1e+300" in refused["distance 1e300"]
