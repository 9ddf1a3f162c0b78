"""Profiles of bubbles, votes for outlines, and weights of the thesis's potential."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter

from sabench.algorithms.bubbles.backlit_images import Profile, sharp
from sabench.algorithms.bubbles.ellipse_detection import peaks, radii_between, vote
from sabench.algorithms.bubbles.features import STACK, attenuate, compute_potential, minimum_images
from tests.unit.simulation.rendering.test_bubbles_traced import profile_by_hand


@pytest.mark.parametrize("half_angle", [0.2, 0.45, 0.9])
def test_the_sharp_profile_is_that_of_ray_optics(half_angle: float) -> None:
    """Away from the edges, which are soft here because diffusers are not round."""
    b = np.linspace(0.0, 0.999, 1500)
    ours, hand = sharp(b, 1.0 / 1.333, half_angle), profile_by_hand(b, half_angle)
    edge = np.zeros(len(b), dtype=bool)
    for k in np.flatnonzero(np.abs(np.diff(hand)) > 0.02):
        edge |= np.abs(b - b[k]) < 0.09
    assert edge.mean() < 0.6
    assert_allclose(ours[~edge], hand[~edge], atol=0.02)
    assert sharp(np.array([1.0, 2.0]), 1.0 / 1.333, half_angle).tolist() == [1.0, 1.0]


@pytest.mark.parametrize("radius", [1.5, 6.0, 15.0])
def test_the_blurred_profile_is_a_blurred_disc(radius: float) -> None:
    fine = 12
    grid = np.arange(-40 * fine, 40 * fine + 1) / fine
    away = np.hypot(grid, grid[:, None]) / radius
    picture = sharp(away.ravel(), 1.0 / 1.333, 0.4).reshape(away.shape)
    row = gaussian_filter(picture, 0.8 * fine)[40 * fine, 40 * fine :: fine]
    distance = np.arange(0.0, min(radius + 3.0, len(row)))
    made = Profile.tabulate(1.0 / 1.333, 0.4, 0.8)
    assert_allclose(made(distance, radius), row[: len(distance)], atol=0.01)


@pytest.mark.parametrize(("radius", "aspect"), [(3.0, 1.0), (9.0, 1.0), (9.0, 0.6)])
def test_an_outline_gets_the_votes_of_its_own_radius(radius: float, aspect: float) -> None:
    row, column = np.mgrid[0:80, 0:100]
    part = np.hypot(column - 47.3, (row - 33.6) / aspect) / radius
    image = np.clip((part - 1.0) * radius * min(aspect, 1.0) + 0.5, 0.05, 1.0).astype(np.float32)
    found = peaks(vote(image, radii_between(1.5, 15.0), aspect), 0.3)
    best = found[found[:, 3].argmax()]
    assert best[:2] == pytest.approx([47.3, 33.6], abs=0.8)
    assert best[2] == pytest.approx(radius, rel=0.15)
    assert best[3] > 0.7
    nothing = vote(np.ones((80, 100), dtype=np.float32), radii_between(1.5, 15.0), aspect)
    assert len(peaks(nothing, 0.1)) == 0


def test_attenuation_keeps_the_plane_with_edges() -> None:
    """One window stack with a square in one plane and faint noise elsewhere."""
    volume = (0.05 * np.random.default_rng(1).random((60, 21, 21))).astype(np.float32)
    volume[37, 8:13, 8:13] = 0.9
    potential = compute_potential(volume, 7)
    assert potential.shape == (60, 3, 3)
    assert int(potential[:, 1, 1].argmax()) == 37
    before = volume.copy()
    attenuate(volume, potential, 7)
    assert volume[37, 10, 10] == pytest.approx(before[37, 10, 10], rel=0.05)
    assert (volume <= before + 1e-6).all()
    quiet = np.delete(volume[:, 10, 10], 37).mean() / np.delete(before[:, 10, 10], 37).mean()
    assert quiet < 0.7


def test_minimum_images_say_where_it_is_darkest() -> None:
    volume = np.zeros((STACK + 20, 4, 5), dtype=np.float32)
    volume[7, 1, 2], volume[STACK + 3, 0, 0] = 0.8, 0.6
    (first, where), (second, there) = minimum_images(volume)
    assert first[1, 2] == pytest.approx(0.8)
    assert where[1, 2] == 7.0
    assert second[0, 0] == pytest.approx(0.6)
    assert there[0, 0] == STACK + 3
