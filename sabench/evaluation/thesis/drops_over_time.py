"""Drops of a liquid jet in a cross-flow, counted over time (chapter 6).

Drops are detected frame by frame and linked. Their number, their mean and Sauter diameters, and the
number that has passed a plane across the gas are compared with those of the true drops.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.algorithms.particles.linking import link
from sabench.api.make import make_algorithm
from sabench.api.truth import Bubbles
from sabench.evaluation.thesis.chapter_5 import render_frames
from sabench.evaluation.thesis.common import Item, coarsen, make_row
from sabench.metrics.bubble_detection import LARGE_MM, AnyBubbles, match
from sabench.metrics.passages import count_passages
from sabench.metrics.trajectories import trajectory_scores
from sabench.plotting.charts import Curve, Figure, Panel
from sabench.scenes import Scene, load_scene
from sabench.utils.arrays import F64, I64
from sabench.utils.confidence import mean_of
from sabench.utils.progress import console

SEEDS = 3
FRAMES = 8
_PLANE_MM = 45.0  # from the nozzle along the gas: behind the column
_SOLVERS = ("minimum_image", "local_feature")
_TRUTH = "truth"


@dataclass(frozen=True)
class Counted:
    """Large drops of every frame.

    Attributes
    ----------
    number : of drops, in each frame.
    mean_mm, sauter_mm : their mean and Sauter mean diameters; NaN without drops.
    passed : drops that have passed the plane since the first frame.
    """

    number: F64
    mean_mm: F64
    sauter_mm: F64
    passed: F64


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure numbers, diameters, passages and links of large drops."""
    scene = coarsen(load_scene("jet-in-crossflow"), pixels).with_frames(FRAMES)
    counts: dict[str, list[Counted]] = {name: [] for name in (_TRUTH, *_SOLVERS)}
    scores: dict[str, list[dict[str, float]]] = {name: [] for name in _SOLVERS}
    for seed in seeds:
        truth, found = _detect(scene, seed)
        counts[_TRUTH].append(count_drops([one.id for one in truth], truth))
        times = [scene.time_s(frame) for frame in range(scene.frames)]
        for name, every in found.items():
            centers, radii = [one.center_mm for one in every], [one.radius_mm for one in every]
            numbers = link(centers, radii, times)
            counts[name].append(count_drops(numbers, every))
            scores[name].append(
                _recall(every, truth)
                | trajectory_scores(every, numbers, truth, times, [range(scene.frames)])
            )
        console.print(f"drops over time, seed {seed}", markup=False, highlight=False)
    for name in _SOLVERS:
        yield from _rows(name, counts[_TRUTH], counts[name], scores[name])
    yield _figure(scene, counts)


def _detect(scene: Scene, seed: int) -> tuple[list[Bubbles], dict[str, list[AnyBubbles]]]:
    """Render all frames and detect their drops by every solver."""
    truth, found = list[Bubbles](), {name: list[AnyBubbles]() for name in _SOLVERS}
    for _, bubbles, case in render_frames(scene, seed):
        truth.append(bubbles)
        for name, every in found.items():
            algorithm: Any = make_algorithm(name, {})
            every.append(algorithm.solve(case))
    return truth, found


def count_drops(trajectory: Sequence[I64], drops: Sequence[AnyBubbles]) -> Counted:
    """Count drops of 0.5 mm radius and more in every frame.

    Small ones are as wide as a few pixels. A trajectory passes with those of its detections that
    are large.
    """
    kept = [one.radius_mm >= LARGE_MM for one in drops]
    radii = [one.radius_mm[large] for one, large in zip(drops, kept, strict=True)]
    along = [one.center_mm[large, 0] for one, large in zip(drops, kept, strict=True)]
    numbers = [number[large] for number, large in zip(trajectory, kept, strict=True)]
    with np.errstate(invalid="ignore"):
        sauter = [2.0 * np.divide((r**3).sum(), (r**2).sum()) for r in radii]
    mean = [2.0 * float(r.mean()) if len(r) else np.nan for r in radii]
    passed = count_passages(along, numbers, _PLANE_MM)
    return Counted(
        np.array([len(r) for r in radii], dtype=np.float64),
        np.array(mean),
        np.array(sauter),
        np.array(passed, dtype=np.float64),
    )


def _recall(found: Sequence[AnyBubbles], truth: Sequence[AnyBubbles]) -> dict[str, float]:
    """Compute recall and ghosts of large drops in percent, over all frames."""
    hits, there, ghosts = 0, 0, 0
    for one, true in zip(found, truth, strict=True):
        i, j = match(one.center_mm, true.center_mm, true.radius_mm)
        hits += int((true.radius_mm[j] >= LARGE_MM).sum())
        there += int((true.radius_mm >= LARGE_MM).sum())
        ghost = np.setdiff1d(np.arange(len(one.center_mm)), i)
        ghosts += int((one.radius_mm[ghost] >= LARGE_MM).sum())
    return {
        "recall_percent": 100.0 * hits / max(there, 1),
        "ghost_percent": 100.0 * ghosts / max(hits, 1),
    }


def _rows(
    name: str,
    truth: Sequence[Counted],
    found: Sequence[Counted],
    scores: Sequence[dict[str, float]],
) -> Iterator[Item]:
    pairs = list(zip(found, truth, strict=True))
    figures = {
        "drops, found over true": [one.number.mean() / true.number.mean() for one, true in pairs],
        "mean diameter, found over true": [
            np.nanmean(one.mean_mm) / np.nanmean(true.mean_mm) for one, true in pairs
        ],
        "Sauter diameter, found over true": [
            np.nanmean(one.sauter_mm) / np.nanmean(true.sauter_mm) for one, true in pairs
        ],
        "passages, counted over true": [
            one.passed[-1] / max(true.passed[-1], 1.0) for one, true in pairs
        ],
    } | {
        what: [one[key] for one in scores]
        for key, what in {
            "recall_percent": "recall, %",
            "ghost_percent": "ghosts, %",
            "link_recall": "link recall",
            "link_precision": "link precision",
            "velocity_percent": "velocity error, %",
        }.items()
    }
    for what, values in figures.items():
        known = [float(value) for value in values if np.isfinite(value)]
        yield make_row(f"{name}: {what}", None, known)


def _figure(scene: Scene, counts: dict[str, list[Counted]]) -> Figure:
    """Draw number, diameters and passages over time, with intervals over the seeds."""
    times = [1e3 * scene.time_s(frame) for frame in range(scene.frames)]
    kinds = {
        "number": "drops of 0.5 mm radius and more",
        "mean_mm": "mean diameter, mm",
        "sauter_mm": "Sauter diameter, mm",
        "passed": f"passed X = {_PLANE_MM:g} mm",
    }
    panels = [
        Panel("", "time, ms", label, tuple(_curve(name, times, kind, counts) for name in counts))
        for kind, label in kinds.items()
    ]
    return Figure("drops-over-time", "drops over time", tuple(panels), across=2)


def _curve(name: str, times: list[float], kind: str, counts: dict[str, list[Counted]]) -> Curve:
    series = np.array([getattr(one, kind) for one in counts[name]])
    means = [mean_of(values[np.isfinite(values)].tolist()) for values in series.T]
    known = [(time, mean) for time, mean in zip(times, means, strict=True) if mean]
    return Curve(
        name,
        [time for time, _ in known],
        [mean.mean for _, mean in known],
        [mean.half_width or 0.0 for _, mean in known],
    )
