"""Figures 3-6 and 3-7: true and ghost particles against the number of cameras.

They are compared with the theory of ghosts, and with MART on four cameras.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

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
from sabench.metrics.reconstruction_error import score_frame
from sabench.scenes import Scene, build_rig, load_scene

SEEDS = 5
_MOST = (9, 13)  # numbers of cameras at which the thesis finds most true particles
_LEVEL = 1.0  # percent: true particles within this of their maximum have levelled off


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure the curves, the thesis's claims, and point E of Elsinga et al. (2006)."""
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
