"""Figures 4-16 and 4-17: alternating calibration on random camera subsets.

Subsets of eight cameras are compared with all cameras, and with the joint adjustment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.thesis.chapter_4 import (
    D_PIX,
    NOISES,
    STARTS,
    board,
    point_errors,
    solve_case,
    stds,
)
from sabench.evaluation.thesis.common import Item, claim, make_row
from sabench.plotting.charts import Curve, Figure, Panel
from sabench.utils.arrays import F64
from sabench.utils.progress import progress_bar

SEEDS = 5
_SOLVERS = {
    "alternating": "refractive_autocal_alternating",
    "randomised": "refractive_autocal_randomised",
    "joint": "refractive_autocal",
}


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure the scatter of the points' errors over all initial guesses.

    The thesis shows histograms without numbers.
    """
    better, panels = [], []
    for noise in NOISES:
        scatter = {}
        steps = [(start, seed) for start in STARTS for seed in seeds]
        errors: dict[str, dict[float, list[F64]]] = {
            name: {start: [] for start in STARTS} for name in _SOLVERS
        }
        for start, seed in progress_bar(steps, f"8 cameras, {noise:g} px"):
            given = board(8, 0.3, noise, start, seed)
            for name, solver in _SOLVERS.items():
                errors[name][start].append(point_errors(solve_case(solver, given), given))
        for name, own in errors.items():
            scatter[name] = stds([one for draws in own.values() for one in draws]) / D_PIX
            note = f"X, Y, Z: {', '.join(f'{value:.3g}' for value in scatter[name])}"
            yield make_row(
                f"8 cameras, {noise:g} px, {name}: scatter along Z, pixels of the middle",
                None,
                [float(scatter[name][2])],
                note,
            )
        curves = [
            Curve(name, STARTS, [float(stds(draws)[2]) / D_PIX for draws in own.values()])
            for name, own in errors.items()
        ]
        panels.append(
            Panel(
                f"{noise:g} px",
                "start",
                "scatter along Z, pixels of the middle",
                tuple(curves),
                "xy",
            )
        )
        better.append(float(scatter["randomised"][2] / scatter["alternating"][2]))
    yield claim(
        "randomised over alternating, scatter along Z",
        "smaller",
        float(np.mean(better)),
        bool(np.mean(better) < 1.0),
        f"by noise: {np.round(better, 2)}",
    )
    yield Figure("fig-4-16", "Figures 4-16 and 4-17: random subsets of 8 cameras", tuple(panels))
