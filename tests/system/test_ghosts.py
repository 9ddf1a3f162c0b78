"""Ghost particles: where two cameras see them, how they move, and their end.

Two cameras at x = -/+ d and the distance D see along x - z tan a = c and x + z tan a = c, with
tan a = d / D. The line of A's image in the first and that of B's in the second meet at

    x = (x_A + x_B) / 2 + tan a (z_B - z_A) / 2,   z = (z_A + z_B) / 2 + (x_B - x_A) / (2 tan a).

A ghost is linear in both places, and so its displacement is this expression of theirs. In a shear
u(z) it moves along x by the mean of both displacements, whatever its own depth.
"""

from typing import Any

import numpy as np
import pytest

from sabench.api import ImageSequence, Observation
from sabench.api.make import make_algorithm
from sabench.dataset.reader import Dataset
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.geometry.triangulation import triangulate
from sabench.metrics.particle_detection import detect_peaks
from sabench.metrics.reconstruction_error import score_frame
from sabench.scenes import Scene, build_rig, parse_scene
from sabench.simulation.in_memory import Shot, simulate_sequence
from sabench.simulation.pipeline import generate
from sabench.tasks.solve_and_score import score, solve
from sabench.utils.arrays import F64
from sabench.utils.errors import DeclinedError
from tests.helpers.refusals import refused
from tests.system.test_tomographic_solvers import scene_of

ASIDE_MM, AWAY_MM = 240.0, 450.0
TAN = ASIDE_MM / AWAY_MM


def scene_with(**changes: Any) -> Scene:
    return parse_scene(scene_of(wall=False).to_dict() | changes, "ghosts")


@pytest.fixture(scope="module")
def rig() -> tuple[tuple[CameraModel, ...], Grid]:
    """Two cameras on the plane y = 0."""
    values = scene_of(wall=False).to_dict()
    places = [{"center_mm": [side * ASIDE_MM, 0.0, -AWAY_MM]} for side in (-1.0, 1.0)]
    values["cameras"]["layout"] = {"kind": "list", "places": places}
    made = build_rig(parse_scene(values, "two"), "two")
    return made.cameras, made.grid


def ghost_of(a: F64, b: F64) -> F64:
    """Ghosts (n, 3) of A's image in the first and B's in the second camera."""
    x, y, z = ((a + b) / 2.0).T
    along, _, deep = ((b - a) / 2.0).T
    return np.stack([x + TAN * deep, y, z + along / TAN], axis=1)


def crossing(cameras: tuple[CameraModel, ...], a: F64, b: F64) -> F64:
    """The same by the cameras' own lines of sight."""
    pixels = np.stack([camera.project(own)[0] for camera, own in zip(cameras, (a, b), strict=True)])
    return triangulate(cameras, pixels)


def observe(cameras: tuple[CameraModel, ...], grid: Grid, points: F64) -> Observation:
    """Paint Gaussian images of particles (n, 3)."""
    images = []
    for camera in cameras:
        row, column = np.mgrid[: camera.rows, : camera.columns]
        pixels, _ = camera.project(points)
        squares = [(column - c) ** 2 + (row - r) ** 2 for c, r in pixels]
        images.append(sum(20000.0 * np.exp(-own / (2.0 * 0.85**2)) for own in squares))
    return Observation(np.rint(images).astype(np.uint16), cameras, grid, 0.0, 65535.0)


A, B = np.array([[-0.25, 0.0, 0.15]]), np.array([[0.25, 0.0, -0.05]])
A_MOVES, B_MOVES = np.array([[0.10, 0.0, 0.04]]), np.array([[0.04, 0.0, -0.02]])


@pytest.mark.slow
def test_ghosts_are_where_geometry_puts_them(rig: tuple[tuple[CameraModel, ...], Grid]) -> None:
    cameras, grid = rig
    found = []
    for a, b in ((A, B), (A + A_MOVES, B + B_MOVES)):
        both = np.concatenate([ghost_of(a, b), ghost_of(b, a)])
        exact = np.concatenate([crossing(cameras, a, b), crossing(cameras, b, a)])
        np.testing.assert_allclose(exact, both, atol=2e-3)  # the cameras are not quite affine
        frame = observe(cameras, grid, np.concatenate([a, b]))
        peaks = detect_peaks(make_algorithm("mart", {}).solve(frame).volume)  # type: ignore[arg-type,union-attr]
        apart = np.linalg.norm(peaks[:, None] - grid.to_voxels(both), axis=2)
        assert (apart.min(axis=0) < 0.5).all()
        found.append(peaks[apart.argmin(axis=0)])
    moved = (found[1] - found[0]) * 0.05
    expected = np.concatenate([ghost_of(A_MOVES, B_MOVES), ghost_of(B_MOVES, A_MOVES)])
    np.testing.assert_allclose(moved, expected, atol=0.01)  # a fifth of a voxel


