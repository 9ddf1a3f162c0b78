"""Discs in front of the wall: their shadow in the truth and in both renderers."""

import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import sabench
from sabench.geometry.camera import Camera
from sabench.geometry.occluders import Disc
from sabench.geometry.refraction import trace_to_points
from sabench.metrics.reconstruction_error import true_field
from sabench.scenes import Scene, build_rig, parse_scene
from sabench.simulation.in_memory import Shot, simulate
from sabench.simulation.rendering import particles_splatted
from sabench.simulation.rendering.particle_images import image_particles
from sabench.simulation.rendering.particles_traced import render
from sabench.utils.arrays import F64, Bool
from tests.helpers.particle_scenes import VARIANTS, cloud, isolated, make_scene, moments

QUICK = build_rig(make_scene()).cameras[0]


def with_discs(scene: Scene, *discs: dict[str, Any]) -> Scene:
    return parse_scene(scene.to_dict() | {"occluders": list(discs)}, "test")


def before_camera(camera: Camera, share: float, radius_mm: float, **more: Any) -> dict[str, Any]:
    """A disc on the optical axis, at `share` of the distance to the quick scene's wall (z = 0)."""
    start, forward = np.asarray(camera.center_mm), np.asarray(camera.rotation[2])
    return {
        "center_mm": (start - forward * (share * start[2] / forward[2])).tolist(),
        "radius_mm": radius_mm,
        **more,
    }


def test_truth_lies_in_the_shadow_that_snell_gives() -> None:
    disc = before_camera(QUICK, 0.6, 2.0)
    scene = with_discs(make_scene(), disc)
    positions = np.random.default_rng(1).uniform([-7.0, -5.0, 28.0], [7.0, 5.0, 32.0], (400, 3))
    images = image_particles(scene, QUICK, cloud(positions), None, build_rig(scene).occluders)
    open_images = image_particles(scene, QUICK, cloud(positions), None)
    start, depth = np.asarray(QUICK.center_mm), disc["center_mm"][2]
    leaving = trace_to_points(QUICK.wall, start, positions).leaving
    met = start + leaving * ((depth - start[2]) / leaving[:, 2:])
    hidden = np.linalg.norm(met - disc["center_mm"], axis=1) <= 2.0
    assert 50 < hidden.sum() < 350
    assert_array_equal(images.photons == 0.0, hidden)
    assert_array_equal(images.visible, open_images.visible & ~hidden)
    assert_array_equal(images.photons[~hidden], open_images.photons[~hidden])
    assert_array_equal(images.pixel, open_images.pixel)


def unit(ways: F64) -> F64:
    return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))


def outline(camera: Camera, disc: Disc) -> F64:
    """The disc's edge on the image, as a polygon (n, 2)."""
    across = np.cross(disc.normal, np.eye(3)[int(np.argmin(np.abs(disc.normal)))])
    across /= np.linalg.norm(across)
    turn = np.linspace(0.0, 2.0 * np.pi, 721)[:-1, None]
    edge = disc.center_mm + disc.radius_mm * (
        np.cos(turn) * across + np.sin(turn) * np.cross(disc.normal, across)
    )
    return camera.pixels_of(unit(edge - camera.center_mm), np.ones(len(edge), dtype=np.bool_))[0]


def distance_inside(polygon: F64, pixels: F64) -> F64:
    """Distance of pixels (n, 2) from a convex polygon's border, px, positive inside."""
    side = np.roll(polygon, -1, axis=0) - polygon
    normal = unit(np.stack([-side[:, 1], side[:, 0]], axis=1))
    towards = np.sum(normal * (polygon.mean(axis=0) - polygon), axis=1, keepdims=True)
    inward = normal * np.sign(towards)
    return np.asarray(np.min(np.sum((pixels[:, None] - polygon) * inward, axis=2), axis=1))


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
def test_both_renderers_agree_away_from_the_edge(variant: str) -> None:
    plain = make_scene(**VARIANTS[variant])
    camera = build_rig(plain).cameras[1]
    scene = with_discs(plain, before_camera(camera, 0.4, 0.9, normal=[0.4, -0.3, 1.0]))
    occluders = build_rig(scene).occluders
    positions, pixels = isolated(camera, (29.0, 31.0), 13, 2)
    images = image_particles(scene, camera, cloud(positions), None, occluders)
    inside = distance_inside(outline(camera, occluders[0]), images.pixel)
    away = np.abs(inside) > 8.0
    assert min((away & (inside > 0.0)).sum(), (away & (inside < 0.0)).sum()) >= 5
    assert_array_equal(images.visible, inside < 0.0)
    light = render(camera, images, positions, 16, occluders) * camera.etendue()
    traced = moments(light + 1e-12, pixels, 6)[0]
    formula = moments(particles_splatted.render(camera, images) + 1e-12, pixels, 6)[0]
    assert_allclose(traced[away], formula[away], rtol=0.02)
    assert (formula[away & (inside > 0.0)] < 1e-9).all()


