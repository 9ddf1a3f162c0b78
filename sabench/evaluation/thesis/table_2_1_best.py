"""Q of the best tomographic solver at 1.5 times the densities of table 2.1.

It uses the same images.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from sabench.api.make import make_solver
from sabench.evaluation.thesis.common import (
    ADEQUATE,
    Row,
    at_least,
    cases,
    coarsen,
    density,
    simulate_frame,
    with_density,
)
from sabench.evaluation.thesis.table_2_1 import SUITE
from sabench.metrics.quality_factor import quality
from sabench.metrics.synthesised_field import true_field
from sabench.scenes import Scene

SEEDS = 5
SOLVERS = (
    "mlos_smart",
    "mlos_sart",
    "block_mart",
    "smart",
    "mfg_mart",
    "mart",
)  # the quickest first
_DENSER = 1.5
_TRIAL_PX = 100  # side of the images on which the solver is chosen: at full size each takes minutes
_AS_GOOD = 0.01  # in Q


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure Q of the fastest of the solvers that are best on a coarse array."""
    for case in cases(SUITE):
        per_mm3 = _DENSER * density(case.scene)
        scene = with_density(case.scene, per_mm3)
        trial = coarsen(scene, min(pixels or _TRIAL_PX, _TRIAL_PX))
        tried = {name: solved_quality(name, trial, seeds[0]) for name in SOLVERS}
        best = next(name for name in SOLVERS if tried[name] >= max(tried.values()) - _AS_GOOD)
        values = [solved_quality(best, coarsen(scene, pixels), seed) for seed in seeds]
        others = ", ".join(f"{name} {value:.3f}" for name, value in tried.items())
        yield at_least(
            f"{case.name}: Q at {per_mm3:.4g} per mm3",
            ADEQUATE,
            values,
            f"{best}; coarse: {others}",
        )


def solved_quality(solver: str, scene: Scene, seed: int) -> float:
    """Compute Q of a solver with its own parameters on one frame."""
    shot = simulate_frame(scene, seed)
    grid = shot.observation.grid
    volume = make_solver(solver, {}).solve(shot.observation).volume
    return quality(volume[grid.scored], true_field(grid, shot.particles, shot.views)[grid.scored])
