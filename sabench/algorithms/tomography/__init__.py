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
from sabench.algorithms.tomography.motion_tracking import Displacement, Exposure, enhanced_guesses
from sabench.algorithms.tomography.problem import (
    SparseParameters,
    TomographyParameters,
    TomographyProblem,
)

__all__ = [
    "Displacement",
    "Exposure",
    "Iterate",
    "RecordedLight",
    "SparseParameters",
    "TomographyParameters",
    "TomographyProblem",
    "block_mart",
    "enhanced_guesses",
    "iterate",
    "mart",
    "sart",
    "smart",
]
