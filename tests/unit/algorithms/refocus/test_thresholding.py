"""Thresholds: many in one pass against one each, and that from images against the best."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from reproduction.refocused_frames import best_k, quality_of_k
from sabench.algorithms.refocus import refocus_sum
from sabench.algorithms.refocus.thresholding import (
    ExtractionParameters,
    Keep,
    auto_k,
    extract,
    extract_particles,
    occupancy,
)
from sabench.api import Observation
from sabench.geometry.grid import synthesise
from sabench.images.gaussians import effective_width
from sabench.images.levels import bright_dn, normalise
from sabench.metrics.quality_factor import quality
from sabench.metrics.reconstruction_error import true_field
from sabench.scenes import parse_scene
from sabench.simulation.in_memory import Shot, simulate
from sabench.utils.arrays import F32, F64

KEEPS: list[Keep] = ["reduced", "whole"]


def array_scene(per_pixel: float, **changes: Any) -> Any:
    """Nine cameras in plain air, 12 x 12 x 8 mm. As in the thesis's simulations, but smaller."""
    lens = {"pixel_mm": 0.01, "focal_length_mm": 85.0, "f_number": 16.0, "particle_sigma_px": 0.6}
    layout = {"kind": "grid", "columns": 3, "rows": 3, "spacing_mm": [204.0, 204.0]}
    size = {"rows": 240, "columns": 240, "center_mm": [0.0, 0.0, -510.0], "layout": layout}
    light = {"pulse_energy_mj": 25.0, "thickness_mm": 60.0, "height_mm": 60.0}
    values: dict[str, Any] = {
        "title": "array",
        "volume": {"center_mm": [0.0, 0.0, 0.0], "size_mm": [12.0, 12.0, 8.0]},
        "grid": {"voxel_mm": [0.05, 0.05, 0.125], "crop_mm": [3.0, 3.0, 0.0]},
        "cameras": lens | size,
        "illumination": light | {"scattering": "isotropic"},
        "particles": {"generator": "uniform", "per_pixel": per_pixel, "diameter_mm": 0.02},
        "sensor": {"full_well_e": 10200.0, "gain_dn_e": 0.025, "bit_depth": 8, "shot_noise": False},
    }
    for table, entries in changes.items():
        values[table] |= entries
    return parse_scene(values, "array")


@pytest.fixture(scope="module")
def shot() -> Shot:
    return simulate(array_scene(0.05), seed=101)


def refocused(case: Observation) -> F32:
    light = normalise(case.images, case.black_dn)
    return refocus_sum(light, case.cameras, case.grid) / np.float32(len(case.cameras))


def share_filled(field: F64) -> float:
    return float(field.sum() ** 2 / (field.size * np.sum(field**2)))


AIMS = {"reduced": 0.85, "whole": 0.65}  # of the share that the images tell


def random_volumes() -> tuple[F32, F32]:
    rng = np.random.default_rng(3)
    volume = rng.gamma(2.0, size=(6, 23, 31)).astype(np.float32)
    return volume, (volume**2 * rng.random(volume.shape)).astype(np.float32)


@pytest.mark.slow_but_first
@pytest.mark.parametrize("keep", KEEPS)
@pytest.mark.parametrize("scored", [(slice(None),) * 3, (slice(1, -1), slice(4, -3), slice(2, -5))])
def test_one_pass_gives_all_q(keep: Keep, scored: tuple[slice, slice, slice]) -> None:
    volume, truth = random_volumes()
    ks = np.array([0.0, 0.3, 1.0, 2.2, 3.0, 5.0, 50.0])
    expected = [quality(extract(volume.copy(), k, keep)[scored], truth[scored]) for k in ks]
    assert_allclose(quality_of_k(volume, truth, ks, keep, scored), expected, rtol=0, atol=1e-6)
    assert expected[0] > expected[4] > expected[-1] == 0.0


def test_a_value_at_the_threshold_is_left_out() -> None:
    volume = np.zeros((1, 2, 2), dtype=np.float32)
    volume[0, 0, 0] = 2.0  # mean 1/2, standard deviation sqrt(3) / 2
    ks = np.array([1.0, math.sqrt(3.0), 2.0])
    expected = [quality(extract(volume.copy(), k, "whole"), volume) for k in ks]
    assert_allclose(quality_of_k(volume, volume, ks, "whole"), expected)


@pytest.mark.parametrize("keep", KEEPS)
def test_the_best_k_has_the_highest_q(shot: Shot, keep: Keep) -> None:
    volume = refocused(shot.observation)
    truth = true_field(shot.observation.grid, shot.particles, shot.views)
    k, q = best_k(volume, truth, keep)
    around = quality_of_k(volume, truth, np.array([k - 0.3, k, k + 0.3]), keep)
    assert around[1] == pytest.approx(q)
    assert around.argmax() == 1


