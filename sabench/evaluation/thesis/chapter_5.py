"""Frames rendered in memory for chapter 5, and bubbles found in them."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.api import Detections, Observation
from sabench.api.make import make_algorithm
from sabench.api.truth import Bubbles
from sabench.evaluation.thesis.common import AGREES, Row, claim, coarsen, make_row
from sabench.metrics.bubble_detection import AnyBubbles
from sabench.metrics.plunging_jet import JetFigures
from sabench.scenes import Scene, build_rig, load_scene
from sabench.simulation.camera_view import render
from sabench.simulation.frames import FrameContent, Frames
from sabench.simulation.in_memory import observation_of
from sabench.simulation.rendering.sensor import expose
from sabench.tasks.bubbles import jet_figures, jet_of
from sabench.utils.arrays import F64
from sabench.utils.progress import console, progress_bar

FRAMES = 50  # the thesis's number of time steps: of true bubbles, which need no images
SOLVER = "rim_fit"


@dataclass(frozen=True)
class Jet:
    """Values of tables 5.1 and 5.2 and of the text for one height of the nozzle.

    V_i and D_i stand in each other's column there: `speed_m_s` is printed as D_i.
    """

    speed_m_s: float
    diameter_mm: float
    reynolds: float
    froude: float
    weber: float
    total_percent: float
    penetration_mm: float
    equivalent_mm: float
    angle_deg: float
    axes_mm: tuple[float, float]  # smallest and largest


JETS = {
    7: Jet(3.45, 6.29, 2.17e4, 112.0, 514.0, 0.02, 211.5, 87.0, 11.6, (0.138, 2.38)),
    21: Jet(3.59, 6.17, 2.21e4, 119.0, 544.0, 0.23, 160.0, 61.6, 10.9, (0.244, 2.44)),
    43: Jet(3.78, 6.01, 2.27e4, 128.0, 589.0, 0.34, 120.0, 48.1, 11.3, (0.1946, 4.32)),
}  # mm of the nozzle above the surface
NOZZLE_MM, MORTON = 6.35, 2.52e-11
HEIGHTS = tuple(JETS)


@dataclass(frozen=True)
class JetFrames:
    """Bubbles of several frames of a jet, true ones and those found in the images."""

    height: int
    scene: Scene
    true: list[AnyBubbles]
    found: list[AnyBubbles]

    @property
    def printed(self) -> Jet:
        """The thesis's values."""
        return JETS[self.height]

    @property
    def impact_mm(self) -> F64:
        """Point (3,) where the jet meets the surface."""
        jet = jet_of(self.scene)
        return np.asarray(jet["impact_mm"] if jet else np.zeros(3), dtype=np.float64)

    def analyse(self) -> dict[str, JetFigures]:
        """Analyse found and true bubbles, and true ones of `FRAMES` frames."""
        return {
            "found": jet_figures(self.scene, self.found),
            "true": jet_figures(self.scene, self.true),
            "many": jet_figures(self.scene, true_bubbles(self.scene, FRAMES)),
        }


def detect_jets(seeds: Sequence[int], pixels: int | None) -> Iterator[JetFrames]:
    """Find the bubbles of every jet in one frame for each seed."""
    for height in HEIGHTS:
        scene = coarsen(load_scene(f"plunging-jet-{height}"), pixels)
        yield detect_jet(height, scene, seeds)


def detect_jet(height: int, scene: Scene, seeds: Sequence[int]) -> JetFrames:
    """Find the bubbles of one jet in one frame for each seed."""
    pairs = [detect_frame(scene, seed) for seed in seeds]
    return JetFrames(height, scene, [true for true, _ in pairs], [own for _, own in pairs])


_detected: dict[tuple[str, int, str], tuple[Bubbles, Detections]] = {}
_true: dict[tuple[str, int], list[AnyBubbles]] = {}


def detect_frame(scene: Scene, seed: int) -> tuple[Bubbles, Detections]:
    """Find the bubbles of a scene's first frame.

    They are cached, because several figures use them.
    Returns the true and the found ones.
    """
    key = scene.hash, seed, SOLVER
    if key not in _detected:
        _, bubbles, case = render_first_frame(scene, seed)
        algorithm: Any = make_algorithm(SOLVER, {})
        start = time.perf_counter()
        _detected[key] = bubbles, algorithm.solve(case)
        console.print(
            f"{scene.title}, seed {seed}: {len(_detected[key][1].center_mm)} of {len(bubbles)} "
            f"bubbles in {time.perf_counter() - start:.0f} s",
            markup=False,
            highlight=False,
        )
    return _detected[key]


def true_bubbles(scene: Scene, count: int) -> list[AnyBubbles]:
    """Make the bubbles of the first frames of seeds 1 to `count`; cached."""
    key = scene.hash, count
    if key not in _true:
        rig = build_rig(scene, scene.title)
        made = [Frames(scene, rig, seed).at(0).bubbles for seed in range(1, count + 1)]
        _true[key] = [one for one in made if one is not None]
    return _true[key]


def jet_rows(
    name: str, thesis: float | None, found: float, true: float, many: float | None = None
) -> Iterator[Row]:
    """Make rows of a value of a jet.

    The thesis's value is a mean over `FRAMES` frames of its own jet, to which the scene was built:
    it is compared with `many`, that of the true bubbles of as many frames. The value of found
    bubbles is compared with that of true ones in the same, fewer frames.
    """
    if many is not None:
        values = [many] if np.isfinite(many) else []
        note = "" if thesis is None else "the scene was built to the thesis's value"
        row = f"{name}, true bubbles of {FRAMES} frames"
        yield make_row(row, thesis, values, note)
    known = np.isfinite(true) and np.isfinite(found)
    yield claim(
        f"{name}, found bubbles",
        f"true bubbles of the same frames: {true:.4g}",
        found if np.isfinite(found) else None,
        bool(known and abs(found - true) <= AGREES * abs(true)),
        f"{100.0 * (found / true - 1.0):+.1f} %" if known and true else "",
    )


Rendered = tuple[FrameContent, Bubbles, Observation]  # a frame, its bubbles, what a solver gets


def render_first_frame(scene: Scene, seed: int) -> Rendered:
    """Render the first frame of the data set that `generate` would make, in memory."""
    return next(render_frames(scene, seed))


def render_frames(scene: Scene, seed: int) -> Iterator[Rendered]:
    """Render all frames of the data set that `generate` would make."""
    frames = Frames(scene, build_rig(scene, scene.title), seed)
    for number in range(scene.frames):
        frame = frames.at(number)
        if frame.bubbles is None:
            raise ValueError(f"{scene.title}: expected a scene with bubbles")
        cameras = range(len(frame.rig.cameras))
        images = [
            expose(scene.sensor, render(frame, camera).photons, frame.sensor_noise(camera))
            for camera in progress_bar(
                cameras, f"render {scene.title}, seed {seed}, frame {number}"
            )
        ]
        yield frame, frame.bubbles, observation_of(frame, images)
