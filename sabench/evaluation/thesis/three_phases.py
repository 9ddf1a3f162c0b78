"""Bubbles, a body and tracers in one picture: what chapter 6 hopes for.

The images are separated by phase, and each phase is scored: bubbles, tracers, and the outline of
the body. The same solvers on the raw images show what separation gains.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.algorithms.bubbles import image_diameter_px, separate_phases
from sabench.api import FoundParticles, ImageSequence, Observation
from sabench.api.make import make_algorithm
from sabench.api.truth import BODY, Bubbles, Particles, Sight
from sabench.evaluation.thesis.common import Item, coarsen, make_row
from sabench.metrics.bubble_detection import detection_scores
from sabench.metrics.particle_detection import challenge_pairs
from sabench.plotting.charts import Figure, Panel, Picture
from sabench.scenes import Scene, build_rig, load_scene
from sabench.simulation.camera_view import record_image, render
from sabench.simulation.frames import Frames
from sabench.simulation.in_memory import observation_of
from sabench.utils.arrays import Bool
from sabench.utils.progress import console

SEEDS = 3
_LARGEST_MM = 1.6  # as the solvers take it
_BUBBLES, _TRACERS = ("rim_fit", "separated_bubbles"), ("bayesian_ipr", "separated_tracers")
_KEYS = ("recall", "precision", "radius_percent", "plane_mm", "depth_mm")


@dataclass(frozen=True)
class _Shot:
    """One frame, and the truth of its three phases."""

    case: Observation
    bubbles: Bubbles
    particles: Particles
    lit: Bool
    sights: tuple[Sight, ...]


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure each phase with and without separation; the thesis shows no such flow."""
    scene = coarsen(load_scene("three-phases"), pixels)
    found: list[dict[str, float]] = []
    for seed in seeds:
        shot = _record(scene, seed)
        found.append(_bubbles(shot) | _tracers(shot) | _body(shot))
        console.print(f"three phases, seed {seed}: measured", markup=False, highlight=False)
        if seed == seeds[0]:
            yield _figure(shot.case)
    for what in found[0]:
        values = [one[what] for one in found]
        yield make_row(what, None, [value for value in values if np.isfinite(value)])


def _record(scene: Scene, seed: int) -> _Shot:
    frame = Frames(scene, build_rig(scene, scene.title), seed).at(0)
    views = [render(frame, number) for number in range(len(frame.rig.cameras))]
    case = observation_of(frame, [record_image(frame, v, n) for n, v in enumerate(views)])
    sights = tuple(view.sight for view in views if view.sight is not None)
    images = [view.particles for view in views if view.particles is not None]
    if frame.bubbles is None or frame.tracers is None:
        raise ValueError(f"{scene.title}: expected bubbles and tracers")
    seen = np.mean([one.visible & (one.photons > 0.0) for one in images], axis=0)
    return _Shot(case, frame.bubbles, frame.tracers.particles, seen > 0.5, sights)


def _bubbles(shot: _Shot) -> dict[str, float]:
    visible = np.mean([sight.visible for sight in shot.sights], axis=0)
    out: dict[str, float] = {}
    for name in _BUBBLES:
        algorithm: Any = make_algorithm(name, {})
        scores = detection_scores(algorithm.solve(shot.case), shot.bubbles, visible)
        out |= {f"bubbles, {name}: {key}": scores[key] for key in _KEYS}
    return out


def _tracers(shot: _Shot) -> dict[str, float]:
    """Compute recall of all tracers and of those seen by most, and ghosts."""
    out: dict[str, float] = {}
    grid = shot.case.grid
    true = grid.to_voxels(shot.particles.position_mm)
    scored = grid.in_scored(true)
    for name in _TRACERS:
        algorithm: Any = make_algorithm(name, {})
        sequence = ImageSequence(shot.case.cameras, grid, (0.0,), lambda _: shot.case)
        found: FoundParticles = next(iter(algorithm.solve(sequence)))
        places = grid.to_voxels(found.position_mm)
        i, j = challenge_pairs(places, true)
        hit, ghost = np.zeros(len(true), dtype=np.bool_), np.ones(len(places), dtype=np.bool_)
        hit[j], ghost[i] = True, False
        ghosts = int((ghost & grid.in_scored(places)).sum())
        out |= {
            f"tracers, {name}: recall": float(hit[scored].mean()),
            f"tracers, {name}: recall of those seen": float(hit[scored & shot.lit].mean()),
            f"tracers, {name}: ghosts, %": 100.0 * ghosts / max(int(hit[scored].sum()), 1),
        }
    return out


def _body(shot: _Shot) -> dict[str, float]:
    """Compare the body's pixels with those that show it: intersection over union."""
    body = separate_phases(shot.case, image_diameter_px(shot.case, _LARGEST_MM)).body
    true = np.stack([sight.number <= BODY for sight in shot.sights])
    return {"body: intersection over union": overlap(body, true)}


def overlap(found: Bool, true: Bool) -> float:
    """Compute intersection over union of pixels; 1 where both are empty."""
    union = int((found | true).sum())
    return float((found & true).sum() / union) if union else 1.0


def _figure(case: Observation) -> Figure:
    """Draw one view and its three parts."""
    parts, middle = (
        separate_phases(case, image_diameter_px(case, _LARGEST_MM)),
        len(case.images) // 2,
    )
    shown = {
        "one view": case.images[middle],
        "bubbles": parts.bubbles.images[middle],
        "tracers": parts.tracers.images[middle],
        "body": parts.body[middle],
    }
    panels = [
        Panel(
            name,
            "px",
            "px",
            (
                Picture(
                    image.astype(np.float64), (0.0, 0.0), (image.shape[1] - 1.0, len(image) - 1.0)
                ),
            ),
        )
        for name, image in shown.items()
    ]
    return Figure("three-phases", "three phases", tuple(panels), across=2, inch=(4.6, 3.6))
