"""The task particles: duties of every solver, bundled or not, scores and results."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from sabench import plugins
from sabench.api import FoundParticles, ImageSequence, Observation, ParticleSolver
from sabench.api.make import make_algorithm
from sabench.dataset.reader import Dataset
from sabench.dataset.results import open_result, result_writer
from sabench.evaluation.suite_loading import override
from sabench.scenes import load_scene, parse_scene
from sabench.simulation.in_memory import Shot, simulate
from sabench.simulation.pipeline import generate
from sabench.tasks.particles import TASK
from sabench.tasks.solve_and_score import score, solve
from sabench.utils.errors import InputError

SOLVERS = [  # ddpiv takes three parallel pinholes alone
    name
    for name in plugins.names("solvers")
    if plugins.load("solvers", name).task == "particles" and name != "ddpiv"
]


@pytest.fixture(scope="module")
def shot() -> Shot:
    """Four cameras in water behind glass, with particles far apart.

    The sides are unequal everywhere.
    """
    values = load_scene("quick").to_dict()
    values["volume"]["size_mm"] = [9.0, 6.0, 3.0]
    values["particles"]["count"] = 60
    return simulate(parse_scene(values, "small"), seed=5)


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Six frames of a sparse flow."""
    scene = override(
        load_scene("particle-tracking"), {"frames": 6, "particles.per_pixel": 0.004}, "small"
    )
    return generate(scene, tmp_path_factory.mktemp("sequence") / "data", seed=3, backend="splat")


def ready(name: str, case: ImageSequence) -> ParticleSolver:
    """The solver, if what it needs is installed."""
    made = make_algorithm(name, {})
    assert isinstance(made, ParticleSolver)
    reason = made.skip(case)
    if reason and "not installed" in reason:
        pytest.skip(reason)
    assert reason is None
    return made


@pytest.mark.slow
@pytest.mark.parametrize("name", SOLVERS)
def test_an_image_sequence_is_tracked(name: str, sequence: Dataset, tmp_path: Path) -> None:
    ready(name, ImageSequence.of([sequence.observation(0)]))
    result = solve(name, sequence, tmp_path / "r.h5")
    assert result.task == "particles"
    scores = score(sequence, tmp_path / "r.h5")
    assert scores["precision"] > 0.85
    assert scores["recall"] > 0.75
    assert scores["rms_px"] < 0.25
    assert scores["link_precision"] > 0.85
    assert scores["peak_mb"] > 50.0


def test_the_truth_is_perfect_and_nothing_is_the_floor(sequence: Dataset) -> None:
    true, nothing = (score(sequence, word, "particles") for word in ("truth", "empty"))
    for key in ("f1", "precision", "recall", "link_recall", "link_precision", "effectiveness"):
        assert true[key] == 1.0
    for key in ("ghost_percent", "rms_px", "rms_mm", "velocity_mm_s", "velocity_percent"):
        assert true[key] == 0.0
    assert (
        nothing["f1"]
        == nothing["precision"]
        == nothing["recall"]
        == nothing["effectiveness"]
        == 0.0
    )
    assert nothing["rms_px"] is None
    assert score(sequence, "empty")["task"] == "reconstruction"
    with pytest.raises(InputError, match="task: expected reconstruction or particles"):
        score(sequence, "truth", "bubbles")


