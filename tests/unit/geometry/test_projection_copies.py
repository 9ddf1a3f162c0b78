"""Copies of the projection against the reference."""

import runpy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.algorithms.bubbles.backlit_images import reflectance
from sabench.geometry.camera import Camera, aimed_rotation
from sabench.geometry.lens import UPRIGHT, Distortion
from sabench.geometry.refraction import Layer, Wall, transmittance
from sabench.utils import backend
from tests.architecture.plan import ROOT

LENS = Distortion(k1=-0.4, k2=3.0, p1=0.004, p2=-0.003, k3=20.0)
NORMAL = (0.6 / 7.0, -0.4 / 7.0, np.sqrt(49.0 - 0.52) / 7.0)
WALL = Wall((1.0, 2.0, 3.0), NORMAL, 1.0, (Layer("glass", 1.52, 5.0), Layer("gap", 1.1, 2.0)), 1.33)


def camera(wall: Wall | None) -> Camera:
    """A camera at an angle, with all five coefficients of distortion."""
    rotation = aimed_rotation(np.array([0.05, -0.1, 1.0]))
    center, middle = (-20.0, 40.0, -490.0), (160.0, 118.0)
    return Camera("one", 240, 320, center, rotation, 88.0, 0.01, middle, LENS, 85.0, 16.0, wall)


def record(one: Camera) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """A camera and its wall as cameras.json has them."""
    names = ["center_mm", "rotation", "principal_distance_mm", "pixel_mm", "principal_point_px"]
    own = {name: getattr(one, name) for name in names} | {"distortion": vars(one.distortion)}
    if one.tilt_deg != UPRIGHT:
        own["tilt_deg"] = list(one.tilt_deg)
    if one.wall is None:
        return own, None
    wall = vars(one.wall) | {"layers": [vars(layer) for layer in one.wall.layers]}
    return own, wall


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (8.0, -11.0)])
@pytest.mark.parametrize("wall", [None, WALL])
def test_the_example_program_projects(wall: Wall | None, tilt: tuple[float, float]) -> None:
    example = runpy.run_path(str(ROOT / "examples" / "python" / "synthetic_aperture.py"))
    points = np.random.default_rng(1).uniform([-8.0, -6.0, 20.0], [8.0, 6.0, 40.0], (200, 3))
    one = replace(camera(wall), tilt_deg=tilt)
    exact, valid = one.project(points)
    column, row = example["project"](*record(one), points)
    assert valid.all()
    assert_allclose(np.column_stack([column, row]), exact, rtol=0.0, atol=1e-8)


def test_renderers_undistort_as_cameras_do() -> None:
    backend.mitsuba()
    from sabench.simulation.rendering.camera_rays import undistort_rays

    one = camera(None)
    pixels = np.random.default_rng(2).uniform([0.0, 0.0], [319.0, 239.0], (500, 2))
    ideal, valid = one.ideal(pixels)
    u, v = ((pixels - np.asarray(one.principal_point_px)) / one.focal_px).T
    found = np.column_stack(undistort_rays(LENS, u, v))
    assert valid.all()
    assert_allclose(found * one.focal_px, ideal * one.focal_px, rtol=0.0, atol=1e-5)


@pytest.mark.parametrize("index", [0.75, 1.0, 1.5])
def test_bubbles_reflect_as_walls_do(index: float) -> None:
    """One interface: what the wall does not transmit."""
    angle = np.linspace(0.0, 0.8, 9)
    surface = Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0, (), index)
    directions = np.column_stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)])
    refracted = np.arcsin(np.sin(angle) / index)
    expected = 1.0 - transmittance(surface, np.array([0.0, 0.0, -1.0]), directions)
    assert_allclose(reflectance(angle, refracted, index), expected, atol=1e-12)
