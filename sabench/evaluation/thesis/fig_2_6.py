"""Figure 2-6: Q against density for every baseline in three volumes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from sabench.evaluation.suites import SceneCase
from sabench.evaluation.thesis.common import (
    ADEQUATE,
    METHODS,
    Row,
    cases,
    coarsen,
    density,
    make_row,
    measure_quality,
    per_pixel,
    with_density,
)
from sabench.evaluation.thesis.table_2_1 import BOUNDED, SUITE

SEEDS = 5
PARTS = (0.25, 0.5, 1.0, 1.5, 2.0)  # of the density that the thesis gives for Q = 0.75
_ABSENT = "40x40x30-D0.4-uneven"  # it has no curve


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure the points of each curve.

    The thesis prints only the density where Q crosses 0.75, which is in table 2.1.
    """
    for case in curves():
        for part in PARTS:
            scene = with_density(case.scene, part * density(case.scene))
            found = [measure_quality(coarsen(scene, pixels), seed) for seed in seeds]
            thesis = ADEQUATE if part == 1.0 and case.name not in BOUNDED else None
            for method in METHODS:
                name = f"{case.name}, {method}: Q at {density(scene):.4g} per mm3"
                yield make_row(
                    name,
                    thesis,
                    [frame[method].best for frame in found],
                    f"{per_pixel(scene):.3f} ppp",
                )


def curves() -> list[SceneCase]:
    """List the arrays of table 2.1 that figures 2-6 and 3-8 show."""
    return [case for case in cases(SUITE) if case.name != _ABSENT]
