"""Spheroids fitted to shadows, and the transmission through their ellipses."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.algorithms.bubbles import backlit_images, rim_fit
from sabench.algorithms.bubbles.backlit_images import Profile
from sabench.simulation.rendering.pixel_truth import outlines
from sabench.utils.arrays import F64
from tests.helpers.particle_box import CAMERAS, COLUMNS, ROWS
from tests.unit.simulation.rendering.test_bubbles_traced import bubbles

PROFILE = Profile.tabulate(1.0 / 1.333, 0.4, 0.8)
PLACE = np.array([0.5, -0.4, 36.0])
SHAPE = (4, ROWS, COLUMNS)


def model_of(*shown: F64) -> rim_fit.RimModel:
    model = rim_fit.RimModel(
        np.ones(SHAPE, np.float32), np.zeros(SHAPE, np.float32), CAMERAS, PROFILE
    )
    for one in shown:
        rim_fit.darken(model, one, 1.0)
    return rim_fit.RimModel(np.exp(model.logs), np.zeros(SHAPE, np.float32), CAMERAS, PROFILE)


@pytest.mark.slow_but_first
@pytest.mark.parametrize("radius_mm", [0.15, 1.0])
def test_a_ball_darkens_pixels_by_its_profile_inside_its_outline(radius_mm: float) -> None:
    """Radii in all directions are those of the outline that refracted lines of sight touch."""
    images = model_of(rim_fit.start_of(PLACE, radius_mm)).images
    ball = bubbles([PLACE.tolist()], [[radius_mm] * 3])
    row, column = np.mgrid[0:ROWS, 0:COLUMNS]
    for image, lens in zip(images, CAMERAS, strict=True):
        middle, _ = lens.project(PLACE[None])
        x, y = outlines(lens, ball, middle)[0].T - middle[0][:, None]
        across, down = column - middle[0, 0], row - middle[0, 1]
        distance, angle = np.hypot(across, down), np.arctan2(down, across)
        near = distance < 30
        radius = np.interp(angle[near], np.arctan2(y, x), np.hypot(x, y), period=2.0 * np.pi)
        expected = [PROFILE(d, r) for d, r in zip(distance[near], radius, strict=True)]
        assert_allclose(image[near], expected, atol=0.04)
        assert (image[~near] == 1.0).all()


def test_what_is_put_in_is_taken_out() -> None:
    model, ball = model_of(), rim_fit.start_of(PLACE, 0.8, 0.7)
    rim_fit.darken(model, ball, 1.0)
    assert model.logs.min() < -1.0
    rim_fit.darken(model, ball, -1.0)
    assert_allclose(model.logs, 0.0, atol=1e-6)


def test_gain_is_the_part_of_the_shadow_that_nothing_explains() -> None:
    ball = rim_fit.start_of(PLACE, 0.8)
    dark, empty = model_of(ball), model_of()
    assert_allclose(rim_fit.gain(dark, ball), 1.0, atol=1e-5)
    assert_allclose(rim_fit.gain(empty, ball), -1.0, atol=1e-5)
    rim_fit.darken(dark, ball, 1.0)
    assert (rim_fit.gain(dark, ball) < 0.0).all()
    assert np.isnan(
        rim_fit.gain(empty, rim_fit.start_of(PLACE + np.array([200.0, 0.0, 0.0]), 0.8))
    ).all()


def test_misfit_is_least_for_the_bubble_itself() -> None:
    ball = rim_fit.start_of(PLACE, 0.8)
    model = model_of(ball)
    assert rim_fit.misfit(model, ball) == pytest.approx(0.0, abs=1e-12)
    moved = [rim_fit.misfit(model, ball + x * np.eye(7)[0]) for x in (0.02, 0.05, 0.1)]
    assert 1e-5 < moved[0] < moved[1] < moved[2]


@pytest.mark.parametrize("off", [0.01, 0.12, 0.5])
def test_a_pixel_that_is_far_off_counts_less(off: float) -> None:
    """Geman and McClure's function rises to half at its width, 0.12, and ends there squared."""
    model, ellipses = model_of(), rim_fit.ellipses_of(model_of(), rim_fit.start_of(PLACE, 0.8))
    model.logs[:] = np.log(1.0 - off)
    value = rim_fit.unexplained(model, ellipses)
    model.logs[:] = np.log(0.88)
    expected = 2.0 * off**2 / (off**2 + 0.12**2)
    assert value / rim_fit.unexplained(model, ellipses) == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
def test_a_spheroid_is_found_again() -> None:
    """Though another bubble hides a part of it in one camera."""
    true = np.array([*PLACE, 0.0, np.log(0.75), 0.1, -0.05])
    model = model_of(true)
    column, row = CAMERAS[1].project(PLACE[None])[0][0].astype(int)
    model.images[1, row - 30 : row - 4, column - 20 : column + 20] = 0.1
    start = true + np.array([0.15, -0.1, 0.2, 0.1, 0.05, -0.1, 0.05])
    found = rim_fit.fit_bubble(model, start, 40)
    assert_allclose(found[:3], PLACE, atol=0.03)
    assert_allclose(np.exp(found[3:5]), [1.0, 0.75], rtol=0.03)
    assert_allclose(found[5:], true[5:], atol=0.06)


STEPS = 1e-6 * np.array([1.0, 1.0, 0.01, 0.01, 0.01])  # px, px, and 1/px^2 of the shape


def test_derivatives_are_those_of_differences() -> None:
    """Differences that cross from one cell of the table to the next one are left out."""
    rng, table, blur = np.random.default_rng(1), PROFILE.table, PROFILE.blur_px
    errors, largest = [], 0.0
    for _ in range(2000):
        long, short, angle = rng.uniform([3.0, 2.0, 0.0], [9.0, 3.0, np.pi])
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        shape = turn @ np.diag([long**-2.0, short**-2.0]) @ turn.T
        ellipse = np.array([20.3, 18.7, shape[0, 0], shape[0, 1], shape[1, 1]])
        column, row = rng.integers(10, 30, 2).tolist()
        found = np.zeros(5)
        here = rim_fit.slopes_at(ellipse, column, row, 4.0, table, blur, found)
        assert here == max(
            rim_fit.shade_at(ellipse, column, row, 4.0, table, blur), backlit_images.DIM
        )
        for number, step in enumerate(STEPS):
            near = ellipse + step * np.eye(5)[number] * np.array([[1.0], [0.0], [-1.0]])
            ends = [
                max(rim_fit.shade_at(one, column, row, 4.0, table, blur), backlit_images.DIM)
                for one in near
            ]
            one_sided = np.diff(ends)
            if abs(one_sided[0] - one_sided[1]) > 1e-4 * np.abs(one_sided).max() + 1e-13:
                continue
            slope = (ends[0] - ends[2]) / (2.0 * step)
            errors.append(abs(slope - found[number]) * step)
            largest = max(largest, abs(slope) * step)
    assert len(errors) > 8000
    assert max(errors) < 1e-4 * largest
