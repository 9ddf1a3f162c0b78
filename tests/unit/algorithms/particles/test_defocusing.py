"""Triangles of defocusing digital PIV, against the cameras' own projection."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sabench.algorithms.particles import defocusing
from sabench.api import Camera, ImageSequence
from sabench.api.make import make_algorithm
from sabench.evaluation.suite_loading import override
from sabench.geometry.grid import Grid
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Layer, Wall
from sabench.geometry.rigid_motion import rotation_matrices
from sabench.geometry.triangulation import triangulate
from sabench.images.peaks import sort_peaks
from sabench.scenes import build_rig, load_scene
from sabench.simulation.in_memory import Shot, simulate
from sabench.utils.arrays import F64, triple
from tests.helpers.refusals import check_sentence
from tests.helpers.small_particles import count_found, make_small, rotate_cameras

SCENE = load_scene("ddpiv-100x100x100")
RIG = build_rig(SCENE)
APERTURES = defocusing.Apertures.of(RIG.cameras)


def superimposed(
    images: Any, cameras: Any = RIG.cameras, apertures: defocusing.Apertures = APERTURES
) -> F64:
    pairs = zip(cameras, images, strict=True)
    return np.stack([apertures.superimpose(*pair) for pair in pairs], axis=1)


WALL = Wall((0.0, 0.0, -60.0), (0.0, 0.0, 1.0), 1.0, (Layer("glass", 1.5, 6.0),), 1.333)


def rows_of(matrix: F64) -> Any:
    return tuple(triple(row) for row in matrix)


def points(count: int, seed: int = 1) -> F64:
    return np.random.default_rng(seed).uniform(-50.0, 50.0, (count, 3))


def images_of(world: F64, cameras: tuple[Camera, ...] = RIG.cameras) -> list[F64]:
    return [camera.project(world)[0] for camera in cameras]


def test_images_are_triangles_of_one_orientation_that_grow_towards_the_apertures() -> None:
    world = np.array([[5.0, -3.0, z] for z in (-40.0, 0.0, 40.0)])
    a, b, c = superimposed(images_of(world)).transpose(1, 0, 2)
    sides = np.stack([b - a, c - b, a - c], axis=1)
    lengths = np.linalg.norm(sides, axis=2)
    assert np.ptp(lengths, axis=1).max() < 0.02  # the scene's numbers are rounded
    third = np.array([[-0.5, -np.sqrt(0.75)], [np.sqrt(0.75), -0.5]])
    assert sides[:, 0] @ third.T == pytest.approx(sides[:, 1], abs=0.02)
    depth = world[:, 2] + 700.0
    assert lengths[:, 0] == pytest.approx(APERTURES.focal_px * 100.0 / depth, abs=0.02)
    assert sides[:, 0] / lengths[:, :1] == pytest.approx(np.array([[-1.0, 0.0]] * 3), abs=1e-9)


def test_positions_from_exact_images_are_exact_and_those_of_least_squares() -> None:
    world = points(50)
    images = np.array(images_of(world))
    found, off = APERTURES.locate(superimposed(images))
    assert found == pytest.approx(world, abs=1e-6)
    assert off.max() < 1e-6
    noisy = images + np.random.default_rng(2).normal(0.0, 0.1, images.shape)
    found, off = APERTURES.locate(superimposed(noisy))
    assert found == pytest.approx(triangulate(RIG.cameras, noisy), abs=0.02)
    assert 0.05 < np.median(off) < 0.3


def test_triplets_of_exact_images_are_found_and_no_others() -> None:
    world = points(2000)
    shape = RIG.cameras[0].rows, RIG.cameras[0].columns
    peaks = tuple(sort_peaks(own, shape) for own in images_of(world))
    found = defocusing.match_triangles(APERTURES, RIG.cameras, peaks, RIG.grid, 0.02)
    near = np.linalg.norm(found.position[:, None] - world[None], axis=2).min(axis=1)
    assert (near < 1e-6).sum() == 2000
    assert len(found.position) < 2060  # by chance


def test_distorted_lenses_and_apertures_turned_in_the_world_change_nothing() -> None:
    turn = rotation_matrices(np.array([[0.3, -0.2, 0.5]]))[0]
    turned = tuple(
        replace(camera, distortion=Distortion(k1=-0.05))
        for camera in rotate_cameras(RIG.cameras, turn)
    )
    world, apertures = 0.5 * points(40) @ turn.T, defocusing.Apertures.of(turned)
    images = superimposed(images_of(world, turned), turned, apertures)
    assert apertures.locate(images)[0] == pytest.approx(world, abs=1e-6)


def sparse_shot(seed: int = 3) -> Shot:
    values: dict[str, Any] = {"particles.count": 60, "cameras.rows": 256, "cameras.columns": 256}
    values |= {"cameras.pixel_mm": 0.04, "grid.voxel_mm": [0.46, 0.46, 3.2]}
    each = [
        {"camera": own.name, "principal_point_px": [127.5 + (x - 511.5) / 4 for x in middle]}
        for own in RIG.cameras
        for middle in [own.principal_point_px]
    ]
    return simulate(override(SCENE, values | {"cameras.each": each}, "sparse"), seed=seed)


def test_particles_of_images_are_those_of_ray_triangulation() -> None:
    shot = sparse_shot()
    found: Any = defocusing.find_by_defocusing(shot.observation)
    counts = count_found(shot, found)
    assert counts.recall > 0.85
    assert counts.precision > 0.97
    assert found.intensity.min() > 0.2


def test_empty_images_have_no_particles() -> None:
    case = sparse_shot().observation
    dark = replace(case, images=np.zeros_like(case.images))
    assert len(defocusing.find_by_defocusing(dark).position_mm) == 0


def moved(number: int, **changes: Any) -> tuple[Camera, ...]:
    cameras = list(RIG.cameras)
    cameras[number] = replace(cameras[number], **changes)
    return tuple(cameras)


TILTED = rows_of(rotation_matrices(np.array([[0.0, np.radians(5.0), 0.0]]))[0])


LINE = [replace(RIG.cameras[0], center_mm=(x, 0.0, -700.0)) for x in (0.0, 50.0, 100.0)]
BEHIND = replace(RIG.grid, low_mm=(*RIG.grid.low_mm[:2], -800.0))


@pytest.mark.parametrize(
    ("cameras", "grid", "keys"),
    [
        (RIG.cameras[:2], RIG.grid, ["2"]),
        (moved(1, wall=WALL), RIG.grid, ["camera_01"]),
        (moved(0, center_mm=(0.0, -120.0, -700.0)), RIG.grid, ["100, 157 and 157"]),
        (moved(0, rotation=TILTED), RIG.grid, ["camera_00", "5.0"]),
        (LINE, RIG.grid, ["50, 50 and 100"]),
        (RIG.cameras, BEHIND, []),
    ],
)
def test_other_cameras_are_refused_in_one_sentence(cameras: Any, grid: Grid, keys: Any) -> None:
    assert defocusing.find_unsuitable(RIG.cameras, RIG.grid) is None
    check_sentence(defocusing.find_unsuitable(cameras, grid) or "", *keys)


def test_the_solver_declines_four_cameras() -> None:
    solver: Any = make_algorithm("ddpiv", {})
    check_sentence(solver.skip(ImageSequence.of([make_small(1).observation])), "4")