@pytest.mark.parametrize("depth_mm", [-0.5, 0.5])
def test_ghosts_in_a_shear_move_by_its_mean_over_the_depth(
    depth_mm: float, rig: tuple[tuple[CameraModel, ...], Grid]
) -> None:
    cameras, _ = rig
    z = np.random.default_rng(0).uniform(-0.7, 0.7, (2, 4000))
    mean, slope = 0.1, 0.15  # displacement, mm, at z = 0, and over mm of depth
    a, b = (
        np.stack([side * TAN * (own - depth_mm), np.zeros(4000), own], axis=1)
        for side, own in zip((1.0, -1.0), z, strict=True)
    )
    moves = [np.stack([mean + slope * own, 0.0 * own, 0.0 * own], axis=1) for own in z]
    moved = crossing(cameras, a + moves[0], b + moves[1]) - crossing(cameras, a, b)
    np.testing.assert_allclose(moved[:, 0], (moves[0] + moves[1])[:, 0] / 2.0, atol=1e-3)
    assert moved[:, 0].mean() == pytest.approx(mean, abs=3e-3)
    assert abs(slope * depth_mm) > 0.07  # what a particle there moves by more


FLOW = {
    "generator": "linear_flow",
    "velocity_mm_s": [100.0, 0.0, 0.0],
    "gradient_1_s": [[0.0, 0.0, 70.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
}


def dense(frames: int) -> Scene:
    """Frames of 0.12 particles per pixel in a shear of 2 voxels over the depth."""
    particles = {"generator": "uniform", "count": 600, "diameter_mm": 0.02}
    return scene_with(frames=frames, interval_s=0.001, flow=FLOW, particles=particles)


@pytest.fixture(scope="module")
def shots() -> list[Shot]:
    return list(simulate_sequence(dense(3), seed=7))


@pytest.mark.slow
@pytest.mark.parametrize("exposures", [2, 3])
def test_motion_tracking_removes_ghosts(exposures: int, shots: list[Shot]) -> None:
    shots = shots[:exposures]
    frames = [shot.observation for shot in shots]
    alone: Any = make_algorithm("block_mart", {})
    together: Any = make_algorithm("mte_mart", {"exposures": exposures, "repeats": 2})
    for shot, made in zip(shots, together.solve(ImageSequence.of(frames, 0.001)), strict=True):
        own, other = (
            score_frame(shot.observation.grid, shot.particles, shot.views, one)
            for one in (alone.solve(shot.observation), made)
        )
        assert (other["q"] or 0.0) > (own["q"] or 0.0) + 0.02
        assert (other["peak_ghost_percent"] or 0.0) < 0.6 * (own["peak_ghost_percent"] or 0.0)


@pytest.mark.slow
def test_without_repeats_it_is_block_mart(shots: list[Shot]) -> None:
    frames = [shot.observation for shot in shots[:2]]
    alone: Any = make_algorithm("block_mart", {})
    together: Any = make_algorithm("mte_mart", {"repeats": 0})
    for frame, made in zip(frames, together.solve(ImageSequence.of(frames, 0.001)), strict=True):
        np.testing.assert_array_equal(made.volume, alone.solve(frame).volume)


@pytest.mark.slow
def test_frames_are_grouped_in_order(shots: list[Shot]) -> None:
    frames = [shot.observation for shot in shots]
    order = [frames[0], frames[1], frames[2], frames[0], frames[1]]
    together: Any = make_algorithm("mte_mart", {"repeats": 1, "iterations": 2})
    five = [one.volume for one in together.solve(ImageSequence.of(order, 0.001))]
    three = [one.volume for one in together.solve(ImageSequence.of(frames, 0.001))]
    two = [one.volume for one in together.solve(ImageSequence.of(frames[:2], 0.001))]
    for found, expected in zip(five, [*three, *two], strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.slow
def test_pairs_reach_the_solver_through_both_tasks(tmp_path: Any) -> None:
    data: Dataset = generate(dense(2), tmp_path / "data", seed=7, backend="splat")
    solve("mte_mart", data, tmp_path / "volumes.h5", parameters={"repeats": 1, "iterations": 4})
    assert score(data, tmp_path / "volumes.h5")["q"] > 0.7
    windows = {"window": (24, 24, 12), "reconstruction": "mte_mart"}
    solve("piv3d", data, tmp_path / "field.h5", parameters=windows)
    assert score(data, tmp_path / "field.h5")["u_rms_voxel"] < 0.3


def test_a_single_frame_is_declined(tmp_path: Any) -> None:
    data = generate(dense(1), tmp_path / "data", seed=7, backend="splat")
    with refused("mte_mart", kind=DeclinedError):
        solve("mte_mart", data, tmp_path / "volumes.h5")
    assert not (tmp_path / "volumes.h5").exists()
