"""Lattice of diameters on which particles scatter.

What a sphere scatters in one direction changes with its last hundredth of a percent of diameter.
Diameters are rounded to this lattice, far finer than anybody can measure, so that particles share
what has been computed, exactly.
"""

from __future__ import annotations

import numpy as np

from sabench.utils.arrays import F64, I64

PER_OCTAVE = 2048  # 7 nm at 20 um
_UNIT_MM = 1e-3


def size_numbers(diameters_mm: F64) -> I64:
    """Compute the numbers of the lattice's nearest diameters; that of 1 um is 0."""
    return np.asarray(np.rint(PER_OCTAVE * np.log2(diameters_mm / _UNIT_MM)), dtype=np.int64)


def lattice_diameters_mm(numbers: I64) -> F64:
    """Compute the diameters of numbers."""
    return np.asarray(_UNIT_MM * np.exp2(numbers / PER_OCTAVE))
