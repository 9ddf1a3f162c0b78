"""Table 2.3: particles per pixel of all cameras together.

A large number is efficient only if the reconstruction is adequate.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.thesis.common import (
    ADEQUATE,
    METHODS,
    Row,
    at_least,
    cases,
    coarsen,
    density,
    make_row,
    measure_quality,
    per_pixel,
)
from sabench.scenes import build_rig

SEEDS = 5
_PER_PIXEL, _PER_TOTAL_PIXEL, _PARTICLES = 0.125, 0.01, 125_000


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Load the table's simulated array of 13 cameras."""
    for case in cases("table-2-3"):
        cameras = len(build_rig(case.scene).cameras)
        count = density(case.scene) * float(np.prod(case.scene.volume.size_mm))
        yield make_row("particles", _PARTICLES, [count])
        yield make_row("particles per pixel", _PER_PIXEL, [per_pixel(case.scene)])
        yield make_row(
            "particles per pixel of all cameras",
            _PER_TOTAL_PIXEL,
            [per_pixel(case.scene) / cameras],
            "the thesis rounds",
        )
        found = [measure_quality(coarsen(case.scene, pixels), seed) for seed in seeds]
        for method in METHODS:
            values = [frame[method].best for frame in found]
            yield at_least(
                f"Q of {cameras} cameras, {method}",
                ADEQUATE,
                values,
                "the thesis calls 0.75 adequate and states no value",
            )
