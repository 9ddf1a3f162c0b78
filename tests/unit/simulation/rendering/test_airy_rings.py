"""Rings around images against Airy's pattern, integrated over pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import j0, j1

from sabench.geometry.camera import Camera
from sabench.scenes import build_rig
from sabench.simulation import camera_view
from sabench.simulation.frames import Frames
from sabench.simulation.rendering import particles_splatted
from sabench.simulation.rendering.particle_images import diffraction_px
from sabench.simulation.rendering.particles_splatted import render_with_rings
from sabench.utils.arrays import F64
from tests.helpers.particle_scenes import SMALL, make_scene, spots

LARGE = replace(SMALL, rows=120, columns=140, principal_point_px=(69.5, 59.5), f_number=16.0)


def airy(place: F64, shape: tuple[int, int]) -> F64:
    """Integrate the pattern over pixels, by 15 x 15 points in each."""
    fine = ((np.arange(15) + 0.5) / 15 - 0.5)[:, None, None, None]
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    radius = np.hypot(columns - place[0] + fine, rows - place[1] + fine.reshape(1, 15, 1, 1))
    x = np.pi * np.maximum(radius, 1e-9) * LARGE.pixel_mm / (532e-6 * 16.0)
    share = (np.pi * LARGE.pixel_mm / (532e-6 * 16.0)) ** 2 / (4.0 * np.pi)
    return np.asarray(((2.0 * j1(x) / x) ** 2).mean(axis=(0, 1)) * share)


def picture(place: tuple[float, float], sigma: float) -> F64:
    """Render a point of that width, in px, and the rings around it."""

    def render(camera: Camera) -> F64:
        fine = SMALL.pixel_mm / camera.pixel_mm
        pixel, width = (np.array(place) + 0.5) * fine - 0.5, np.array([sigma * fine])
        return particles_splatted.render(camera, spots(pixel[None], np.array([1000.0]), width))

    return render_with_rings(LARGE, 532.0, render)


@pytest.mark.parametrize("place", [(69.5, 59.5), (70.13, 58.84), (68.0, 60.0)])
def test_the_image_of_a_point_is_airy_s_pattern(place: tuple[float, float]) -> None:
    found = picture(place, diffraction_px(LARGE, 532.0))
    expected = 1000.0 * airy(np.array(place), found.shape)
    assert np.abs(found - expected).max() < 0.01 * expected.max()
    rows, columns = np.mgrid[:120, :140]
    radius = np.hypot(columns - place[0], rows - place[1])
    for ring in (3.0, 5.0, 10.0, 20.0):
        assert found[radius > ring].sum() == pytest.approx(
            expected[radius > ring].sum(), rel=0.05, abs=6.0
        )


def test_four_to_eight_hundredths_of_the_light_are_far_away() -> None:
    image = picture((69.5, 59.5), diffraction_px(LARGE, 532.0)) / 1000.0
    rows, columns = np.mgrid[:120, :140]
    near = image[np.hypot(columns - 69.5, rows - 59.5) <= 5.0].sum()
    x = np.pi * 5.0 * LARGE.pixel_mm / (532e-6 * 16.0)
    assert near == pytest.approx(1.0 - j0(x) ** 2 - j1(x) ** 2, abs=3e-3)
    assert 0.03 < 1.0 - near < 0.08


def test_a_wide_image_stays_nearly_as_it_is() -> None:
    point = spots(np.array([[69.5, 59.5]]), np.array([1000.0]), np.array([6.0]))
    image, found = particles_splatted.render(LARGE, point), picture((69.5, 59.5), 6.0)
    assert np.abs(found - image).max() < 0.06 * image.max()
    assert found.sum() == pytest.approx(image.sum(), rel=0.05)


def test_both_renderers_add_the_rings() -> None:
    scene = make_scene(cameras={"airy_rings": True}, particles={"count": 6})
    plain = make_scene(particles={"count": 6})
    rig, found = build_rig(scene), []
    for each, renderer in ((scene, "mitsuba"), (scene, "splat"), (plain, "splat")):
        view = camera_view.render(Frames(each, rig, 1, renderer).at(0), 0)
        found.append(view.photons)
    traced, splatted, gaussian = found
    assert np.abs(traced - splatted).max() < 0.03 * splatted.max()
    assert traced.sum() == pytest.approx(splatted.sum(), rel=0.02)
    dark = gaussian < 1e-6 * gaussian.max()
    assert gaussian[dark].sum() < 1e-4 * gaussian.sum()
    assert splatted[dark].sum() > 0.01 * splatted.sum()
