"""Particles before small cameras, moments of their images, and both renderers' pictures."""

import tomllib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sabench.api.truth import Particles
from sabench.geometry.camera import Camera, aim
from sabench.scenes import Scene, build_rig, find, parse_scene
from sabench.scenes.focusing import focus
from sabench.simulation.rendering import particles_splatted
from sabench.simulation.rendering.particle_images import ParticleImages, image_particles
from sabench.simulation.rendering.particles_traced import render
from sabench.utils.arrays import F64, I64
from tests.helpers.cameras import ALONG_Z, make_camera


def make_scene(**changes: dict[str, Any] | None) -> Scene:
    values = tomllib.loads(find("quick", "scenes").read_text(encoding="utf-8"))
    values["cameras"] |= {"rows": 110, "columns": 170}
    values["illumination"] |= {"pulse_energy_mj": 20.0, "thickness_mm": 30.0}
    values["illumination"] |= {"height_mm": 20.0, "scattering": "isotropic"}
    for table, update in changes.items():
        if update is None:
            del values[table]
        else:
            values[table] = update if "shape" in update else values[table] | update
    return parse_scene(values, "test")


def cloud(positions: F64, diameter_mm: float | F64 = 0.02) -> Particles:
    count = len(positions)
    return Particles(np.arange(count), positions, np.full(count, diameter_mm), np.zeros((count, 3)))


TILT = {
    "normal": [0.3, -0.2, 1.0],
    "layers": [
        {"name": "glass", "index": 1.52, "thickness_mm": 5.0},
        {"name": "gel", "index": 1.4, "thickness_mm": 3.0},
    ],
}
ROUND = {
    "shape": "cylinder",
    "axis_point_mm": [2.0, 0.0, 45.0],
    "axis": [0.1, 1.0, 0.05],
    "outer_radius_mm": 40.0,
    "layers": TILT["layers"],
    "fluid_index": 1.333,
}
VARIANTS: dict[str, dict[str, dict[str, Any] | None]] = {
    "flat": {},
    "tilted": {"wall": TILT},
    "distorted": {
        "cameras": {"distortion": {"k1": -60.0, "k2": 2000.0, "p1": 0.3, "p2": -0.2, "k3": 0.0}}
    },
    "air": {"wall": None},
    "round": {"wall": ROUND},
    "wide-open": {"cameras": {"f_number": 2.0}},
}


def spots(pixels: F64, photons: F64, sigma: F64) -> ParticleImages:
    count = len(pixels)
    zero, seen = np.zeros((count, 3)), np.asarray(np.isfinite(pixels).all(axis=1))
    spread = sigma[:, None] ** 2 * [1.0, 1.0, 0.0]
    return ParticleImages(pixels, photons, sigma, seen, np.zeros(count), zero, spread)


SMALL = make_camera(
    rows=40,
    columns=60,
    center_mm=(0.0, 0.0, 0.0),
    rotation=ALONG_Z,
    principal_distance_mm=50.0,
    principal_point_px=(29.5, 19.5),
    focal_length_mm=50.0,
)


def isolated(
    camera: Camera, depth_mm: tuple[float, float], pitch: int, seed: int
) -> tuple[F64, I64]:
    """Return particles whose images lie on a jittered lattice, and the lattice's pixels."""
    rng = np.random.default_rng(seed)
    column, row = np.meshgrid(
        np.arange(pitch, camera.columns - pitch, pitch),
        np.arange(pitch, camera.rows - pitch, pitch),
    )
    pixels = np.column_stack([column.ravel(), row.ravel()])
    rays = camera.back_project(pixels + rng.uniform(-1.0, 1.0, pixels.shape))
    z = rng.uniform(*depth_mm, len(pixels))
    return rays.origins_mm + rays.directions * (
        (z - rays.origins_mm[:, 2]) / rays.directions[:, 2]
    )[:, None], pixels


def moments(image: F64, pixels: I64, half: int) -> tuple[F64, F64]:
    """Light and centroid offset (n, 2) in windows around pixels (column, row)."""
    offset = np.arange(-half, half + 1)
    windows = image[pixels[:, 1, None, None] + offset[:, None], pixels[:, 0, None, None] + offset]
    light = windows.sum(axis=(1, 2))
    return light, np.stack(
        [windows.sum(axis=1) @ offset, windows.sum(axis=2) @ offset], axis=1
    ) / light[:, None]


def assert_same_picture(scene: Scene, camera: Camera, positions: F64, pixels: I64) -> None:
    """Compare light and centroids of isolated particles between both renderers."""
    images = image_particles(scene, camera, cloud(positions), None)
    traced = moments(render(camera, images, positions, 16) * camera.etendue(), pixels, 6)
    formula = moments(particles_splatted.render(camera, images), pixels, 6)
    shift = traced[1] - formula[1]
    assert np.abs(shift.mean(axis=0)).max() < 0.01
    assert np.abs(shift).max() < 0.02
    np.testing.assert_allclose(traced[0], formula[0], rtol=0.02)
    assert traced[0].sum() == pytest.approx(formula[0].sum(), rel=5e-3)


def oblique_camera(f_number: float) -> tuple[Scene, Camera]:
    """A camera at 45 degrees to the wall, whose refraction is strongly astigmatic."""
    scene = make_scene(cameras={"f_number": f_number}, illumination={"thickness_mm": 1e4})
    camera = build_rig(scene).cameras[0]
    camera = replace(camera, center_mm=(-330.0, -330.0, -440.0))
    turned = aim(camera, np.array([0.0, 0.0, 200.0]))
    return scene, focus(turned, np.array([0.0, 0.0, 200.0]), None)
