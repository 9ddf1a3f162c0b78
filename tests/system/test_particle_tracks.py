"""Particles followed through sequences and pulses: duties of solvers, scores, and dense starts."""

import functools
import itertools
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.spatial import cKDTree

from sabench import plugins
from sabench.algorithms import particles
from sabench.algorithms.particles.bayesian_ipr import Known, search_frame
from sabench.api import FoundParticles, ImageSequence, Observation, ParticleSolver
from sabench.api.make import make_algorithm
from sabench.api.truth import Particles
from sabench.dataset.reader import Dataset
from sabench.dataset.results import open_result, result_writer
from sabench.evaluation.suite_loading import override
from sabench.metrics.particle_bounds import coverage
from sabench.metrics.particle_detection import challenge_pairs
from sabench.scenes import find, load_scene, parse_scene
from sabench.simulation.in_memory import Shot, simulate, simulate_sequence
from sabench.simulation.pipeline import generate
from sabench.tasks.particles import TASK
from sabench.tasks.solve_and_score import score, solve
from sabench.utils.arrays import F64
from tests.helpers.refusals import refused
from tests.helpers.small_particles import count_found

SOLVERS = [  # ddpiv takes three parallel pinholes alone
    name
    for name in plugins.names("solvers")
    if plugins.load("solvers", name).task == "particles" and name != "ddpiv"
]


@pytest.fixture(scope="module")
def shot() -> Shot:
    """Four cameras in water behind glass; the sides are unequal everywhere."""
    values = load_scene("quick").to_dict()
    values["volume"]["size_mm"] = [9.0, 6.0, 3.0]
    values["particles"]["count"] = 60
    return simulate(parse_scene(values, "small"), seed=5)


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    scene = override(
        load_scene("particle-tracking"), {"frames": 6, "particles.per_pixel": 0.004}, "small"
    )
    return generate(scene, tmp_path_factory.mktemp("sequence") / "data", seed=3, backend="splat")


def ready(name: str, case: ImageSequence) -> ParticleSolver:
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
    assert solve(name, sequence, tmp_path / "r.h5").task == "particles"
    scores = score(sequence, tmp_path / "r.h5")
    assert scores["precision"] > 0.85
    assert scores["recall"] > 0.75
    assert scores["rms_px"] < 0.25
    assert scores["link_precision"] > 0.85
    assert scores["peak_mb"] > 50.0


@pytest.mark.slow
def test_particles_are_scored_where_the_task_is_asked_for(sequence: Dataset) -> None:
    true = score(sequence, "truth", "particles")
    for key in ("f1", "link_recall", "link_precision", "effectiveness", "hota"):
        assert true[key] == 1.0
    for key in ("ghost_percent", "rms_px", "rms_mm", "velocity_mm_s", "velocity_percent"):
        assert true[key] == 0.0
    assert score(sequence, "empty")["task"] == "reconstruction"
    with refused("task"):
        score(sequence, "truth", "bubbles")


