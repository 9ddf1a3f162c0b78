"""Polynomials that stand for cameras in a volume."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numba
import numpy as np

from sabench.geometry.camera_model import CameraModel
from sabench.utils.arrays import F64, I64

_DEGREES = range(3, 10)


_TOLERANCE_PX = 1e-3  # of the polynomials that stand for the cameras


_HIGHEST = 9


class Maps(NamedTuple):
    """Cameras over a box as polynomials of x, y, z from -1 to 1.

    Attributes
    ----------
    coefficients : (camera, terms, 2) of column and row.
    powers : (terms, 3).
    middle_mm, half_mm : (3,) the box.
    """

    coefficients: F64
    powers: I64
    middle_mm: F64
    half_mm: F64


def maps_of(cameras: Sequence[CameraModel], low_mm: F64, high_mm: F64) -> Maps:
    """Polynomials of the lowest degree that stands for all cameras within a thousandth of a pixel.

    Raises
    ------
    ValueError
        Some of the box has no light path to a camera, or no degree is enough.
    """
    middle, half = (low_mm + high_mm) / 2.0, (high_mm - low_mm) / 2.0
    axis = np.cos(np.pi * (np.arange(11) + 0.5) / 11)
    unit = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    pixels = np.stack(
        [camera.project(middle + half * unit)[0] for camera in cameras], axis=1
    ).reshape(len(unit), -1)
    if not np.isfinite(pixels).all():
        raise ValueError(
            "expected a light path from every camera to all of the volume, but some of it has none"
        )
    for degree in _DEGREES:
        powers = np.array(
            [
                (i, j, k)
                for k in range(degree + 1)
                for j in range(degree + 1 - k)
                for i in range(degree + 1 - k - j)
            ]
        )
        terms = np.prod(unit[:, None] ** powers, axis=2)
        found = np.linalg.lstsq(terms, pixels, rcond=None)[0]
        if np.abs(terms @ found - pixels).max() < _TOLERANCE_PX:
            shaped = found.reshape(len(powers), len(cameras), 2).transpose(1, 0, 2)
            return Maps(
                np.ascontiguousarray(shaped, dtype=np.float64),
                powers.astype(np.int64),
                middle,
                half,
            )
    raise ValueError(
        f"expected cameras smooth enough for polynomials of degree {_HIGHEST}: one of them, its wall or its distortion is too extreme"
    )


@numba.njit(cache=True)
def locate(maps: Any, camera: int, place: Any, pixel: Any, slope: Any) -> None:
    """A camera's pixel (2,) of a place in the box, and its slope (2, 3)."""
    x, y, z = np.ones(_HIGHEST + 1), np.ones(_HIGHEST + 1), np.ones(_HIGHEST + 1)
    for i in range(_HIGHEST):
        x[i + 1], y[i + 1], z[i + 1] = x[i] * place[0], y[i] * place[1], z[i] * place[2]
    pixel[:], slope[:] = 0.0, 0.0
    for t in range(len(maps.powers)):
        i, j, k = maps.powers[t]
        by_x = i * x[i - 1] * y[j] * z[k] if i else 0.0
        by_y = j * x[i] * y[j - 1] * z[k] if j else 0.0
        by_z = k * x[i] * y[j] * z[k - 1] if k else 0.0
        for a in range(2):
            value = maps.coefficients[camera, t, a]
            pixel[a] += value * x[i] * y[j] * z[k]
            slope[a, 0] += value * by_x
            slope[a, 1] += value * by_y
            slope[a, 2] += value * by_z


def positions(maps: Maps, camera: int, places: F64) -> F64:
    """Pixels (n, 2) of places (n, 3) in the box."""
    return np.asarray(np.prod(places[:, None] ** maps.powers, axis=2) @ maps.coefficients[camera])
