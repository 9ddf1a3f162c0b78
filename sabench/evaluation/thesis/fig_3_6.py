"""Figures 3-6 and 3-7: true and ghost particles against the number of cameras.

They are compared with the theory of ghosts, and with tomography on few cameras: MART on four after
Elsinga et al. (point E), and three algorithms on three after Atkinson and Soria (points A1 to A3).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sabench.api import Solver
from sabench.api.make import make_solver
from sabench.evaluation.thesis.common import (
    METHODS,
    Row,
    claim,
    coarsen,
    count_methods,
    detection_rows,
    make_row,
    per_pixel,
    simulate_frame,
)
from sabench.evaluation.thesis.fig_2_7 import CAMERAS, by_cameras
from sabench.evaluation.thesis.theory import ghost_ratio
from sabench.metrics.particle_detection import Counts, count_thesis, detect
from sabench.metrics.reconstruction_error import score_frame
from sabench.scenes import Scene, build_rig, load_scene
from sabench.simulation.in_memory import Shot, simulate

SEEDS = 5
_MOST = (9, 13)  # numbers of cameras at which the thesis finds most true particles
_SLICES = 20  # of 50 particles, for one seed
_POINTS = {"A1": ("mlos_sart", 1), "A2": ("mlos_smart", 1), "A3": ("mart", 5)}  # with iterations
_LEVEL = 1.0  # percent: true particles within this of their maximum have levelled off


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure the curves, the thesis's claims, and the points from the literature."""
    curves: dict[str, list[_Point]] = {}
    for cameras, case in by_cameras(CAMERAS):
        found = [count_methods(coarsen(case.scene, pixels), seed) for seed in seeds]
        for method in METHODS:
            where = f"at {per_pixel(case.scene):.3f} ppp, {method}"
            predicted = predicted_percent(case.scene)
            note = f"equation 3.14: {predicted:.3g} ghosts per 100 particles"
            true, ghosts = detection_rows(
                f"{cameras} cameras {where}", [frame[method] for frame in found], note
            )
            curves.setdefault(where, []).append(
                _Point(cameras, true.measured, ghosts.measured, predicted)
            )
            yield from (true, ghosts)
    for where, curve in curves.items():
        yield from _claims(where, curve)
    yield from _elsinga_rows(seeds, pixels)
    yield from _atkinson_rows(seeds, next(iter(curves.values())))


@dataclass(frozen=True)
class _Point:
    """Percentages of true, ghost and predicted ghost particles of one array."""

    cameras: int
    true: float | None
    ghosts: float | None
    predicted: float


def predicted_percent(scene: Scene) -> float:
    """Compute ghosts per 100 particles by equation 3.14.

    A particle's image extends two standard deviations from its centre.
    """
    rig = build_rig(scene)
    area = np.pi * (2.0 * (scene.cameras.particle_sigma_px or 0.5)) ** 2
    return 100.0 * ghost_ratio(per_pixel(scene), len(rig.cameras), area, rig.grid.shape[0])


def _claims(where: str, curve: Sequence[_Point]) -> Iterator[Row]:
    ghosts = {point.cameras: point.ghosts for point in curve if point.ghosts}
    fewest, most = min(ghosts, default=0), max(ghosts, default=0)
    ratio = ghosts[most] / ghosts[fewest] if ghosts else None
    note = f"ghosts with {most} over ghosts with {fewest} cameras"
    yield claim(
        f"ghosts {where}",
        "fall with the number of cameras",
        ratio,
        ratio is not None and ratio < 1.0,
        note,
    )
    true = {point.cameras: point.true or 0.0 for point in curve}
    peak = max(true, key=lambda cameras: true[cameras])
    level = true[peak] - max(true[cameras] for cameras in _MOST)
    yield claim(
        f"true particles {where}",
        "peak or level off at 9 to 13 cameras",
        level,
        level <= _LEVEL,
        f"percent below the peak, at {peak} cameras",
    )
    off = [abs(np.log10(point.predicted / point.ghosts)) for point in curve if point.ghosts]
    wrong = float(max(off, default=0.0))
    yield claim(
        f"equation 3.14 {where}",
        "does not predict the ghosts",
        wrong,
        wrong > 1.0,
        "powers of ten between them at most",
    )


def _elsinga_rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Compare with MART: fewer particles missed, but ten times the ghosts.

    The thesis takes MART's figures from the literature.
    """
    scene, scores = coarsen(load_scene("elsinga-35x35x7"), pixels), []
    for seed in seeds:
        shot = simulate_frame(scene, seed)
        guess = make_solver("mart", {}).solve(shot.observation)
        scores.append(score_frame(shot.observation.grid, shot.particles, shot.views, guess))
    for key, heading in (("true_percent", "true %"), ("ghost_percent", "ghost %"), ("q", "Q")):
        values = [value for score in scores if (value := score[key]) is not None]
        yield make_row(
            f"4 cameras at 0.050 ppp after Elsinga et al., MART: {heading}", None, values
        )


def _atkinson_rows(seeds: Sequence[int], refocused: Sequence[_Point]) -> Iterator[Row]:
    """Count particles in slices of one voxel, which have no coarse copy.

    Parameters
    ----------
    refocused : the curve of the lowest density.
    """
    slices = load_scene("atkinson-1000x1x200")
    found: dict[str, list[Counts]] = {point: [] for point in _POINTS}
    for seed in seeds:
        numbers = range(seed * _SLICES, (seed + 1) * _SLICES)
        shots = [simulate(slices, seed=number) for number in numbers]
        for point, (solver, iterations) in _POINTS.items():
            chosen = make_solver(solver, {"iterations": iterations})
            found[point].append(_add(_count(shot, chosen) for shot in shots))
    ghosts = []
    for point, (solver, iterations) in _POINTS.items():
        name = f"3 cameras at 0.017 ppp after Atkinson and Soria, {point}, {iterations} x {solver}"
        rows = detection_rows(name, found[point])
        ghosts.append(rows[-1].measured or 0.0)
        yield from rows
    fewer = [point.cameras for point in refocused if (point.ghosts or 0.0) < min(ghosts)]
    yield claim(
        "ghosts of A1 to A3",
        "more than of synthetic apertures",
        min(ghosts),
        bool(fewer),
        f"percent, of the best of them; at 0.05 ppp, refocusing has fewer with {fewer} cameras",
    )


def _count(shot: Shot, solver: Solver) -> Counts:
    grid, found = shot.observation.grid, detect(solver.solve(shot.observation).volume)
    truth = grid.to_voxels(shot.particles.position_mm)
    return count_thesis(found, truth, grid.in_scored(found), grid.in_scored(truth))


def _add(slices: Iterable[Counts]) -> Counts:
    every = list(slices)
    return Counts(
        sum(one.truths for one in every),
        sum(one.detections for one in every),
        sum(one.matched for one in every),
        None,
    )
