"""Particles in groups of two and of four pulses, solved within groups and scored by their times."""

import itertools
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sabench.api import FoundParticles
from sabench.api.truth import Particles
from sabench.dataset.reader import Dataset
from sabench.dataset.results import open_result, result_writer
from sabench.metrics.particle_bounds import coverage
from sabench.metrics.particle_detection import challenge_pairs
from sabench.scenes import find, parse_scene
from sabench.simulation.pipeline import generate
from sabench.tasks.solve_and_score import score, solve
from sabench.utils.arrays import F64

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
            first = frame - frame % setup.pulses
            time = setup.time_s(frame) - setup.time_s(first)
            writer.add(claim(recording.particles(frame), time), frame)
    return score(recording, place)


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


def test_claimed_velocities_are_those_at_the_pulse(recording: Dataset, tmp_path: Path) -> None:
    """The mean velocity between two pulses differs, as particles accelerate."""

    def claim(true: Particles, time: float) -> FoundParticles:
        claimed = true.velocity_mm_s + DRIFT_MM_S
        return FoundParticles(true.position_mm, trajectory=true.id, velocity_mm_s=claimed)

    scores = scores_of(recording, tmp_path / "r.h5", claim)
    assert scores["velocity_mm_s"] == pytest.approx(np.linalg.norm(DRIFT_MM_S), rel=1e-3)


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
