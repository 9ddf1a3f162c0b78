"""Statistics of a camera's images, and fits, against the numbers that made them."""

import numpy as np
import pytest
from scipy.special import erf

from sabench.images import statistics
from sabench.images.repair import above_background
from sabench.utils.arrays import F64, U16


def stack(fixed: float, temporal: float, frames: int, light: F64 | float = 0.0) -> U16:
    rng = np.random.default_rng(3)
    still = 60.0 + fixed * rng.standard_normal(SHAPE) + light
    images = still + temporal * rng.standard_normal((frames, *SHAPE))
    return np.clip(np.rint(images), 0, 4095).astype(np.uint16)


@pytest.mark.parametrize(("fixed", "temporal"), [(2.0, 0.9), (0.5, 4.0), (8.0, 3.0)])
@pytest.mark.parametrize("frames", [4, 20])
def test_fixed_and_temporal_noise_differ(fixed: float, temporal: float, frames: int) -> None:
    found = statistics.measure_noise(stack(fixed, temporal, frames))
    drawn = np.hypot(temporal, 12**-0.5)  # rounding
    assert found[0] == pytest.approx(fixed, rel=0.03, abs=0.25)
    assert found[1] == pytest.approx(fixed, rel=0.05, abs=0.25)
    assert found[2] == pytest.approx(drawn, rel=0.05)


def test_smooth_light_counts_as_fixed_but_not_from_pixel_to_pixel() -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    found = statistics.measure_noise(stack(1.0, 1.0, 12, 0.2 * np.hypot(row, column)))
    assert found[0] > 8.0
    assert found[1] == pytest.approx(1.0, abs=0.15)


def test_passing_particles_do_not_count_as_noise() -> None:
    images = stack(2.0, 1.0, 10).astype(np.float64)
    rng = np.random.default_rng(5)
    for image in images:
        for _ in range(300):
            r, c = rng.uniform([5, 5], [SHAPE[0] - 5, SHAPE[1] - 5])
            y, x = shares(np.arange(SHAPE[0]) - r, 0.6), shares(np.arange(SHAPE[1]) - c, 0.6)
            image += 400.0 * np.outer(y, x)
    found = statistics.measure_noise(np.rint(images).astype(np.uint16))
    assert found[0] == pytest.approx(2.0, rel=0.1)
    assert found[2] == pytest.approx(np.hypot(1.0, 12**-0.5), rel=0.1)


def test_a_camera_s_statistics_are_those_drawn() -> None:
    light, nodes, _ = lattice(0.5, 0.5, 200.0, spread=0.3)
    frames = np.rint(light + 30.0 + np.random.default_rng(2).standard_normal((3, *SHAPE)))
    frames[:, :22, :26] = 255
    found = statistics.measure_camera(list(np.clip(frames, 0, 255).astype(np.uint16)), 255.0)
    assert found.saturated == pytest.approx(0.01, abs=2e-3)
    assert found.background_p50 == pytest.approx(30.0, abs=2.0)
    assert found.width_p50 == pytest.approx(0.5, rel=0.05)
    assert found.ln_flux == pytest.approx(0.3, abs=0.06)
    assert found.per_pixel == pytest.approx(len(nodes) / (SHAPE[0] * SHAPE[1]), rel=0.05)
    assert 0.4 < found.contrast < 0.8


def test_grey_values_are_scaled_to_255() -> None:
    light, _, _ = lattice(0.5, 0.5, 1000.0)
    frames = list(stack(8.0, 4.0, 5, light))
    coarse, fine = (statistics.measure_camera(frames, white) for white in (1023.0, 4095.0))
    dark = statistics.measure_camera(list(stack(8.0, 4.0, 5)), 1023.0)
    assert dark.fixed == pytest.approx(8.0 * 255 / 1023, rel=0.05)
    for name in ("background_p50", "fixed", "temporal"):
        assert getattr(coarse, name) == pytest.approx(getattr(fine, name) * 4095 / 1023)
    assert coarse.width_p50 == fine.width_p50


def test_one_image_has_no_noise_of_a_stack() -> None:
    found = statistics.measure_camera([stack(1.0, 1.0, 1)[0]], 255.0)
    assert np.isnan([found.fixed, found.fixed_near, found.temporal]).all()
    assert np.isfinite(found.background_p50)
    assert np.isnan([found.width_p50, found.ln_flux, found.contrast]).all()


