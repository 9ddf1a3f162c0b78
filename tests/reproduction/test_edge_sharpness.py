"""Sharpness of a checkerboard's edges against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from reproduction.chapter_6_grid import measure_sharpness
from sabench.utils.arrays import F64

PITCH_MM = 4.0


def blurred(sigma_px: float, pitch_px: float = 40.0, turn_deg: float = 3.0) -> tuple[F64, F64]:
    """Draw a checkerboard under a Gaussian blur of straight edges, and its corners."""
    angle = np.deg2rad(turn_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = np.array([170.0, 150.0])
    steps = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 2)), axis=-1)
    y, x = np.mgrid[0:300, 0:340]
    own = (np.stack([x, y], axis=-1) - middle) @ turn / pitch_px

    def wave(along: F64) -> F64:
        jumps = np.arange(-8, 9)
        signs = (-1.0) ** jumps
        width = np.sqrt(2.0) * sigma_px / pitch_px
        return np.asarray(np.sum(signs * erf((along[..., None] - jumps) / width), axis=-1))

    return 100.0 + 50.0 * wave(own[..., 0]) * wave(own[..., 1]), steps * pitch_px @ turn.T + middle


@pytest.mark.parametrize("sigma_px", [0.8, 1.5, 3.0])
def test_a_gaussian_blur_has_the_width_and_contrast_of_its_closed_form(sigma_px: float) -> None:
    image, corners = blurred(sigma_px)
    found = measure_sharpness(image, corners, PITCH_MM)
    sigma_mm = sigma_px * PITCH_MM / 40.0
    assert found.width_mm == pytest.approx(2.563 * sigma_mm, rel=0.03)
    assert found.mtf50 == pytest.approx(np.sqrt(np.log(2.0) / 2.0) / np.pi / sigma_mm, rel=0.03)


def test_light_and_displaced_edges_are_no_blur() -> None:
    image, corners = blurred(1.5)
    straight = measure_sharpness(image, corners, PITCH_MM)
    uneven = image * np.linspace(1.0, 1.3, image.shape[1])
    moved = measure_sharpness(uneven, corners + 1.2, PITCH_MM)
    assert moved.width_mm == pytest.approx(straight.width_mm, rel=0.03)
    assert moved.mtf50 == pytest.approx(straight.mtf50, rel=0.03)


def test_an_average_of_displaced_images_is_blurred() -> None:
    image, corners = blurred(1.0)
    mixed = (image + np.roll(image, 3, axis=1) + np.roll(image, 3, axis=0)) / 3.0
    sharp, dull = (measure_sharpness(own, corners, PITCH_MM) for own in (image, mixed))
    assert dull.width_mm > 1.5 * sharp.width_mm
    assert dull.mtf50 < 0.8 * sharp.mtf50
