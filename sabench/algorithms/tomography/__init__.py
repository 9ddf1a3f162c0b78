"""Tomographic reconstruction.

The package holds first guesses and algebraic (ART) updates of a volume.
"""

from sabench.algorithms.tomography.art_updates import (
    Iterate,
    RecordedLight,
    block_mart,
    iterate,
    mart,
    sart,
    smart,
)
from sabench.algorithms.tomography.problem import (
    SparseParameters,
    TomographyParameters,
    TomographyProblem,
)

__all__ = [
    "Iterate",
    "RecordedLight",
    "SparseParameters",
    "TomographyParameters",
    "TomographyProblem",
    "block_mart",
    "iterate",
    "mart",
    "sart",
    "smart",
]
