"""Products of small matrices on vector units."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from sabench.utils.vector_units import add_product


@numba.njit
def _add(out: Any, left: Any, right: Any) -> None:
    add_product(out, 1, left, 2, right, 0)


def test_a_product_of_matrices_is_added_to_one_of_many() -> None:
    """Other matrices stay as they are."""
    random = np.random.default_rng(1)
    out, left, right = (random.normal(size=(3, 4, 4)) for _ in range(3))
    expected = out.copy()
    expected[1] += left[2] @ right[0]
    _add(out, left, right)
    np.testing.assert_allclose(out, expected, rtol=1e-14, atol=1e-14)
