"""Limits of the numbers in a camera's record."""

from __future__ import annotations

import math

import pytest

from sabench.geometry.camera_records import read_camera, record_camera
from sabench.utils.errors import InputError
from tests.unit.geometry.test_volume_polynomials import camera


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_million_kilometres_are_the_largest_length(sign: float) -> None:
    record = record_camera(camera())
    far = {**record, "center_mm": (0.0, 0.0, sign * 1e12)}
    assert record_camera(read_camera(far, "cameras.json")) == far
    beyond = {**record, "center_mm": (0.0, 0.0, sign * math.nextafter(1e12, math.inf))}
    with pytest.raises(
        InputError, match=r"cameras\.json: center_mm: expected finite numbers of at most 1e\+12"
    ):
        read_camera(beyond, "cameras.json")
