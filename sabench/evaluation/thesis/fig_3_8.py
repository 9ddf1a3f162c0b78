"""Figure 3-8: true and ghost particles against the number of particles.

There are 25 cameras and three volumes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.thesis.common import (
    METHODS,
    Row,
    claim,
    coarsen,
    count_methods,
    density,
    detection_rows,
    with_density,
)
from sabench.evaluation.thesis.fig_2_6 import PARTS, curves
from sabench.utils.arrays import F64

SEEDS = 5
_LINEAR = 0.9  # share of the variance that a straight line explains


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure the curves, and the thesis's claims about their shapes."""
    for case in curves():
        points: dict[str, list[list[Row]]] = {method: [] for method in METHODS}
        for part in PARTS:
            scene = with_density(case.scene, part * density(case.scene))
            found = [count_methods(coarsen(scene, pixels), seed) for seed in seeds]
            count = round(density(scene) * float(np.prod(scene.volume.size_mm)))
            for method, curve in points.items():
                curve.append(
                    detection_rows(
                        f"{case.name}, {method}, {count} particles",
                        [frame[method] for frame in found],
                    )
                )
                yield from curve[-1]
        for method, curve in points.items():
            yield from _claims(f"{case.name}, {method}", *zip(*curve, strict=True))


def _claims(where: str, true: Sequence[Row], ghosts: Sequence[Row]) -> Iterator[Row]:
    slope, straight = _line(np.array(PARTS), np.array([row.measured or 0.0 for row in true]))
    falls = slope < 0.0 and straight >= _LINEAR
    yield claim(
        f"{where}: true %",
        "falls linearly",
        straight,
        falls,
        "share of the variance that a straight line explains",
    )
    known = [(part, row.measured) for part, row in zip(PARTS, ghosts, strict=True) if row.measured]
    power = _line(*np.log(np.transpose(known)))[0] if len(known) > 1 else None
    yield claim(
        f"{where}: ghost %",
        "grows faster than linearly",
        power,
        power is not None and power > 1.0,
        "power of the number of particles",
    )


def _line(x: F64, y: F64) -> tuple[float, float]:
    """Fit a line: its slope, and the fraction of the variance that it explains."""
    slope, _ = np.polyfit(x, y, 1)
    return float(slope), float(np.corrcoef(x, y)[0, 1] ** 2)
