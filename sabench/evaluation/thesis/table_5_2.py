"""Table 5.2 and section 5.5: three plunging jets from detected bubbles.

Penetration depth, angle and scaling are those of bubbles detected in rendered frames.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from sabench.api import Detections, Observation
from sabench.api.make import make_algorithm
from sabench.api.truth import Bubbles
from sabench.evaluation.thesis.chapter_5 import pictures, render_first_frame
from sabench.evaluation.thesis.common import Item, coarsen, make_row
from sabench.metrics.bubble_detection import AnyBubbles, detection_scores
from sabench.plotting.charts import Curve, Figure, Panel, Space
from sabench.scenes import Scene, load_scene
from sabench.simulation.frame_content import FrameContent
from sabench.simulation.rendering.pixel_truth import see
from sabench.tasks.bubbles import JET, jet_figures, jet_of
from sabench.utils.progress import console
from sabench.worlds.library.plunging_jet import JetLaw

SEEDS = 10
_HEIGHTS, _PICTURED = (
    (7, 21, 43),
    21,
)  # mm of the nozzle above the surface; that of figures 5-5 to 5-11
_SOLVER = "rim_fit"
_THESIS = {
    7: (211.5, 11.6),
    21: (160.0, 10.9),
    43: (120.0, 11.3),
}  # table 5.2: Y_p in mm, angle in degrees
_SCALING = {"weight": 0.903, "width": 0.1894}  # of equation 5.18
_LARGE = {
    "f1_large": "F1 of bubbles of 0.5 mm radius and more",
    "radius_percent": "radius error, %",
    "depth_mm": "depth error, mm",
}


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure errors of the bubbles, and the jet's figures, per jet.

    Errors are means over frames. Figures are from all frames together, of true and of detected
    bubbles.
    """
    for height in _HEIGHTS:
        scene = coarsen(load_scene(f"plunging-jet-{height}"), pixels)
        true: list[AnyBubbles] = []
        found: list[AnyBubbles] = []
        scores: list[dict[str, float]] = []
        for seed in seeds:
            frame, bubbles, case = render_first_frame(scene, seed)
            if (height, seed) == (_PICTURED, seeds[0]):
                yield from pictures(case)
            start = time.perf_counter()
            guess = _solve(case)
            spent = time.perf_counter() - start
            scores.append(detection_scores(guess, bubbles, _visible_part(frame, bubbles)))
            console.print(
                f"h = {height} mm, seed {seed}: F1 {scores[-1]['f1_large']:.3f}, {spent:.0f} s",
                markup=False,
                highlight=False,
            )
            true.append(bubbles)
            found.append(guess)
        yield from _figures(scene, height, true, found)
        yield from _rows(scene, height, scores, true, found)


def _solve(case: Observation) -> Detections:
    algorithm: Any = make_algorithm(_SOLVER, {})
    made: Detections = algorithm.solve(case)
    return made


def _visible_part(frame: FrameContent, bubbles: Bubbles) -> Any:
    """Average the visible part of each bubble's outline over the cameras."""
    sights = [see(camera, bubbles, frame.solids) for camera in frame.rig.cameras]
    return np.mean([sight.visible for sight in sights], axis=0)


def _rows(
    scene: Scene,
    height: int,
    scores: list[dict[str, float]],
    true: list[AnyBubbles],
    found: list[AnyBubbles],
) -> Iterator[Item]:
    for key, name in _LARGE.items():
        yield make_row(f"h = {height} mm, {_SOLVER}: {name}", None, [one[key] for one in scores])
    known, guess = jet_figures(scene, true), jet_figures(scene, found)
    stated = dict(zip(("penetration_mm", "angle_deg"), _THESIS[height], strict=True)) | _SCALING
    for name in JET.values():
        exact, measured = getattr(known, name), getattr(guess, name)
        error = 100.0 * (measured / exact - 1.0)
        note = f"{len(true)} frames together; of the true bubbles {exact:.4g}: {error:+.1f} %"
        yield make_row(
            f"h = {height} mm: {name}",
            stated[name],
            [measured] if np.isfinite(measured) else [],
            note,
            "neither",
        )


def _figures(
    scene: Scene, height: int, true: list[AnyBubbles], found: list[AnyBubbles]
) -> Iterator[Item]:
    """Draw figures 5-18 to 5-20 of the first frame, and C_Y over depth."""
    number = {7: "5-18", 21: "5-19", 43: "5-20"}[height]
    panels = tuple(
        Panel(title, "X, mm", "", (Space("radius, mm", one.center_mm, one.radius_mm),))
        for title, one in (("true", true[0]), ("found", found[0]))
    )
    yield Figure(f"fig-{number}", f"bubbles, h = {height} mm", panels, inch=(4.6, 6.4))
    curves = []
    for name, balls in (("true bubbles", true), ("found", found)):
        found_jet = jet_figures(scene, balls)
        share = found_jet.total / max(float(found_jet.total.max()), 1e-12)
        curves.append(Curve(name, list(found_jet.depth_mm), list(share)))
    if (jet := jet_of(scene)) is not None:
        law = JetLaw(jet["penetration_mm"], jet["equivalent_mm"], jet["total_percent"] / 100.0)
        y = np.linspace(0.0, curves[0].x[-1], 100)
        curves.append(Curve("equation 5.18", list(y), list(law.total_over_peak(y))))
    yield Figure(
        f"fig-5-30-{height}",
        f"concentration over depth, h = {height} mm",
        (Panel("", "Y, mm", "C_Y over its largest", tuple(curves)),),
    )
