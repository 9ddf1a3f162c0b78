"""Trajectories of bubbles, from a data set of three frames to scores.

Result files of this program and of others.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from sabench.api import BubbleSolver, Detections, Observation
from sabench.dataset.reader import Dataset
from sabench.dataset.results import open_result, result_writer
from sabench.simulation.pipeline import generate
from sabench.tasks import bubbles
from sabench.tasks.solve_and_score import score
from sabench.utils.arrays import I64
from sabench.utils.errors import InputError
from tests.helpers.bubble_scenes import small

TRACKS = ("link_recall", "link_precision", "effectiveness", "velocity_mm_s", "velocity_percent")
SPEED = np.array([300.0, -150.0, 100.0])  # 3.5 mm a frame, about as far as the nearest neighbour is


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    field = {
        "generator": "bubble_field",
        "count": 24,
        "radius_mm": 0.8,
        "radius_spread": 0.3,
        "radius_range_mm": [0.5, 1.6],
        "velocity_mm_s": SPEED.tolist(),
    }
    scene = small(frames=3, interval_s=0.01, bubbles=field, render={"relative_error": 0.2})
    return generate(scene, tmp_path_factory.mktemp("data") / "moving", seed=1)


def perturbed(data: Dataset) -> list[Detections]:
    """Return what a good solver might find.

    All bubbles but one in each frame, with small errors, in random order, and two ghosts.
    """
    rng, out = np.random.default_rng(4), []
    for frame in range(data.setup.frames):
        true = data.bubbles(frame)
        keep = rng.permutation(len(true))[1:]
        center = true.center_mm[keep] + 0.03 * rng.standard_normal((len(keep), 3))
        ghosts = np.array([0.0, 0.0, 60.0]) + rng.uniform(-0.5, 0.5, (2, 3)) * np.array(
            [24.0, 18.0, 16.0]
        )
        radius = np.concatenate(
            [true.radius_mm[keep] * (1.0 + 0.02 * rng.standard_normal(len(keep))), [0.6, 0.6]]
        )
        out.append(Detections.balls(np.concatenate([center, ghosts]), radius))
    return out


class Canned(BubbleSolver):
    """A solver that knows what to say."""

    def __init__(self, answers: list[Detections]) -> None:
        super().__init__(self.Parameters())
        self._answers = iter(answers)

    def solve(self, case: Observation) -> Detections:
        return next(self._answers)


def foreign(path: Path, data: Dataset, found: list[Detections], **track: Any) -> Path:
    """A result with values for `track` in some frames, or in none."""
    with result_writer(path, data, "other", "bubbles", {}) as writer:
        for frame, one in enumerate(found):
            writer.add(one, frame)
    with h5py.File(path, "a") as file:
        for name, value in track.items():
            file[f"frames/{name[1:]}/bubbles"]["track"] = value
    return path


@pytest.mark.slow
def test_from_images_to_scores(moving: Dataset, tmp_path: Path) -> None:
    found = perturbed(moving)
    with result_writer(tmp_path / "own.h5", moving, "canned", "bubbles", {}) as writer:
        bubbles.TASK.run(Canned(found), "canned", moving, writer)
    result = open_result(tmp_path / "own.h5", moving)
    for frame, one in enumerate(found):
        read = result.read(Detections, frame)
        number = read.trajectory
        assert number is not None
        assert number.dtype == np.int64
        assert len(np.unique(number)) == len(one.center_mm)
        np.testing.assert_array_equal(read.center_mm, one.center_mm)
    got = score(moving, tmp_path / "own.h5")
    assert got["link_recall"] > 0.9
    assert got["link_precision"] > 0.85
    assert got["effectiveness"] > 0.8
    # the difference of two places with 0.03 mm along each axis: the median of a Maxwell
    # distribution is 1.538 standard deviations
    assert got["velocity_mm_s"] == pytest.approx(1.538 * np.sqrt(2.0) * 0.03 / 0.01, rel=0.3)
    assert got["velocity_percent"] == pytest.approx(
        100.0 * got["velocity_mm_s"] / np.linalg.norm(SPEED), rel=1e-6
    )
    other = score(moving, foreign(tmp_path / "other.h5", moving, found))
    assert {key: other[key] for key in TRACKS} == {key: got[key] for key in TRACKS}


def test_tracks_of_other_programs_count(moving: Dataset, tmp_path: Path) -> None:
    true = [moving.bubbles(frame) for frame in range(3)]
    found = [Detections(one.center_mm, one.semi_axes_mm, one.turn) for one in true]
    own: dict[str, I64] = {
        f"f{frame:04d}": one.id.astype(np.uint32) for frame, one in enumerate(true)
    }
    assert score(moving, foreign(tmp_path / "right.h5", moving, found, **own))["link_recall"] == 1.0
    wrong = own | {"f0001": true[1].id + 1000}
    assert (
        score(moving, foreign(tmp_path / "wrong.h5", moving, found, **wrong))["link_recall"] == 0.0
    )


def test_broken_tracks_are_said(moving: Dataset, tmp_path: Path) -> None:
    found = perturbed(moving)
    good = {f"f{frame:04d}": np.arange(len(one.center_mm)) for frame, one in enumerate(found)}
    count = len(found[1].center_mm)
    cases: dict[str, dict[str, Any]] = {
        r"0001/bubbles/track: expected different numbers, got 7 2 times": good
        | {"f0001": np.where(np.arange(count) == 3, 7, np.arange(count))},
        (
            rf"0001/bubbles/track: expected shape \({count}\) of kind iu, got \({count},\) of "
            r"float64"
        ): good | {"f0001": np.arange(count) * 1.0},
        rf"0001/bubbles/track: expected shape \({count}\) of kind iu, got \({count - 1},\)": good
        | {"f0001": np.arange(count - 1)},
        r"0002/bubbles/track: expected one in every frame or in none": {
            key: good[key] for key in ("f0000", "f0001")
        },
    }
    for number, (sentence, track) in enumerate(cases.items()):
        with pytest.raises(InputError, match=sentence):
            score(moving, foreign(tmp_path / f"{number}.h5", moving, found, **track))


def test_no_track_goes_from_one_group_of_pulses_to_the_next(moving: Dataset) -> None:
    one = moving.bubbles(0)
    setup = moving.setup.model_copy(
        update={"frames": 5, "pulses": 2, "times_s": (0.0, 1e-3, 1.0, 1.001, 2.0)}
    )
    track = bubbles.trajectories(setup, [Detections(one.center_mm, one.semi_axes_mm, one.turn)] * 5)
    assert setup.pairs() == [(0, 1), (2, 3)]
    np.testing.assert_array_equal(track[0], track[1])
    np.testing.assert_array_equal(track[2], track[3])
    every = [set(track[frame].tolist()) for frame in (0, 2, 4)]
    assert not every[0] & every[1]
    assert not every[1] & every[2]


def test_one_frame_has_no_scores_of_tracks(tmp_path: Path) -> None:
    data = generate(small(render={"relative_error": 0.2}), tmp_path / "one", seed=1)
    for end in ("truth", "empty"):
        assert all(score(data, end)[key] is None for key in TRACKS)
