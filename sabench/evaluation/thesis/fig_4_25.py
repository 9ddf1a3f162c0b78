"""Figures 4-25 and 4-26: plane spacing of a traversed grid.

It is calibrated from poorer and poorer initial guesses, in the camera array of the vortex ring's
experiment.

The experiment's traverse moved the grid by 4 mm, to 0.01 mm; here it does so exactly, so that all
that is left is the calibration's own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.thesis.common import Item, claim, make_row
from sabench.evaluation.thesis.traverse import PLANES, SOLVERS, STEP_MM, STEPS, calibrate
from sabench.geometry.rigid_motion import fit_rigid_motion
from sabench.plotting.charts import Curve, Figure, Panel
from sabench.utils.arrays import F64
from sabench.utils.progress import progress_bar

SEEDS = 5
_FLUCTUATION_MM = 0.02


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure errors of mean spacings per solver and test; compare the tests."""
    found: dict[tuple[str, str], list[F64]] = {}
    turns: dict[tuple[str, str], list[float]] = {}
    for seed in progress_bar(seeds, "traversed grids"):
        for name, solver in SOLVERS.items():
            first: F64 | None = None
            for test, step in STEPS.items():
                positions = calibrate(solver, step, seed).points_mm
                first = positions if first is None else first
                found.setdefault((name, test), []).append(
                    np.stack([np.diff(positions[..., 2], axis=0).mean(axis=1), _scatter(positions)])
                )
                turns.setdefault((name, test), []).append(_turn_deg(positions, first))
    for (name, test), draws in found.items():
        off = [float(np.abs(own[0] - STEP_MM).max()) for own in draws]
        head = f"{name}, {test} (nominal {STEPS[test]:g} mm)"
        yield make_row(
            f"{head}: largest error of a mean spacing, mm",
            None,
            off,
            f"points scatter by {np.mean([own[1] for own in draws]):.3g} mm",
        )
        if test == "test 1":
            continue
        between = [
            float(np.abs(own[0] - ref[0]).max())
            for own, ref in zip(draws, found[name, "test 1"], strict=True)
        ]
        mean = float(np.mean(between))
        yield claim(
            f"{head}: largest difference of a spacing to test 1, mm",
            "all tests alike to 0.02 mm",
            mean,
            mean <= _FLUCTUATION_MM,
        )
        yield make_row(
            f"{head}: turn of all points against test 1, degrees",
            None,
            turns[name, test],
            "thesis, figure 4-26: seen, without a number",
        )
    yield _figure(found)


def _scatter(positions: F64) -> F64:
    return np.asarray(np.diff(positions[..., 2], axis=0).std(axis=1))


def _turn_deg(positions: F64, reference: F64) -> float:
    turn = fit_rigid_motion(positions.reshape(-1, 3), reference.reshape(-1, 3)).rotation
    return float(np.rad2deg(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))))


def _figure(found: dict[tuple[str, str], list[F64]]) -> Figure:
    """Draw the first seed, as the thesis shows its one experiment."""
    numbers = range(1, PLANES)
    panels = []
    for name in SOLVERS:
        curves = tuple(
            Curve(test, numbers, found[name, test][0][0], found[name, test][0][1]) for test in STEPS
        )
        panels.append(Panel(name, "k", "spacing of planes k and k + 1, mm", curves))
    return Figure("fig-4-25", "Figure 4-25: spacing of the planes, 0.1 px", tuple(panels))
