"""The end of a bubble cloud below a plunging jet."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.metrics.plunging_jet import _drop


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_the_cloud_ends_where_it_falls_most_and_not_where_bubbles_are_few(scale: float) -> None:
    total = scale * np.array([0.0, 4.0, 10.0, 8.0, 6.0, 5.0, 0.9, 0.1, 0.0, 0.0])
    assert _drop(total) == 6  # 5 -> 0.9; from 0.9 on, it is less than a fifth of the peak
    assert _drop(total[::-1]) == 9
    assert _drop(0.0 * total) is None
    assert _drop(total[:3]) is None  # the peak is the last bin
