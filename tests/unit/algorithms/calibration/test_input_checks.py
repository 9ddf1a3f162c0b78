"""Bad input to a calibration: one sentence that names the camera or the frame."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sabench.api import CalibrationCase
from sabench.api.make import make_algorithm
from sabench.geometry.refraction import Layer
from tests.helpers.calibration_cases import calibration_scene, case_of
from tests.helpers.refusals import refused

Change = Callable[[CalibrationCase], CalibrationCase]
THIN = (Layer("glass", 1.333, 5.0),)


def case(**changes: Any) -> CalibrationCase:
    return case_of(calibration_scene(calibration={"points": 0.02, "known": []}, **changes))[0]


def with_pixels(places: Any, sources: Any) -> Change:

    def changed(given: CalibrationCase) -> CalibrationCase:
        pixels = given.pixels.copy()
        pixels[places] = given.pixels[sources]
        return replace(given, pixels=pixels)

    return changed


def with_wall(**values: Any) -> Change:
    def other(camera: Any) -> Any:
        return replace(camera, wall=replace(camera.wall, **values))

    return lambda given: replace(given, cameras=tuple(other(camera) for camera in given.cameras))


def solve(given: CalibrationCase) -> Any:
    algorithm: Any = make_algorithm("refractive_autocal", {})
    return algorithm.solve(given)


FAULTS: list[tuple[Change, tuple[str, ...]]] = [
    (with_pixels(np.s_[:, 2], np.s_[:, 2, ::-1]), ("frame 2",)),
    (with_pixels(np.s_[3, 2], np.s_[3, 2, ::-1]), ("camera_03", "frame 2")),
    (with_pixels([1, 5], [5, 1]), ("camera_01", "camera_05")),
    (with_pixels(3, 4), ("camera_03", "camera_04")),
    (with_pixels((3, 1), (3, 2)), ("camera_03", "frames 1 and 2")),
    (with_wall(point_mm=(0.0, 0.0, -600.0)), ("camera_00", "wall")),
    (with_wall(air_index=1.333, fluid_index=1.0), ("wall", "air_index", "fluid_index", "1.333")),
    (with_wall(layers=THIN, fluid_index=1.5), ("wall", "layers")),
    (lambda _: case(frames=1, targets={"tilt_deg": 0.0}), ()),
]


@pytest.mark.parametrize(("change", "keys"), FAULTS)
def test_a_fault_is_named(change: Change, keys: tuple[str, ...]) -> None:
    with refused(*keys):
        solve(change(case()))


@pytest.mark.slow
def test_points_in_no_order_are_named() -> None:
    given, rng = case(frames=3, targets={"columns": 5, "rows": 5}), np.random.default_rng(0)
    pixels = given.pixels.copy()
    for view in pixels.reshape(-1, *pixels.shape[2:]):
        view[:] = view[rng.permutation(len(view))]
    with refused():
        solve(replace(given, pixels=pixels))


def test_a_spoilt_image_is_left_out() -> None:
    given = case()
    pixels = given.pixels.copy()
    pixels[3, 2] += np.random.default_rng(0).normal(0.0, 50.0, pixels[3, 2].shape)
    answer = solve(replace(given, pixels=pixels))
    assert answer.used[3, 2].mean() < 0.05
    assert answer.used.mean() > 0.97


def test_other_shapes_are_refused() -> None:
    given = case()
    with refused("pixels"):
        replace(given, pixels=given.pixels[:, :, 1:])
    with refused("initial_mm"):
        replace(given, initial_mm=given.initial_mm[1:])
