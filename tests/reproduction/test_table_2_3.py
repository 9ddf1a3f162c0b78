"""Table 2.3: arrays from the literature."""

from __future__ import annotations

import pytest

from reproduction import chapter_2_efficiency
from reproduction.common import coarsen
from sabench.scenes import build_rig, load_scene


def test_arrays_hold_as_many_particles_a_pixel_as_the_thesis_says() -> None:
    for name, per_total, per_px, scene in chapter_2_efficiency._tomographic_scenes():
        row = chapter_2_efficiency._efficiency(name, per_total, per_px, scene)
        assert row.verdict == "reproduced", name
        spec = scene.particle_world.particles["per_pixel"]
        cameras, grid = scene.cameras, build_rig(scene).grid
        count = spec * cameras.rows * cameras.columns
        assert count / (grid.shape[1] * grid.shape[2]) == pytest.approx(per_px)
    for _, per_total, scene, _ in chapter_2_efficiency._particle_scenes():
        pixels = scene.cameras.rows * scene.cameras.columns
        count = scene.particle_world.particles["count"]
        assert count / pixels / 3 == pytest.approx(per_total, abs=0.0005)


def test_cut_images_hold_the_cut() -> None:
    for name, _, _, scene in list(chapter_2_efficiency._tomographic_scenes())[1:]:
        size = [edge / 2.0 for edge in scene.volume.size_mm]
        for camera in build_rig(scene).cameras:
            corners = [
                [x, y, z]
                for x in (-size[0], size[0])
                for y in (-size[1], size[1])
                for z in (-size[2], size[2])
            ]
            seen = camera.contains(camera.project(corners)[0], margin_px=25.0)
            assert seen.mean() > 0.7, name


def test_a_coarse_copy_keeps_density_and_shifted_sensors() -> None:
    scene = load_scene("ddpiv-100x100x100")
    coarse = coarsen(scene, 256)
    assert coarse.particle_world.particles["count"] == 2500
    for one, other in zip(build_rig(scene).cameras, build_rig(coarse).cameras, strict=True):
        fine = one.project([[30.0, -20.0, 10.0]])[0]
        assert other.project([[30.0, -20.0, 10.0]])[0] == pytest.approx((fine + 0.5) / 4 - 0.5)


def test_images_that_do_not_overlap_make_all_particles() -> None:
    scene = coarsen(load_scene("ddpiv-100x100x100"), 128)
    rows = list(chapter_2_efficiency._particle_solvers("small", scene, ("ddpiv",), [1, 2]))
    by_name = {row.name: row.measured for row in rows}
    assert by_name["small: ddpiv, images apart, 0 px noise: true %"] == pytest.approx(100.0)
    noisy = by_name["small: ddpiv, images apart, 0.2 px noise: true %"]
    found = by_name["small: ddpiv: true %"]
    assert noisy is not None
    assert found is not None
    assert 20.0 < found < noisy
