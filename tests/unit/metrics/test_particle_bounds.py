"""Cramer-Rao bounds of particles, and the accuracy of claimed errors."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.dataset.reader import Dataset
from sabench.metrics.particle_bounds import (
    brier_score,
    coverage,
    rms_over_bound,
    squared_distance,
    true_spots,
)
from sabench.scenes import load_scene, parse_scene
from sabench.simulation.pipeline import generate


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    values = load_scene("quick").to_dict()
    values["particles"]["count"] = 40
    values["sensor"] |= {"read_noise_e": 6.0, "shot_noise": True, "quantum_efficiency": 0.5}
    scene = parse_scene(values, "small")
    return generate(scene, tmp_path_factory.mktemp("data") / "data", seed=2, backend="splat")


def test_slopes_move_images_as_cameras_do(data: Dataset) -> None:
    place, cameras = data.particles(0).position_mm, data.true_cameras
    raw = [data.raw_image(camera, 0) for camera in range(len(cameras))]
    spots = true_spots(place, data.views(0), cameras, raw, data.scene.sensor)
    move = np.array([0.02, -0.01, 0.03])
    for spot, camera in zip(spots, cameras, strict=True):
        moved = camera.project(place + move)[0] - camera.project(place)[0]
        assert_allclose(spot.slope @ move, moved, atol=2e-4)


def test_noise_is_of_photons_reading_and_rounding(data: Dataset) -> None:
    sensor, views = data.scene.sensor, data.views(0)[:1]
    image = data.raw_image(0, 0).copy()
    image[0, 0], image[0, 1] = sensor.white_dn, sensor.black_level_dn
    spots = true_spots(data.particles(0).position_mm, views, data.true_cameras[:1], [image], sensor)
    variance = spots[0].variance
    dark = sensor.read_noise_e**2 + 1.0 / (12.0 * sensor.gain_dn_e**2)
    assert variance[0, 0] == np.inf
    assert variance[0, 1] == pytest.approx(dark)
    bright = np.unravel_index(np.argmax(np.where(image < sensor.white_dn, image, 0)), image.shape)
    electrons = (int(image[bright]) - sensor.black_level_dn) / sensor.gain_dn_e
    assert variance[bright] == pytest.approx(dark + electrons)
    assert_allclose(spots[0].light, 0.5 * views[0].photons)


def test_light_grows_with_the_exposure_of_its_camera(data: Dataset) -> None:
    sensor, views, cameras = data.scene.sensor, data.views(0), data.true_cameras
    factors = tuple(0.5 + number for number in range(len(cameras)))
    exposed = sensor.model_copy(update={"camera_exposure": factors})
    raw = [data.raw_image(camera, 0) for camera in range(len(cameras))]
    place = data.particles(0).position_mm
    plain, more = (true_spots(place, views, cameras, raw, one) for one in (sensor, exposed))
    for factor, one, other in zip(factors, plain, more, strict=True):
        assert_allclose(other.light, factor * one.light)


def test_squared_distances_are_those_of_the_inverse_covariance() -> None:
    covariance = np.array([np.diag([4.0, 1.0, 0.25])])
    assert_allclose(squared_distance(np.array([[2.0, 1.0, 0.5]]), covariance), [3.0])


@pytest.mark.parametrize("nominal", [0.68, 0.95])
def test_normal_errors_are_covered_as_claimed(nominal: float) -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(20_000, 3, 3))
    error = (root @ rng.normal(size=(20_000, 3, 1)))[:, :, 0]
    covariance = root @ root.transpose(0, 2, 1)
    assert coverage(error, covariance, nominal) == pytest.approx(1.0, abs=0.015)
    assert coverage(3.0 * error, covariance, nominal) < 0.5
    assert rms_over_bound(2.0 * error, covariance) == pytest.approx(2.0, abs=0.03)


def test_particles_without_a_bound_are_left_out() -> None:
    bound = np.array([np.eye(3), np.full((3, 3), np.nan)])
    error = np.array([[1.0, 1.0, 1.0], [9.0, 9.0, 9.0]])
    assert rms_over_bound(error, bound) == pytest.approx(1.0)
    assert math.isnan(rms_over_bound(error[1:], bound[1:]))
    assert math.isnan(coverage(np.zeros((0, 3)), np.zeros((0, 3, 3)), 0.68))


def test_probabilities_are_scored_by_what_is_true() -> None:
    true = np.array([True, True, False])
    assert brier_score(np.array([1.0, 1.0, 0.0]), true) == 0.0
    assert brier_score(np.array([0.5, 0.5, 0.5]), true) == pytest.approx(0.25)
    assert math.isnan(brier_score(np.zeros(0), np.zeros(0, dtype=np.bool_)))
