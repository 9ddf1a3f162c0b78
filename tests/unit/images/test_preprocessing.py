"""Steps before reconstruction."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import gaussian_filter, minimum_filter

from sabench.images import preprocessing
from sabench.scenes import parse_scene
from sabench.simulation.in_memory import simulate
from sabench.simulation.pipeline import generate
from sabench.tasks.solve_and_score import solve
from sabench.utils.arrays import F32
from tests.helpers.refusals import refused
from tests.unit.worlds.test_tracers import moving_scene

THESIS: list[dict[str, Any]] = [
    {"step": "sliding_minimum", "window_px": 10},
    {"step": "gaussian"},
    {"step": "match_histograms"},
    {"step": "stretch", "percent": 0.1},
    {"step": "sliding_minimum", "window_px": 10},
]


def images() -> F32:
    light = np.random.default_rng(0).random((3, 40, 50)) ** 3
    return np.asarray(light * np.array([0.3, 1.0, 0.6])[:, None, None], dtype=np.float32)


def test_the_sliding_minimum_and_the_gaussian_are_scipy_s() -> None:
    given = images()
    expected = given - np.stack([minimum_filter(image, 10, mode="nearest") for image in given])
    assert_allclose(
        preprocessing.SlidingMinimum(step="sliding_minimum").apply(given), expected, atol=1e-6
    )
    blurred = np.stack([gaussian_filter(image, 0.5, mode="mirror", radius=1) for image in given])
    assert_allclose(preprocessing.Gaussian(step="gaussian").apply(given), blurred, atol=1e-6)


def test_histograms_become_those_of_the_camera_with_the_highest_contrast() -> None:
    given = images()
    matched = preprocessing.MatchHistograms(step="match_histograms").apply(given)
    for image, before in zip(matched, given, strict=True):
        assert_allclose(np.sort(image, axis=None), np.sort(given[1], axis=None), atol=1e-6)
        assert (np.diff(image.ravel()[np.argsort(before, axis=None)]) >= -1e-7).all()
    ties: F32 = np.array([[[0.5, 0.5, 0.0, 0.0]], [[0.9, 0.6, 0.2, 0.0]]], dtype=np.float32)
    tied = preprocessing.MatchHistograms(step="match_histograms").apply(ties)[0]
    assert_allclose(tied, [[0.75, 0.75, 0.1, 0.1]], atol=1e-6)


def test_stretching_cuts_both_ends() -> None:
    ramp = np.arange(2000.0, dtype=np.float32).reshape(1, 40, 50)
    stretched = preprocessing.Stretch(step="stretch", percent=1.0).apply(ramp)
    assert ((stretched == 0.0).sum(), (stretched == 1.0).sum()) == (20, 20)
    assert_allclose(np.diff(stretched.ravel()[20:1980]), 1.0 / 1959.02, rtol=1e-3)
    even = np.full((1, 9, 9), 0.4, dtype=np.float32)
    assert_array_equal(preprocessing.Stretch(step="stretch").apply(even), 0.0)


def test_nothing_changes_without_steps_but_the_scale() -> None:
    grey = np.array([[[100, 600, 1100, 50, 2000]]], dtype=np.uint16)
    scaled = preprocessing.preprocess(grey, 100.0, 1100.0, ())[0, 0]
    assert_array_equal(
        scaled, [0, round(preprocessing.WHITE / 2), preprocessing.WHITE, 0, preprocessing.WHITE]
    )


def test_a_background_goes_and_particles_stay() -> None:
    y, x = np.mgrid[:80, :80]
    background = 300.0 + 3.0 * x
    particle = 800.0 * np.exp(-0.5 * ((x - 40.3) ** 2 + (y - 39.8) ** 2) / 0.8**2)
    light = background + particle
    grey = np.rint(np.stack([light, 0.5 * light])).astype(np.uint16)
    scene = parse_scene(moving_scene(preprocessing=THESIS).to_dict(), "scene")
    clean = preprocessing.preprocess(grey, 0.0, 4095.0, scene.preprocessing or ())
    for image in clean:
        assert_allclose(np.argwhere(image == image.max()), 40.0, atol=2.0)
    assert np.median(clean) < 0.02 * clean.max()


@pytest.mark.slow
def test_solvers_see_processed_images_and_the_data_set_keeps_raw_ones(tmp_path: Path) -> None:
    raw = moving_scene(frames=1, flow=None)
    scene = moving_scene(frames=1, flow=None, preprocessing=THESIS)
    before = generate(raw, tmp_path / "raw", seed=1, backend="splat")
    data = generate(scene, tmp_path / "data", seed=1, backend="splat")
    name = "images/frame_0000/camera_00.tif"
    assert (data.root / name).read_bytes() == (before.root / name).read_bytes()
    seen, plain = data.observation(0), before.observation(0)
    assert (seen.black_dn, seen.white_dn) == (0.0, preprocessing.WHITE)
    steps = scene.preprocessing or ()
    expected = preprocessing.preprocess(plain.images, plain.black_dn, plain.white_dn, steps)
    assert_array_equal(seen.images, expected)
    assert_array_equal(seen.images, simulate(scene, seed=1).observation.images)
    solve("msa", data, tmp_path / "msa.h5")


def test_unknown_steps_are_named() -> None:
    with refused("preprocessing", "sharpen"):
        moving_scene(preprocessing=[{"step": "sharpen"}])
    with refused("preprocessing", "window_px", "1"):
        moving_scene(preprocessing=[{"step": "sliding_minimum", "window_px": 1}])