def test_ratios_of_cameras_have_the_spread_drawn_whatever_their_gains() -> None:
    rng = np.random.default_rng(4)
    own = np.exp(rng.standard_normal(4000))
    flux = own * np.exp(0.2 * rng.standard_normal((3, 4000))) * np.array([[1.0], [5.0], [0.3]])
    found = statistics.flux_ratio_spread(flux)
    assert (found.plain, found.robust) == pytest.approx((0.2 * 2**0.5, 0.2 * 2**0.5), rel=0.03)
    assert found.pairs == 12000
    flux[0, :100] *= 50.0
    flux[1, 100:200] = np.nan
    outliers = statistics.flux_ratio_spread(flux)
    assert outliers.pairs == 11800
    assert outliers.robust == pytest.approx(0.29, abs=0.02)
    assert outliers.plain > 0.5
    assert statistics.flux_ratio_spread(flux[:1]).pairs == 0


def test_hot_pixels_count_as_fixed_but_not_from_pixel_to_pixel() -> None:
    images = stack(2.0, 1.0, 6)
    hot = np.random.default_rng(8).random(SHAPE) < 2e-3
    images[:, hot] += np.uint16(300)
    fixed, near, temporal = statistics.measure_noise(images)
    assert fixed == pytest.approx(np.sqrt(4.0 + 300.0**2 * hot.mean()), rel=0.1)
    assert near == pytest.approx(2.0, rel=0.05)
    assert temporal == pytest.approx(np.hypot(1.0, 12**-0.5), rel=0.05)


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
    grey = light + background + noise * np.random.default_rng(7).standard_normal(light.shape)
    return np.clip(np.rint(grey), 0, 65535).astype(np.uint16)


@pytest.mark.parametrize(("across", "down"), [(0.47, 0.47), (0.6, 0.45), (1.5, 0.8), (2.2, 2.2)])
def test_widths_fluxes_and_positions_are_those_drawn(across: float, down: float) -> None:
    light, nodes, amount = lattice(across, down, 4000.0 * max(1.0, across * down))
    found = statistics.fit_particle_images(record(light), WHITE)
    assert len(found.width_px) == found.found == len(nodes)
    low, middle, high = np.percentile(found.width_px, [10, 50, 90]) / np.sqrt(across * down)
    assert middle == pytest.approx(1.0, rel=0.05)
    assert (low, high) == pytest.approx((1.0, 1.0), rel=0.08)
    order = np.lexsort((found.pixel[:, 0], np.rint(found.pixel[:, 1] / PITCH)))
    assert np.abs(found.pixel[order] - nodes).max() < 0.06
    assert found.flux[order] == pytest.approx(amount, rel=0.06)


def test_hot_pixels_and_saturated_peaks_are_no_particle_images() -> None:
    light, nodes, _ = lattice(0.6, 0.6, 4000.0)
    plain = statistics.fit_particle_images(record(light), WHITE)
    light[30, 33] = light[120, 99] = 3000.0
    hot = statistics.fit_particle_images(record(light), WHITE)
    assert len(hot.width_px) == len(plain.width_px) == len(nodes)
    limit = 1100.0
    cut = statistics.fit_particle_images(np.minimum(record(light), np.uint16(limit)), limit)
    bright = record(light)[tuple(np.rint(nodes[:, ::-1]).astype(int).T)] >= limit
    assert 0 < bright.sum() < len(nodes)
    assert len(cut.width_px) == len(nodes) - bright.sum()


@pytest.mark.parametrize("noise", [0.6, 0.9, 3.0])
def test_noise_of_a_grey_value_makes_no_peaks(noise: float) -> None:
    """Rounding to grey values hides such noise from quantiles."""
    image = record(np.zeros(SHAPE), noise)
    assert above_background(image)[1] == pytest.approx(np.hypot(noise, 12**-0.5), rel=0.25)
    assert statistics.fit_particle_images(image, 255.0).found == 0
    assert statistics.fit_particle_images(np.full_like(image, 7), 255.0).found == 0


def test_flux_is_looked_up_where_a_particle_is_alone() -> None:
    light, nodes, amount = lattice(0.5, 0.5, 4000.0)
    found = statistics.fit_particle_images(record(light), WHITE)
    asked = np.concatenate([nodes, nodes[:1] + 2.0, [[np.nan, 3.0]], [[45.0, 55.0]]])
    flux = statistics.flux_near(found, asked, 1.0, 4.0)
    assert flux[1 : len(nodes)] == pytest.approx(amount[1:], rel=0.05)
    assert np.isnan(flux[0])  # another particle is near
    assert np.isnan(flux[len(nodes) :]).all()
