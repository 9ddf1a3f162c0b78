"""Fits of particle images against Gaussians that pixels integrate."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from sabench.images.statistics import fit_particle_images, flux_near, image_noise
from sabench.utils.arrays import F64, U16

SHAPE, PITCH, WHITE = (220, 260), 22, 65535.0


def shares(offset: F64, sigma: float) -> F64:
    """Integrate a Gaussian over pixels."""
    ends = [erf((offset + side) / (sigma * np.sqrt(2.0))) for side in (0.5, -0.5)]
    return np.asarray((ends[0] - ends[1]) / 2.0)


def lattice(
    across: float, down: float, flux: float, spread: float = 0.0, seed: int = 1
) -> tuple[F64, F64, F64]:
    """Make light of particles far from each other, and their pixels and fluxes."""
    rng = np.random.default_rng(seed)
    rows, columns = (range(PITCH, size - PITCH, PITCH) for size in SHAPE)
    nodes = np.array([(c, r) for r in rows for c in columns], dtype=np.float64)
    nodes += rng.uniform(-0.5, 0.5, nodes.shape)
    amount = flux * np.exp(spread * rng.standard_normal(len(nodes)))
    x = shares(np.arange(SHAPE[1]) - nodes[:, :1], across)
    y = shares(np.arange(SHAPE[0]) - nodes[:, 1:], down)
    return np.einsum("n,nr,nc->rc", amount, y, x), nodes, amount


def record(light: F64, noise: float = 1.0, background: float = 20.0) -> U16:
    rng = np.random.default_rng(7)
    grey = light + background + noise * rng.standard_normal(light.shape)
    return np.clip(np.rint(grey), 0, 65535).astype(np.uint16)


@pytest.mark.parametrize(
    ("across", "down"), [(0.47, 0.47), (0.6, 0.45), (0.75, 0.75), (1.5, 0.8), (2.2, 2.2)]
)
def test_widths_fluxes_and_positions_are_those_drawn(across: float, down: float) -> None:
    light, nodes, amount = lattice(across, down, 4000.0 * max(1.0, across * down))
    found = fit_particle_images(record(light), WHITE)
    assert len(found.width_px) == found.found == len(nodes)
    assert np.median(found.width_px) == pytest.approx(np.sqrt(across * down), rel=0.05)
    assert np.percentile(found.width_px, [10, 90]) == pytest.approx(
        np.sqrt(across * down), rel=0.08
    )
    order = np.lexsort((found.pixel[:, 0], np.rint(found.pixel[:, 1] / PITCH)))
    assert np.abs(found.pixel[order] - nodes).max() < 0.06
    assert found.flux[order] == pytest.approx(amount, rel=0.06)


def test_spread_of_brightness_is_found() -> None:
    light, _, amount = lattice(0.5, 0.5, 8000.0, spread=0.6)
    found = fit_particle_images(record(light), WHITE)
    assert np.std(np.log(found.flux)) == pytest.approx(np.std(np.log(amount)), abs=0.01)


def test_hot_pixels_and_saturated_peaks_are_no_particle_images() -> None:
    light, nodes, _ = lattice(0.6, 0.6, 4000.0)
    plain = fit_particle_images(record(light), WHITE)
    light[30, 33] = light[120, 99] = 3000.0
    hot = fit_particle_images(record(light), WHITE)
    assert len(hot.width_px) == len(plain.width_px) == len(nodes)
    limit = 1100.0
    cut = fit_particle_images(np.minimum(record(light), np.uint16(limit)), limit)
    bright = record(light)[tuple(np.rint(nodes[:, ::-1]).astype(int).T)] >= limit
    assert 0 < bright.sum() < len(nodes)
    assert len(cut.width_px) == len(nodes) - bright.sum()


@pytest.mark.parametrize("noise", [0.6, 0.9, 3.0])
def test_noise_of_a_grey_value_makes_no_peaks(noise: float) -> None:
    """Rounding to grey values hides such noise from quantiles."""
    image = record(np.zeros(SHAPE), noise)
    assert image_noise(image) == pytest.approx(np.hypot(noise, 12**-0.5), rel=0.25)
    assert fit_particle_images(image, 255.0).found == 0


def test_an_even_image_has_none() -> None:
    assert fit_particle_images(np.full(SHAPE, 7, dtype=np.uint16), 255.0).found == 0


def test_flux_is_looked_up_where_a_particle_is_alone() -> None:
    light, nodes, amount = lattice(0.5, 0.5, 4000.0)
    found = fit_particle_images(record(light), WHITE)
    asked = np.concatenate([nodes, nodes[:1] + 2.0, [[np.nan, 3.0]], [[45.0, 55.0]]])
    flux = flux_near(found, asked, 1.0, 4.0)
    assert flux[1 : len(nodes)] == pytest.approx(amount[1:], rel=0.05)
    assert np.isnan(flux[0])  # another particle is near
    assert np.isnan(flux[len(nodes) :]).all()