@pytest.mark.slow
def test_rays_cut_an_image_at_the_very_edge_of_a_disc() -> None:
    """Also images of particles whose own path is stopped."""
    wide = make_scene(cameras={"particle_sigma_px": 2.0})
    scene = with_discs(wide, before_camera(QUICK, 0.3, 0.5))
    discs = build_rig(scene).occluders
    polygon = outline(QUICK, discs[0])
    edge = QUICK.back_project(polygon[::30] + np.random.default_rng(5).uniform(-2.0, 2.0, (24, 2)))
    positions = edge.origins_mm + edge.directions * 25.0
    images, open_images = (
        image_particles(scene, QUICK, cloud(positions), None, occluders)
        for occluders in (discs, ())
    )
    whole = render(QUICK, open_images, positions, 9)
    cut = render(QUICK, images, positions, 9, discs)
    row, column = np.mgrid[: QUICK.rows, : QUICK.columns]
    every = np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)
    inside = distance_inside(polygon, every).reshape(row.shape)
    assert 4 < images.visible.sum() < 20
    assert (whole > 0.0).sum() > 500
    assert_array_equal(cut[inside < -1.0], whole[inside < -1.0])
    assert not cut[inside > 1.0].any()
    assert whole[inside > 1.0].max() > 0.2 * whole.max()


def shot_of(*discs: dict[str, Any]) -> Shot:
    scene = make_scene(particles={"count": 200})
    return simulate(with_discs(scene, *discs) if discs else scene, seed=4)


@pytest.mark.slow
def test_a_covered_camera_is_black_and_the_others_see_what_they_saw() -> None:
    free, covered = shot_of(), shot_of(before_camera(QUICK, 0.5, 30.0))
    assert not covered.views[0].photons.any()
    assert not covered.views[0].visible.any()
    assert covered.observation.images[0].max() < free.observation.images[0].max() / 10
    assert_array_equal(covered.observation.images[1:], free.observation.images[1:])
    for mine, theirs in zip(covered.views[1:], free.views[1:], strict=True):
        assert_array_equal(mine.photons, theirs.photons)


@pytest.mark.slow
def test_the_true_field_keeps_particles_that_one_camera_misses() -> None:
    shot = shot_of(before_camera(QUICK, 0.5, 1.2))
    hidden = shot.views[0].photons == 0.0
    assert 20 < hidden.sum() < 180
    field = true_field(shot.observation.grid, shot.particles, shot.views)
    x, y, z = np.rint(shot.observation.grid.to_voxels(shot.particles.position_mm)).astype(int).T
    places = np.stack([z, y, x])
    inside = ((places >= 0) & (field.shape > places.T).T).all(axis=0)
    values = field[tuple(places[:, inside])]
    assert np.isfinite(field).all()
    assert values.min() > 0.2 * np.median(values)


def all_stopped(disc: Disc, *directions: tuple[float, float, float]) -> Bool:
    return disc.stops(np.zeros(3), unit(np.array(directions)))


def test_a_disc_stops_what_meets_it() -> None:
    flat, along = Disc((0.0, 0.0, 10.0), (0.0, 0.0, 1.0), 1.0), (0.0, 0.0, 1.0)
    assert all_stopped(flat, along, (0.099, 0.0, 1.0)).all()
    away = (0.101, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (math.nan,) * 3
    assert not all_stopped(flat, *away).any()
    edge_on = Disc((0.0, 0.0, 10.0), (1.0, 0.0, 0.0), 1.0)
    assert not all_stopped(edge_on, along, (1e-9, 0.0, 1.0)).any()
    assert flat.span_mm(np.array(along)) == (10.0, 10.0)
    assert edge_on.span_mm(np.array(along)) == (9.0, 11.0)


@pytest.mark.slow
def test_occluders_are_in_the_scene_file_and_are_not_shown_to_solvers(tmp_path: Path) -> None:
    plain = make_scene(particles={"count": 20})
    scene = with_discs(plain, before_camera(QUICK, 0.5, 0.7))
    free, made = (
        sabench.generate(one, tmp_path / name, backend="splat", name="s")
        for one, name in ((plain, "free"), (scene, "made"))
    )
    assert (made.root / "cameras.json").read_bytes() == (free.root / "cameras.json").read_bytes()
    table = tomllib.loads((made.root / "scene.toml").read_text())
    assert table["occluders"] == scene.to_dict()["occluders"]
    assert "occluders" not in tomllib.loads((free.root / "scene.toml").read_text())
    (made.root / "scene.toml").unlink()
    (made.root / "truth.h5").unlink()
    sabench.solve("msa", made, tmp_path / "r.h5")
