"""Volume self-calibration and its disparities."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sabench.algorithms.calibration import disparity
from sabench.api import Calibration, Observation
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.rigid_motion import fit_rigid_motion
from sabench.geometry.triangulation import triangulate
from sabench.geometry.volume_polynomials import fit_volume_polynomials, project_points
from sabench.images.peaks import find_peaks
from sabench.plugins import load
from sabench.scenes import Scene, build_rig, load_scene, parse_scene
from sabench.simulation.in_memory import Shot, simulate
from tests.helpers.refusals import check_sentence, refused


def particle_scene(shift_px: float, wall: bool = True, per_pixel: float = 0.025) -> Scene:
    values = load_scene("array-9").to_dict()
    values["cameras"] |= {"rows": 240, "columns": 240, "particle_sigma_px": 0.8}
    values["cameras"]["center_mm"] = [0.0, 0.0, -510.0]
    layout = {"kind": "grid", "columns": 3, "rows": 2, "spacing_mm": [150.0, 200.0]}
    values["cameras"]["layout"] = layout
    values["volume"] |= {"size_mm": [12.0, 12.0, 6.0]}
    values["grid"]["crop_mm"] = [1.0, 1.0, 0.0]
    values["particles"] = {"generator": "uniform", "per_pixel": per_pixel, "diameter_mm": 0.02}
    values["calibration"] = {"shift_px": shift_px}
    if wall:
        values["wall"] = {"fluid_index": 1.333, "point_mm": [0.0, 0.0, -30.0]}
        values["wall"]["layers"] = [{"index": 1.5, "thickness_mm": 5.0}]
    return parse_scene(values, "particles")


def corrected(case: Observation, **parameters: float) -> Calibration:
    plugin = load("solvers", "volume_self_calibration")
    made: Calibration = plugin(plugin.Parameters(**parameters)).solve(case)
    return made


def disagreement_px(shot: Shot, cameras: tuple[CameraModel, ...], scene: Scene) -> float:
    """Mean error, px, of true particles, without the motion of all cameras together."""
    truths = shot.particles.position_mm
    exact = np.stack([camera.project(truths)[0] for camera in build_rig(scene).cameras])
    moved = fit_rigid_motion(truths, triangulate(cameras, exact))(truths)
    again = np.stack([camera.project(moved)[0] for camera in cameras])
    return float(np.linalg.norm(again - exact, axis=-1).mean())


@pytest.mark.slow
@pytest.mark.parametrize(("shift_px", "reach_px"), [(0.0, 4.0), (8.0, 10.0)])
def test_exact_cameras_stay_and_others_are_reached(shift_px: float, reach_px: float) -> None:
    scene = particle_scene(shift_px, per_pixel=0.012)
    shot = simulate(scene, seed=4)
    assert (disagreement_px(shot, shot.observation.cameras, scene) > 1.0) == (shift_px > 0.0)
    answer = corrected(shot.observation, reach_px=reach_px)
    names = [camera.name for camera in shot.observation.cameras]
    assert [camera.name for camera in answer.cameras] == names
    assert disagreement_px(shot, answer.cameras, scene) < 0.06


@pytest.mark.slow
def test_sets_that_agree_by_chance_are_refused() -> None:
    seen = simulate(particle_scene(8.0), seed=3).observation
    with refused("reach_px"):
        corrected(seen)


@pytest.mark.slow
def test_without_room_for_all_sets_images_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = particle_scene(2.0)
    shot = simulate(scene, seed=3)
    monkeypatch.setattr(disparity, "SETS", 20_000)
    assert disagreement_px(shot, corrected(shot.observation).cameras, scene) < 0.06


def test_particle_images_are_found_to_parts_of_a_pixel() -> None:
    shot = simulate(particle_scene(0.0), seed=5)
    light = shot.observation.images[0].astype(np.float32)
    peaks = find_peaks(light / light.max(), 0.2)
    assert len(peaks.pixels) == peaks.starts[-1]
    gaps = np.linalg.norm(peaks.pixels[:, None] - shot.views[0].pixel[None], axis=2)
    assert (gaps.min(axis=1) < 0.6).mean() > 0.9
    lone = gaps.min(axis=1)[np.sort(gaps, axis=1)[:, 1] > 6.0]
    assert len(lone) > 50
    assert lone.mean() < 0.06


@pytest.mark.slow
def test_all_right_sets_are_among_those_found() -> None:
    """Every particle whose images are near their nominal positions makes a set."""
    cameras = build_rig(particle_scene(0.0)).cameras[:4]
    maps = fit_volume_polynomials(cameras, np.array([-6.0, -6.0, -3.0]), np.array([6.0, 6.0, 3.0]))
    rng = np.random.default_rng(1)
    unit = rng.uniform(-0.8, 0.8, (60, 3))
    shifts = rng.normal(0.0, 0.8, (4, 2))
    pictures = []
    for number in range(4):
        x, y = (project_points(maps, number, unit) + shifts[number]).T[:, :, None]
        across, down = (np.exp(-((np.arange(240) - at) ** 2) / 1.28) for at in (x, y))
        pictures.append(find_peaks((down.T @ across).astype(np.float32), 0.3))
    sets = disparity.find_sets(maps, tuple(pictures), 4.0)
    right = [np.abs(sets.positions - place).max(axis=1).min() for place in unit]
    assert np.mean(np.array(right) < 0.05) > 0.85


def test_the_densest_spot_is_found_among_noise() -> None:
    rng = np.random.default_rng(2)
    spot = np.array([1.2, -0.7, 0.3, 2.0, -1.5])
    values = [rng.uniform(-4.0, 4.0, (20000, 5)), spot + rng.normal(0.0, 0.1, (80, 5))]
    assert_allclose(disparity.densest(np.vstack(values)), spot, atol=0.1)


def test_nothing_to_go_by_is_said() -> None:
    seen = simulate(particle_scene(0.0), seed=1).observation
    with refused("camera_00"):
        corrected(replace(seen, images=np.full_like(seen.images, int(seen.black_dn))))
    plugin = load("solvers", "volume_self_calibration")
    two = replace(seen, images=seen.images[:2], cameras=seen.cameras[:2])
    check_sentence(plugin(plugin.Parameters()).skip(two), "3", "2")


def test_each_part_of_the_box_has_its_own_disparity() -> None:
    """Spots that grow along x and y, with a tenth of them far from any spot."""
    rng = np.random.default_rng(8)
    positions = rng.uniform(-1.0, 1.0, (9000, 3))
    third = np.minimum(((positions[:, :2] + 1.0) * 1.5).astype(int), 2)
    true = np.column_stack([0.1 * third[:, 0], 0.07 * third[:, 1]])
    errors = true + rng.normal(0.0, 0.02, true.shape)
    errors[::10] += 3.0
    rows, spots = disparity._by_parts(positions, errors, np.array([0.1, 0.07]))
    across, down = np.meshgrid([-2 / 3, 0.0, 2 / 3], [-2 / 3, 0.0, 2 / 3])
    middles = np.column_stack([np.ones(9), across.ravel(), down.ravel()])
    assert_allclose(rows, middles, atol=0.06)
    assert_allclose(spots, 0.15 * (middles[:, 1:] + 2 / 3) * [1.0, 0.7], atol=0.005)


def test_few_particles_have_one_disparity() -> None:
    positions = np.random.default_rng(8).uniform(-1.0, 1.0, (800, 3))
    rows, spots = disparity._by_parts(positions, np.zeros((800, 2)), np.array([0.1, 0.2]))
    assert_array_equal(rows, [[1.0]])
    assert_array_equal(spots, [[0.1, 0.2]])


def test_a_step_is_the_least_squares_solution() -> None:
    rng = np.random.default_rng(6)
    for cameras in (2, 3, 5):
        slopes, misses = rng.normal(size=(cameras, 2, 3)), rng.normal(size=(cameras, 2))
        gains, step = np.zeros((cameras, 2, 3)), np.zeros(3)
        assert disparity._gains(slopes, cameras, gains)
        disparity._compute_step(gains, misses, cameras, step)
        expected = np.linalg.lstsq(slopes.reshape(-1, 3), misses.ravel(), rcond=None)[0]
        assert_allclose(step, expected, rtol=1e-9)


def test_parallel_lines_of_sight_have_no_solution() -> None:
    slopes = np.tile(np.array([[1.0, 0.0, 0.2], [0.0, 1.0, -0.1]]), (3, 1, 1))
    assert not disparity._gains(slopes, 3, np.zeros((3, 2, 3)))