def test_known_faults_have_known_scores(sequence: Dataset, tmp_path: Path) -> None:
    """Every fourth particle is missing, others are 0.03 mm aside along X, each has a ghost."""
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
    middle = np.array([[0.0, 0.0, 30.0]])
    slope = [
        np.linalg.norm(camera.project(middle + shift)[0] - camera.project(middle)[0])
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


def test_trajectories_of_some_frames_alone_are_a_fault(sequence: Dataset, tmp_path: Path) -> None:
    with result_writer(tmp_path / "r.h5", sequence, "faulty", "particles", {}) as writer:
        for frame in range(sequence.setup.frames):
            writer.add(FoundParticles(np.ones((2, 3)), np.ones(2), np.arange(2)), frame)
    with h5py.File(tmp_path / "r.h5", "r+") as file:
        del file["frames/0002/particles/track"]
    with refused("frames/0002/particles/track"):
        score(sequence, tmp_path / "r.h5")


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
        writer.set(seconds=float(np.mean(TASK.run(made, "stream", sequence, writer))))
    result = open_result(tmp_path / "r.h5", sequence)
    numbers = [np.asarray(result.read(FoundParticles, n).trajectory).tolist() for n in range(6)]
    assert numbers == [[0, 1], [2, 1]] * 3


@pytest.mark.slow
def test_frames_too_many_and_other_things_are_refused(
    sequence: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, nothing = make_algorithm("ray_triangulation", {}), FoundParticles(np.zeros((0, 3)))
    linked = FoundParticles(np.zeros((1, 3)), None, np.zeros(1, dtype=np.int64))
    for answer in ([nothing] * 7, [nothing, "x"], [nothing, linked], 3):
        monkeypatch.setattr(made, "solve", lambda case, answer=answer: answer)
        with (
            refused("bad"),
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


@functools.cache
def make_shots(per_pixel: float = 0.06, frames: int = 6, small: bool = False) -> tuple[Shot, ...]:
    values = tomllib.loads(find("particle-tracking", "scenes").read_text(encoding="utf-8"))
    values["frames"], side = frames, 80 if small else 130
    values["volume"]["size_mm"] = [4.6, 4.6, 3.0] if small else [7.0, 7.0, 5.0]
    if not small:
        values["grid"]["crop_mm"] = [0.8, 0.8, 0.3]
    values["cameras"] |= {"rows": side, "columns": side}
    values["particles"]["per_pixel"] = per_pixel
    values["illumination"] |= {"scattering": "isotropic", "pulse_energy_mj": 6.5}
    return tuple(simulate_sequence(parse_scene(values, "test"), seed=7 if small else 21))


def cases_of(shots: Sequence[Shot], *dark: int) -> list[Observation]:
    cases = [shot.observation for shot in shots]
    for number in dark:
        cases[number] = replace(cases[number], images=np.full_like(cases[number].images, 64))
    return cases


def follow(cases: Sequence[Observation]) -> list[FoundParticles]:
    times = [0.01 * number for number in range(len(cases))]
    settings = particles.ShakeTheBoxSettings(particles.BayesianIprSettings())
    return list(
        particles.track_particles(iter(cases), times, particles.fit_cameras(cases[0]), settings)
    )


def joined(shots: Sequence[Shot], found: Sequence[FoundParticles]) -> float:
    """The share of the particles found in the first and last frame that a trajectory joins."""
    names = []
    for shot, one in ((shots[0], found[0]), (shots[-1], found[-1])):
        apart, near = cKDTree(one.position_mm).query(shot.particles.position_mm)
        good = apart < 0.03
        assert one.trajectory is not None
        names.append(dict(zip(shot.particles.id[good], one.trajectory[near[good]], strict=True)))
    both = names[0].keys() & names[1].keys()
    assert len(both) > 300
    return float(np.mean([names[0][name] == names[1][name] for name in both]))


@pytest.mark.slow
def test_particles_are_followed_and_ghosts_end() -> None:
    shots = make_shots()
    found = follow(cases_of(shots))
    for shot, one in zip(shots, found, strict=True):
        counts = count_found(shot, one)
        assert counts.truths > 300
        assert min(counts.recall, counts.precision) > 0.99
    assert joined(shots, found) > 0.99


@pytest.mark.slow
def test_trajectories_bridge_a_frame_that_is_dark() -> None:
    shots = make_shots()
    found = follow(cases_of(shots, 3))
    counts = count_found(shots[3], found[3])  # positions between the frames before and after it
    assert counts.recall > 0.95
    assert counts.precision > 0.98
    assert joined(shots, found) > 0.97


@pytest.mark.slow
def test_a_sequence_may_begin_in_the_dark_or_be_dark() -> None:
    shots = make_shots()
    found = follow(cases_of(shots[:3], 0))
    assert len(found[0].position_mm) == 0
    assert count_found(shots[2], found[2]).recall > 0.99
    black = follow(cases_of(shots[:3], 0, 1, 2))
    assert [len(one.position_mm) for one in black] == [0] * 3


@pytest.mark.slow
def test_tracking_begins_again_after_many_dark_frames() -> None:
    shots = make_shots()
    found = follow(cases_of(shots, 2, 3, 4))
    assert len(found[4].position_mm) == 0
    assert count_found(shots[1], found[1]).recall > 0.98
    assert count_found(shots[5], found[5]).recall > 0.98


@pytest.mark.slow
def test_a_camera_whose_image_is_another_frames_is_left_out_there() -> None:
    """The search of the frame has fewer cameras than the one that it is linked to."""
    shots = make_shots(0.02)
    cases = cases_of(shots)
    images = cases[1].images.copy()
    images[-1] = cases[5].images[-1]
    cases[1] = replace(cases[1], images=images)
    with pytest.warns(UserWarning, match=cases[1].cameras[-1].name):
        found = follow(cases[:3])
    assert count_found(shots[1], found[1]).recall > 0.9


NEAR_MM = 0.025  # half a pixel


@pytest.mark.slow
def test_known_particles_help_to_find_the_others() -> None:
    (shot,) = make_shots(0.26, 1, small=True)
    truth, maps = shot.particles.position_mm, particles.fit_cameras(shot.observation)
    given = np.random.default_rng(8).random(len(truth)) < 0.5
    light = np.zeros((int(given.sum()), 4))  # not known
    known = Known(truth[given], light)
    alone = search_frame(shot.observation, maps, particles.BayesianIprSettings())
    together = search_frame(shot.observation, maps, particles.BayesianIprSettings(), known)
    assert alone is not None
    assert together is not None
    others = truth[~given]
    before, after = (
        (cKDTree(search.found().position_mm).query(others)[0] < NEAR_MM).mean()
        for search in (alone, together)
    )
    assert after > before + 0.1
    assert after > 0.85


@pytest.mark.slow
@pytest.mark.parametrize("frames", [3, 8])
def test_held_frames_come_in_order(frames: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of any number of frames, each comes once, and easy images give the same particles."""
    shots = make_shots(0.03, frames, small=True)
    usual = follow(cases_of(shots))
    monkeypatch.setattr(particles.shake_the_box, "are_mostly_wrong", lambda *_: True)
    held = follow(cases_of(shots))
    assert len(held) == frames
    for shot, one, other in zip(shots, usual, held, strict=True):
        assert abs(len(one.position_mm) - len(other.position_mm)) <= 3
        distance, _ = cKDTree(shot.particles.position_mm).query(other.position_mm)
        assert (distance < NEAR_MM).mean() > 0.97
        assert other.velocity_mm_s is not None


TIMES_S = {
    "two": (0.0, 0.01),
    "four": (0.0, 0.01, 0.02, 0.03),
    "uneven": (0.0, 0.003, 0.009, 0.018),
}
GROUPS, RATE_HZ = 2, 10.0
LINKS = ("link_recall", "link_precision", "vector_recall", "effectiveness", "hota", "complete")
DRIFT_MM_S = np.array([0.6, -0.8, 0.5])
Claim = Callable[[Particles, float], FoundParticles]


@pytest.fixture(scope="module", params=list(TIMES_S))
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    values = tomllib.loads(find("particle-tracking", "scenes").read_text(encoding="utf-8"))
    pulses = TIMES_S[request.param]
    values["frames"] = GROUPS * len(pulses)
    values["timing"] = {"rate_hz": RATE_HZ, "pulses_s": list(pulses)}
    values["volume"]["size_mm"] = [4.6, 4.4, 3.0]
    values["grid"]["crop_mm"] = [0.5, 0.4, 0.3]
    values["cameras"] |= {"rows": 80, "columns": 80}
    values["particles"]["per_pixel"] = 0.04
    values["illumination"] |= {"scattering": "isotropic", "pulse_energy_mj": 3.25}
    speeds = {"a_mm_s": 9.0, "b_mm_s": 7.0, "c_mm_s": 5.0}
    values["flow"] = {"generator": "abc_flow", "wavelength_mm": 8.0} | speeds
    scene = parse_scene(values, request.param)
    return generate(scene, tmp_path_factory.mktemp("pulses") / "data", seed=31, backend="splat")


def solved(
    name: str, recording: Dataset, place: Path
) -> tuple[list[FoundParticles], dict[str, Any]]:
    """The particles of all frames, and their scores; no trajectory is in two groups."""
    solve(name, recording, place)
    result, count = open_result(place, recording), recording.setup.pulses
    frames = [result.read(FoundParticles, n) for n in range(recording.setup.frames)]
    first, second = (
        {int(number) for one in part for number in np.asarray(one.trajectory)}
        for part in (frames[:count], frames[count:])
    )
    assert first.isdisjoint(second)
    return frames, score(recording, place)


@pytest.mark.slow
def test_shake_the_box_solves_each_group(recording: Dataset, tmp_path: Path) -> None:
    frames, scores = solved("shake_the_box", recording, tmp_path / "r.h5")
    assert min(scores[key] for key in ("f1", "link_recall", "link_precision")) > 0.98
    assert scores["velocity_percent"] < 10.0
    for one in frames:
        assert one.velocity_mm_s is not None
        assert one.velocity_covariance is not None
        assert one.velocity_mm_s.shape == one.position_mm.shape
        assert (np.linalg.eigvalsh(one.velocity_covariance) > 0.0).all()
    # a steady flow accelerates particles less than the turbulence that first guesses are made for
    assert velocity_coverage(recording, frames) > 0.95


def velocity_coverage(recording: Dataset, frames: list[FoundParticles]) -> float:
    """Share of the true velocities within the claimed 68 % ellipsoids, over .68."""
    errors, claimed, grid = [], [], recording.setup.grid
    for number, one in enumerate(frames):
        true = recording.particles(number)
        i, j = challenge_pairs(grid.to_voxels(one.position_mm), grid.to_voxels(true.position_mm))
        scored = grid.in_scored(grid.to_voxels(true.position_mm[j]))
        i, j = i[scored], j[scored]
        errors.append(np.asarray(one.velocity_mm_s)[i] - true.velocity_mm_s[j])
        claimed.append(np.asarray(one.velocity_covariance)[i])
    return coverage(np.concatenate(errors), np.concatenate(claimed), 0.68)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bayesian_ipr", "ray_triangulation"])
def test_solvers_of_instants_are_linked(name: str, recording: Dataset, tmp_path: Path) -> None:
    _, scores = solved(name, recording, tmp_path / "r.h5")
    assert scores["precision"] > 0.98
    if name == "bayesian_ipr":  # triangulation loses the particles whose images overlap
        assert scores["link_recall"] > 0.97
        assert scores["link_precision"] > 0.97


def scores_of(recording: Dataset, place: Path, claim: Claim) -> dict[str, Any]:
    """Score what is made of the true particles of each frame and its time within the group."""
    setup = recording.setup
    with result_writer(place, recording, "made", "particles", {}) as writer:
        for frame in range(setup.frames):
            time = setup.time_s(frame) - setup.time_s(frame - frame % setup.pulses)
            writer.add(claim(recording.particles(frame), time), frame)
    return score(recording, place)


@pytest.mark.slow
def test_other_numbers_cost_nothing_between_groups_and_all_links_between_pulses(
    recording: Dataset, tmp_path: Path
) -> None:
    for together in (recording.setup.pulses, 1):
        count = itertools.count().__next__

        def renumber(true: Particles, _: float, n: int = together, count: Any = count) -> Any:
            return FoundParticles(true.position_mm, trajectory=true.id + 10**6 * (count() // n))

        scores = scores_of(recording, tmp_path / f"{together}.h5", renumber)
        if together > 1:
            assert [scores[key] for key in LINKS] == [1.0] * len(LINKS)
            assert scores["switch_percent"] == scores["fragment_percent"] == 0.0
        else:
            assert scores["link_recall"] == scores["complete"] == 0.0
            assert scores["switch_percent"] == 100.0


@pytest.mark.slow_but_first
def test_a_drift_is_the_error_of_velocities(recording: Dataset, tmp_path: Path) -> None:
    """Whatever the spacing of the pulses: positions err by a velocity times the time."""

    def move(true: Particles, time: float) -> FoundParticles:
        return FoundParticles(true.position_mm + DRIFT_MM_S * time, trajectory=true.id)

    scores = scores_of(recording, tmp_path / "r.h5", move)
    speed, spaces = float(np.linalg.norm(DRIFT_MM_S)), spacing(recording)
    assert scores["velocity_mm_s"] == pytest.approx(speed, rel=1e-3)
    # particles that come and go are few: nearly as many links in each pair of pulses
    expected = speed * np.sqrt(np.square(spaces).mean())
    assert scores["displacement_mm"] == pytest.approx(expected, rel=0.02)


@pytest.mark.slow_but_first
def test_claimed_velocities_are_those_at_the_pulse(recording: Dataset, tmp_path: Path) -> None:
    """The mean velocity between two pulses differs, as particles accelerate."""

    def claim(true: Particles, time: float) -> FoundParticles:
        claimed = true.velocity_mm_s + DRIFT_MM_S
        return FoundParticles(true.position_mm, trajectory=true.id, velocity_mm_s=claimed)

    scores = scores_of(recording, tmp_path / "r.h5", claim)
    assert scores["velocity_mm_s"] == pytest.approx(np.linalg.norm(DRIFT_MM_S), rel=1e-3)


@pytest.mark.slow_but_first
def test_accelerations_need_three_equal_intervals(recording: Dataset, tmp_path: Path) -> None:
    extra = np.array([30.0, -40.0, 0.0])  # mm/s2

    def accelerate(true: Particles, time: float) -> FoundParticles:
        return FoundParticles(true.position_mm + 0.5 * extra * time**2, trajectory=true.id)

    scores = scores_of(recording, tmp_path / "r.h5", accelerate)
    if len(spacing(recording)) > 1 and spacing(recording).std() < 1e-9:
        assert scores["acceleration_percent"] == pytest.approx(share_of(extra, recording), rel=1e-3)
    else:
        assert scores["acceleration_percent"] is None


def spacing(recording: Dataset) -> F64:
    return np.diff([recording.setup.time_s(n) for n in range(recording.setup.pulses)])


def share_of(extra: F64, recording: Dataset) -> float:
    """Median of an acceleration over the true ones of the scored particles, percent."""
    setup, shares = recording.setup, []
    for frames in setup.sequences():
        for first in frames[:-2]:
            places = [scored_places(recording, n) for n in range(first, first + 3)]
            for number in places[0].keys() & places[1].keys() & places[2].keys():
                before, now, after = (one[number] for one in places)
                true = (before - 2.0 * now + after) / spacing(recording)[0] ** 2
                shares.append(np.linalg.norm(extra) / np.linalg.norm(true))
    return 100.0 * float(np.median(shares))


def scored_places(recording: Dataset, frame: int) -> dict[int, F64]:
    true, grid = recording.particles(frame), recording.setup.grid
    scored = grid.in_scored(grid.to_voxels(true.position_mm))
    return dict(zip(true.id[scored].tolist(), true.position_mm[scored], strict=True))
