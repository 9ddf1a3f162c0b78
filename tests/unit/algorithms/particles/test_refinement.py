"""Widths of particle images next to the border."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.algorithms.particles.refinement import _WINDOW, _pull, image_widths
from sabench.images.peaks import find_peaks


def test_widths_at_the_border_read_no_pixel_beyond_it() -> None:
    row, column = np.indices((105, 33), dtype=np.float64)
    image = np.exp(-((row - 103.5) ** 2 + (column - 16.0) ** 2) / (2.0 * 0.8**2))
    image[102] *= 0.9  # the vertex lies beyond 103.5, where it is cut off: rounded to the last row
    pixels = find_peaks(image.astype(np.float32), 0.1).pixels
    assert pixels[0, 1] == 103.5
    assert np.rint(pixels[0, 1]) == len(image) - 1
    widths = image_widths(image[None].astype(np.float32), [pixels])
    assert widths[0] == pytest.approx(np.sqrt(0.8**2 - 1.0 / 12.0), rel=0.1)


def test_a_camera_adds_the_normal_equations_of_its_pixels() -> None:
    """As plain Python, which refuses an index beyond an array, and by dense linear algebra."""
    rng = np.random.default_rng(4)
    x, y, dx, dy = rng.normal(size=(4, _WINDOW))
    image, unknown = rng.normal(size=(_WINDOW + 3, _WINDOW + 4)), np.zeros((20, 20), dtype=np.bool_)
    unknown[5, 6], corner, slope, light = True, np.array([2, -1]), rng.normal(size=(2, 3)), 3.0
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    _pull.py_func(image, unknown, corner, x, y, dx, dy, light, slope, matrix, right)
    seen = image[: _WINDOW - 1, 2 : 2 + _WINDOW], ~unknown[: _WINDOW - 1, 2 : 2 + _WINDOW]
    slopes = light * np.stack([np.outer(y, dx), np.outer(dy, x)], axis=-1)[1:] @ slope
    miss = seen[0] - light * np.outer(y, x)[1:]
    np.testing.assert_allclose(matrix, slopes[seen[1]].T @ slopes[seen[1]])
    np.testing.assert_allclose(right, slopes[seen[1]].T @ miss[seen[1]])
