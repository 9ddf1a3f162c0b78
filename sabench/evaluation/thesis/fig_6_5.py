"""Figures 6-4 and 6-5: liquid jet in a cross-flow, refocused, and its drops.

One camera's image and refocused planes at several depths are shown; detected drops are counted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from sabench.algorithms.bubbles.feature_potential import darkness
from sabench.api import Observation
from sabench.api.make import make_algorithm
from sabench.evaluation.thesis.chapter_5 import render_first_frame
from sabench.evaluation.thesis.common import Item, coarsen, make_row
from sabench.metrics.bubble_detection import detection_scores
from sabench.plotting.charts import Figure, Panel, Picture
from sabench.scenes import load_scene

SEEDS = 3
_DEPTHS_MM = (-8.0, 0.0, 8.0)
_SOLVERS = ("minimum_image", "local_feature")


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure F1 and errors of drops per solver; the thesis shows only images."""
    scene = coarsen(load_scene("jet-in-crossflow"), pixels)
    found: dict[str, list[dict[str, float]]] = {name: [] for name in _SOLVERS}
    for seed in seeds:
        _, bubbles, case = render_first_frame(scene, seed)
        if seed == seeds[0]:
            yield _figure(case)
        for name in _SOLVERS:
            algorithm: Any = make_algorithm(name, {})
            found[name].append(
                detection_scores(algorithm.solve(case), bubbles, np.ones(len(bubbles)))
            )
    for name, every in found.items():
        for key, what in {
            "f1_large": "F1 of drops of 0.5 mm radius and more",
            "f1": "F1 of all drops",
            "depth_mm": "depth error, mm",
        }.items():
            yield make_row(f"{name}: {what}", None, [one[key] for one in every])


def _figure(case: Observation) -> Figure:
    """Draw one view, and the refocused planes."""
    view, grid, volume = (
        case.images[len(case.images) // 2].astype(np.float64),
        case.grid,
        darkness(case),
    )
    x, y, z = grid.axes_mm
    panels = [
        Panel(
            "one view",
            "px",
            "px",
            (Picture(view, (0.0, 0.0), (view.shape[1] - 1.0, view.shape[0] - 1.0)),),
        )
    ]
    for depth in _DEPTHS_MM:
        plane = int(np.abs(z - depth).argmin())
        seen = Picture(
            1.0 - volume[plane].astype(np.float64),
            (float(x[0]), float(y[0])),
            (float(x[-1]), float(y[-1])),
        )
        panels.append(Panel(f"Z = {z[plane]:.1f} mm", "X, mm", "Y, mm", (seen,)))
    return Figure(
        "fig-6-5", "a liquid jet in a cross-flow", tuple(panels), across=2, inch=(5.0, 4.4)
    )