def test_widths_of_narrow_and_wide_particles() -> None:
    assert effective_width(0.01) == pytest.approx(1.0, abs=0.02)
    assert effective_width(20.0) == pytest.approx(2.0 * math.sqrt(math.pi) * 20.0, rel=1e-3)
    profile = [
        math.erf((i + 0.5 - shift) / math.sqrt(2.0) / 0.7)
        - math.erf((i - 0.5 - shift) / math.sqrt(2.0) / 0.7)
        for shift in np.linspace(0.0, 1.0, 50, endpoint=False)
        for i in range(-6, 8)
    ]
    squares = np.sum(np.square(profile)) / 50.0
    assert effective_width(0.7) == pytest.approx(4.0 / squares, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("per_pixel", [0.02, 0.1])
def test_images_tell_the_share_of_the_volume_that_particles_fill(per_pixel: float) -> None:
    """Brightness spreads, so that it is not a count of particles."""
    sensor = {"full_well_e": 1e6, "bit_depth": 16}
    scene = array_scene(per_pixel, particles={"diameter_spread": 0.2}, sensor=sensor)
    shot = simulate(scene, seed=102)
    grid, weights = shot.observation.grid, shot.views[4].photons
    field = synthesise(grid, shot.particles.position_mm, weights, 0.6 * grid.voxel_mm[0])
    expected = share_filled(field.astype(np.float64))
    assert occupancy(shot.observation) == pytest.approx(expected, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("per_pixel", "k_from", "k_to", "keep", "gap"),
    [(0.02, 4.0, 8.0, "whole", 0.03), (0.1, 1.5, 4.0, "reduced", 0.01)],
)
def test_auto_k_comes_near_the_best_q(
    per_pixel: float, k_from: float, k_to: float, keep: Keep, gap: float
) -> None:
    shot = simulate(array_scene(per_pixel), seed=1)
    case, volume = shot.observation, refocused(shot.observation)
    truth = true_field(case.grid, shot.particles, shot.views)
    k = auto_k(volume, occupancy(case), keep)
    assert k_from < k < k_to
    found = quality_of_k(volume, truth, np.array([k]), keep, case.grid.scored)[0]
    assert found > best_k(volume, truth, keep, case.grid.scored)[1] - gap


@pytest.mark.parametrize("keep", KEEPS)
def test_auto_k_is_the_lowest_step_that_does_not_fill_more_than_it_aims_at(keep: Keep) -> None:
    volume, _ = random_volumes()
    k = auto_k(volume, 0.1, keep)
    more, filled = (
        share_filled(extract(volume.copy(), level, keep).astype(np.float64))
        for level in (k - 0.01, k)
    )
    assert filled <= 0.1 * AIMS[keep] < more
    assert filled == pytest.approx(0.1 * AIMS[keep], rel=0.02)


def test_auto_k_of_a_field_that_is_sparser_than_its_images_keeps_all_above_the_mean() -> None:
    volume = np.zeros((2, 20, 20), dtype=np.float32)
    volume[:, 4, 5] = 1.0
    assert auto_k(volume, 0.5, "whole") == 0.0


def test_a_black_camera_and_black_images(shot: Shot) -> None:
    case = shot.observation
    covered = case.images.copy()
    covered[3] = 0
    assert occupancy(replace(case, images=covered)) == pytest.approx(occupancy(case), rel=0.1)
    dark, nothing = replace(case, images=0 * covered), np.zeros(case.grid.shape, dtype=np.float32)
    assert occupancy(dark) == 0.0
    assert not extract_particles(nothing, dark, ExtractionParameters(k="auto")).any()


@pytest.mark.parametrize("keep", KEEPS)
def test_a_given_k_is_the_thesis_s_threshold(shot: Shot, keep: Keep) -> None:
    case, volume = shot.observation, refocused(shot.observation)
    found = extract_particles(volume.copy(), case, ExtractionParameters(k=2.0, keep=keep))
    assert_array_equal(found, extract(volume.copy(), 2.0, keep))


@pytest.mark.parametrize("keep", KEEPS)
def test_auto_omits_what_is_a_hundred_times_fainter_than_particles(shot: Shot, keep: Keep) -> None:
    case, volume = shot.observation, refocused(shot.observation)
    found = extract_particles(volume.copy(), case, ExtractionParameters(keep=keep))
    whole = extract(volume.copy(), auto_k(volume, occupancy(case), keep), keep).astype(np.float64)
    faint = whole < 0.01 * (whole**2).sum() / whole.sum()
    assert not found[faint].any()
    assert_array_equal(found[~faint], whole[~faint].astype(np.float32))
    if keep == "reduced":
        assert np.count_nonzero(whole[faint]) > 0


@pytest.mark.parametrize("seed", range(5))
def test_bright_level_is_numpys_percentile_of_lit_pixels(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grey = rng.poisson(rng.uniform(0.1, 300.0), (31, 47)).astype(np.uint16)
    black = float(rng.uniform(0.0, 64.0))
    light = np.maximum(grey.astype(np.float64) - black, 0.0)
    lit = light[light > 0.1 * light.max()]
    expected = np.percentile(lit, 95.0) if len(lit) else 0.0
    assert bright_dn(grey, black) == pytest.approx(expected, abs=1e-9)


def test_images_are_scaled_to_their_bright_level() -> None:
    case = simulate(array_scene(0.05, sensor={"black_level_dn": 20.0}), seed=3).observation
    for grey, scaled in zip(case.images, normalise(case.images, case.black_dn), strict=True):
        expected = np.maximum(grey - 20.0, 0.0) / bright_dn(grey, 20.0)
        assert_allclose(scaled, expected, rtol=1e-6, atol=1e-7)
