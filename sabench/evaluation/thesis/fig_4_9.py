"""Figure 4-9: Newton's iteration for the light path through a wall.

The thesis's equations 4.20 and 4.21 have two unknowns; sabench solves for one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.thesis.chapter_4 import scene_of
from sabench.evaluation.thesis.common import Row, claim, make_row
from sabench.geometry.refraction import trace_to_points
from sabench.scenes import build_rig
from sabench.utils.arrays import F64

SEEDS = 1
_TOLERANCE, _STEPS = 1e-8, 10
_POINTS = 2000


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Count steps to 1e-8, and compare the paths of both methods."""
    camera = build_rig(scene_of(9, 0.3, 0.0, 0.0)).cameras[0]
    rng = np.random.default_rng(seeds[0])
    points = np.array([0.0, 0.0, 35.0]) + 50.0 * (rng.random((_POINTS, 3)) - 0.5)
    wall, center = camera.wall, np.asarray(camera.center_mm)
    assert wall is not None
    radius = np.linalg.norm(points[:, :2] - center[:2], axis=1)
    depths = -center[2], wall.thickness_mm, points[:, 2] - wall.thickness_mm
    outer, steps = two_unknowns(wall.indices, depths, radius)
    yield claim(
        f"steps to {_TOLERANCE:g}, at most",
        "fewer than 10",
        float(steps.max()),
        bool(steps.max() < _STEPS),
        f"{_POINTS} points, mean {steps.mean():.2f}",
    )
    leaving = trace_to_points(wall, center, points).leaving
    ours = np.linalg.norm(leaving[:, :2], axis=1) / leaving[:, 2] * depths[0]
    yield make_row(
        "largest difference of the two ways on the wall's face, mm",
        None,
        [float(np.abs(ours - outer).max())],
        "two derivations of one path",
    )


def two_unknowns(indices: F64, depths: tuple[float, float, F64], radius: F64) -> tuple[F64, F64]:
    """Solve equations 4.20 to 4.23 with the derivatives of appendix B.

    It starts from the straight line. Returns r_A (n,) on the outer face, and the numbers of steps
    (n,).
    """
    first, second = indices[1] / indices[0], indices[2] / indices[1]
    straight = radius / (depths[0] + depths[1] + depths[2])
    a, b = straight * depths[0], straight * (depths[0] + depths[1])
    steps, open_ = np.zeros(len(radius)), np.ones(len(radius), dtype=np.bool_)
    for _ in range(50):
        (sa, da), (sb, db), (sp, dp) = (
            _sine(x, depth)
            for x, depth in ((a, depths[0]), (b - a, depths[1]), (radius - b, depths[2]))
        )
        f, g = sa - first * sb, sb - second * sp
        open_ &= np.maximum(np.abs(f), np.abs(g)) > _TOLERANCE
        if not open_.any():
            break
        fa, fb, ga, gb = da + first * db, -first * db, -db, db + second * dp
        determinant = fa * gb - fb * ga
        a, b = (
            a - np.where(open_, (f * gb - g * fb) / determinant, 0.0),
            b - np.where(open_, (g * fa - f * ga) / determinant, 0.0),
        )
        steps += open_
    return a, steps


def _sine(lateral: F64, depth: float | F64) -> tuple[F64, F64]:
    """Compute the sine of a path's angle, and its derivative by lateral distance."""
    length = np.sqrt(lateral**2 + np.square(depth))
    return lateral / length, np.square(depth) / length**3
