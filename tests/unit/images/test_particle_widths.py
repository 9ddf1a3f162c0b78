"""Widths of particle images next to the border."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.images.peaks import find_peaks
from sabench.images.widths import image_widths


def test_widths_at_the_border_read_no_pixel_beyond_it() -> None:
    row, column = np.indices((105, 33), dtype=np.float64)
    image = np.exp(-((row - 103.5) ** 2 + (column - 16.0) ** 2) / (2.0 * 0.8**2))
    image[102] *= 0.9  # the vertex lies beyond 103.5, where it is cut off: rounded to the last row
    pixels = find_peaks(image.astype(np.float32), 0.1).pixels
    assert pixels[0, 1] == 103.5
    assert np.rint(pixels[0, 1]) == len(image) - 1
    widths = image_widths(image[None].astype(np.float32), [pixels])
    assert widths[0] == pytest.approx(np.sqrt(0.8**2 - 1.0 / 12.0), rel=0.1)
