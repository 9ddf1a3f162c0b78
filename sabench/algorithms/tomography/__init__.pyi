from .art_updates import (
    block_mart as block_mart,
    iterate as iterate,
    mart as mart,
    sart as sart,
    smart as smart,
)
from .motion_tracking import (
    Displacement as Displacement,
    Exposure as Exposure,
    enhanced_guesses as enhanced_guesses,
)
from .problem import (
    SparseParameters as SparseParameters,
    TomographyParameters as TomographyParameters,
    TomographyProblem as TomographyProblem,
)