def test_known_faults_have_known_scores(sequence: Dataset, tmp_path: Path) -> None:
    """Scores of a known fault.

    Every fourth particle is left out, all others lie 0.03 mm aside along X, and each has a ghost
    far away. The result has no trajectories.
    """
    shift = np.array([0.03, 0.0, 0.0])
    with result_writer(tmp_path / "r.h5", sequence, "faulty", "particles", {}) as writer:
        for frame in range(sequence.setup.frames):
            true = sequence.particles(frame)
            kept = true.position_mm[true.id % 4 != 0] + shift
            ghosts = kept + np.array([0.0, 0.0, 1000.0])
            writer.add(FoundParticles(np.concatenate([kept, ghosts])), frame)
    scores = score(sequence, tmp_path / "r.h5")
    assert scores["precision"] == 1.0  # what lies outside the scored part is nobody's fault
    assert scores["recall"] == pytest.approx(0.75, abs=0.08)
    assert scores["rms_mm"] == pytest.approx(0.03, rel=1e-9)
    slope = [
        np.linalg.norm(
            camera.project(np.array([[0.0, 0.0, 30.0]]) + shift)[0]
            - camera.project(np.array([[0.0, 0.0, 30.0]]))[0]
        )
        for camera in sequence.true_cameras
    ]
    assert scores["rms_px"] == pytest.approx(np.mean(slope), rel=0.02)
    assert scores["velocity_mm_s"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_claims_are_scored(sequence: Dataset, tmp_path: Path) -> None:
    """Positions err as claimed, velocities by 5 %; ghosts and duplicates claim nothing."""
    rng = np.random.default_rng(8)
    root = 0.002 * rng.normal(size=(3, 3)) + 0.002 * np.eye(3)
    with result_writer(tmp_path / "r.h5", sequence, "claims", "particles", {}) as writer:
        for frame in range(sequence.setup.frames):
            true = sequence.particles(frame)
            count = len(true.id)
            twice = np.arange(0, count, 10)
            rows = np.concatenate([np.arange(count), twice])
            error = rng.normal(size=(len(rows), 3)) @ root.T
            error[count:] = 0.04, 0.0, 0.0
            writer.add(
                FoundParticles(
                    true.position_mm[rows] + error,
                    covariance_mm2=np.broadcast_to(root @ root.T, (len(rows), 3, 3)),
                    probability=np.where(np.arange(len(rows)) < count, 1.0, 0.0),
                    velocity_mm_s=1.05 * true.velocity_mm_s[rows],
                    trajectory=np.concatenate([true.id, 10**6 + true.id[twice]]),
                ),
                frame,
            )
    scores = score(sequence, tmp_path / "r.h5")
    assert scores["coverage_68"] == pytest.approx(1.0, abs=0.06)
    assert scores["coverage_95"] == pytest.approx(1.0, abs=0.03)
    assert scores["brier"] == 0.0
    assert scores["duplicate_percent"] == pytest.approx(10.0, abs=1.5)
    assert scores["velocity_percent"] == pytest.approx(5.0, rel=1e-6)
    assert scores["rms_over_bound"] > 10.0  # what the images allow is far better
    assert 0.8 < scores["f1_area"] < scores["f1"] < 0.97
    assert scores["complete"] == 1.0
    assert scores["switch_percent"] == scores["fragment_percent"] == 0.0


def test_lost_and_confused_particles_cost_identity(sequence: Dataset, tmp_path: Path) -> None:
    """Numbers are given anew from frame 3 on, and frame 1 lacks every second particle."""
    with result_writer(tmp_path / "r.h5", sequence, "confused", "particles", {}) as writer:
        for frame in range(sequence.setup.frames):
            true = sequence.particles(frame)
            kept = (true.id % 2 == 0) | (frame != 1)
            number = true.id[kept] + 10**6 * (frame >= 3)
            writer.add(FoundParticles(true.position_mm[kept], trajectory=number), frame)
    scores = score(sequence, tmp_path / "r.h5")
    assert scores["complete"] < 0.2  # those that leave or come
    assert scores["switch_percent"] == pytest.approx(20.0, abs=2.0)  # one link of five
    assert scores["fragment_percent"] == pytest.approx(10.0, abs=2.0)
    assert scores["hota"] == pytest.approx(np.sqrt(0.9 * 0.5), abs=0.06)
    assert score(sequence, "truth", "particles")["hota"] == 1.0


def test_faults_of_results_are_named(sequence: Dataset, tmp_path: Path) -> None:
    place = tmp_path / "r.h5"
    with result_writer(place, sequence, "faulty", "particles", {}) as writer:
        for frame in range(sequence.setup.frames):
            writer.add(FoundParticles(np.ones((2, 3)), np.ones(2), np.arange(2)), frame)
    with h5py.File(place, "r+") as file:
        file["frames/0001/particles/track"][...] = [4, 4]
        del file["frames/0002/particles/track"]
    result = open_result(place, sequence)
    with pytest.raises(InputError, match="frames/0001/particles/track: expected different numbers"):
        result.read(FoundParticles, 1)
    with h5py.File(place, "r+") as file:
        file["frames/0001/particles/track"][...] = [4, 5]
    with pytest.raises(
        InputError, match=r"frames/0002/particles/track: expected one in every frame or in none"
    ):
        score(sequence, place)


@pytest.mark.slow
def test_a_solver_may_yield_frames_one_after_the_other(
    sequence: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each is written before the next one is made, with numbers of trajectories from 0 on."""
    made, written = make_algorithm("ray_triangulation", {}), list[int]()
    many = 2**62

    def solve(case: ImageSequence) -> Iterator[FoundParticles]:
        for frame in range(len(case)):
            assert written == list(range(frame))
            place = np.full((2, 3), float(frame))
            yield FoundParticles(place, None, np.array([many - frame % 2, -many]))

    monkeypatch.setattr(made, "solve", solve)
    with result_writer(tmp_path / "r.h5", sequence, "stream", "particles", {}) as writer:
        add = writer.add

        def note(one: FoundParticles, frame: int) -> None:
            add(one, frame)
            written.append(frame)

        monkeypatch.setattr(writer, "add", note)
        seconds = TASK.run(made, "stream", sequence, writer)
        writer.set_cost(float(np.mean(seconds)), None)
    result = open_result(tmp_path / "r.h5", sequence)
    numbers = [np.asarray(result.read(FoundParticles, n).trajectory).tolist() for n in range(6)]
    assert numbers == [[0, 1], [2, 1]] * 3


def test_frames_too_many_and_other_things_are_refused(
    sequence: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, nothing = make_algorithm("ray_triangulation", {}), FoundParticles(np.zeros((0, 3)))
    linked = FoundParticles(np.zeros((1, 3)), None, np.zeros(1, dtype=np.int64))
    for answer, text in (
        ([nothing] * 7, "expected FoundParticles for each of 6 frames, got more"),
        ([nothing, "x"], "expected FoundParticles for each of 6 frames, got a str for one"),
        ([nothing, linked], "expected trajectories in every frame or in none"),
        (3, "expected Iterable, got int"),
    ):
        monkeypatch.setattr(made, "solve", lambda case, answer=answer: answer)
        with (
            pytest.raises(InputError, match=text),
            result_writer(tmp_path / "r.h5", sequence, "bad", "particles", {}) as writer,
        ):
            TASK.run(made, "bad", sequence, writer)
        assert not (tmp_path / "r.h5").exists()


def test_frames_are_read_when_they_are_asked_for(shot: Shot) -> None:
    asked: list[int] = []

    def load(frame: int) -> Observation:
        asked.append(frame)
        return shot.observation

    case = ImageSequence(shot.observation.cameras, shot.observation.grid, (0.0, 0.1, 0.2), load)
    assert (len(case), asked) == (3, [])
    assert len(list(case)) == 3
    assert asked == [0, 1, 2]
    with pytest.raises(IndexError):
        case[3]
