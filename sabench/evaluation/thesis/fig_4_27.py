"""Figure 4-27: cameras refitted to moved boards.

The images stay as they were, which shows the motions that the wall does not leave open.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import refine, residuals
from sabench.algorithms.calibration.parameters import FreeParameters
from sabench.algorithms.calibration.problem import CalibrationProblem
from sabench.evaluation.thesis.chapter_4 import Board, board, with_points
from sabench.evaluation.thesis.common import Item, claim, make_row
from sabench.geometry.rotations import rotation_matrices
from sabench.plotting.charts import Curve, Figure, Panel
from sabench.utils.arrays import F64

SEEDS = 1
_DEGREES = np.arange(-4.0, 4.01, 1.0)
_SHIFTS = np.arange(0.0, 50.1, 10.0)


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure the mean reprojection error of nine cameras for every motion.

    Motions are rotations about the vertical axis and shifts along Z.
    """
    given, panels = board(9, 0.3, 0.0, 0.0, seeds[0]), []
    for name, moves in (("turn, degrees", _DEGREES), ("shift, mm", _SHIFTS)):
        errors = []
        for move in moves:
            errors.append(_refit(given, _move(given.points_mm, name, float(move))))
            yield make_row(f"{name} {move:g}: mean error, px", None, [errors[-1]])
        panels.append(Panel("", name, "mean error, px", (Curve(name, moves.tolist(), errors),)))
        still = float(errors[int(np.flatnonzero(moves == 0.0)[0])])
        least = min(error for error, move in zip(errors, moves, strict=True) if move != 0.0)
        yield claim(
            f"{name}: moved points cannot be fitted",
            "errors above zero",
            float(least),
            bool(still < 1e-4 < least),
            f"unmoved {still:.2g} px",
        )
    yield Figure("fig-4-27", "Figure 4-27: cameras refitted to moved boards", tuple(panels))


def _move(points: F64, name: str, move: float) -> F64:
    middle = points.mean(axis=(0, 1))
    if name.startswith("turn"):
        return np.asarray(
            (points - middle) @ rotation_matrices(np.deg2rad([0.0, move, 0.0])).T + middle
        )
    return np.asarray(points + np.array([0.0, 0.0, move]))


def _refit(given: Board, points: F64) -> float:
    problem = CalibrationProblem.from_case(with_points(given, points).case, FreeParameters())
    fit = refine(problem.start, problem.seen, FreeParameters(), moving="cameras")
    return float(
        np.nanmean(
            np.linalg.norm(residuals(fit.state, problem.seen), axis=-1)[problem.seen.weights > 0.0]
        )
    )
