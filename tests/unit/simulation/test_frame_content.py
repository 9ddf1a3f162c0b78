"""Noise of the sensors: one draw for each seed, frame and camera, and no two alike."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from sabench.scenes import Scene, load_scene, parse_scene
from sabench.simulation.in_memory import simulate
from sabench.utils.arrays import F64


@pytest.fixture(scope="module")
def dark_scene() -> Scene:
    """Make a scene of four cameras that see next to nothing, so that images are noise."""
    values = load_scene("quick").to_dict()
    values["particles"] = {"generator": "uniform", "count": 1, "diameter_mm": 1e-4}
    values |= {"frames": 2, "interval_s": 0.01}
    values["cameras"] |= {"rows": 60, "columns": 80}
    values["sensor"] |= {"shot_noise": False, "read_noise_e": 40.0}
    return parse_scene(values, "dark")


def noise_of(scene: Scene, seed: int, frame: int) -> F64:
    """Return the cameras' noise (camera, pixel) with mean 0 and variance 1."""
    images = simulate(scene, seed=seed, frame=frame).observation.images
    flat = images.reshape(len(images), -1).astype(np.float64)
    flat -= flat.mean(axis=1, keepdims=True)
    return np.asarray(flat / flat.std(axis=1, keepdims=True))


def test_noise_of_seeds_frames_and_cameras_is_independent(dark_scene: Scene) -> None:
    draws = {
        (seed, frame, camera): noise
        for seed, frame in itertools.product((0, 1, 2), (0, 1))
        for camera, noise in enumerate(noise_of(dark_scene, seed, frame))
    }
    assert len(draws) == 3 * 2 * 4
    for one, other in itertools.combinations(draws, 2):
        together = float(np.mean(draws[one] * draws[other]))
        assert abs(together) < 6.0 / np.sqrt(draws[one].size), (one, other)


def test_noise_of_one_seed_frame_and_camera_is_the_same_twice(dark_scene: Scene) -> None:
    np.testing.assert_array_equal(noise_of(dark_scene, 1, 1), noise_of(dark_scene, 1, 1))
