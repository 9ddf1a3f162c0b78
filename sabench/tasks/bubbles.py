"""Task `bubbles`: bubbles of one observation, frame by frame.

The bubbles of all frames are linked afterwards. Figures follow 5-18 to 5-20 of the thesis.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sabench.algorithms.particles.linking import link
from sabench.api import Detections
from sabench.api.truth import Bubbles
from sabench.dataset.cameras import CamerasFile
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result, ResultWriter
from sabench.dataset.schema import frame_group
from sabench.geometry.rigid_motion import rotation_matrices
from sabench.metrics.averages import finite_or_none, mean_of_each
from sabench.metrics.bubble_detection import NEAR, AnyBubbles, detection_scores, match_bubbles
from sabench.metrics.plunging_jet import JetFigures, analyse
from sabench.metrics.trajectories import trajectory_scores
from sabench.plotting.drawing import Circles, Discs, Figure, Panel, draw
from sabench.scenes import BubbleWorld, Scene
from sabench.scenes.world import GeneratorTable
from sabench.tasks.task import (
    AGREEING,
    Captions,
    Figures,
    FrameByFrame,
    Gate,
    Score,
    Source,
    check_number,
    check_tracks,
    share,
    share_near,
)
from sabench.utils import memory
from sabench.utils.arrays import F64, I64
from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar
from sabench.worlds.library.plunging_jet import EDGE

_WIDE, _HIGH = 3.8, (2.6, 7.0)  # inches of a panel


def bubble_figure(bubbles: AnyBubbles, name: str, title: str = "") -> Figure:
    """Draw positions and sizes across X-Y and Z-Y."""
    x, y, z = bubbles.center_mm.T
    views = (("front", "X, mm", x), ("side", "Z, mm", z))
    panels = [
        Panel(view, label, "Y, mm", (Discs("radius, mm", across, y, bubbles.radius_mm),))
        for view, label, across in views
    ]
    return Figure(name, title or f"{len(x)} bubbles", tuple(panels), inch=_inch(bubbles.center_mm))


def _inch(center_mm: F64) -> tuple[float, float]:
    """Compute the width and height of a panel that shows these positions."""
    x, y, z = np.ptp(center_mm, axis=0) if len(center_mm) else np.ones(3)
    return _WIDE, float(np.clip(0.6 * _WIDE * y / max(x, z, 1e-9), *_HIGH))


def detection_figure(found: AnyBubbles, true: AnyBubbles) -> Figure:
    """Draw the found, missed and ghost bubbles across X-Y and Z-Y."""
    i, j = match_bubbles(found.center_mm, true.center_mm, true.radius_mm)
    missed, ghosts = (
        (np.delete(balls.center_mm, hit, axis=0), np.delete(balls.radius_mm, hit))
        for balls, hit in ((true, j), (found, i))
    )
    kinds = {"missed": missed, "ghost": ghosts, "found": (true.center_mm[j], true.radius_mm[j])}
    panels = tuple(
        Panel(
            view,
            label,
            "Y, mm",
            tuple(
                Circles(kind, center_mm[:, axis], center_mm[:, 1], radius_mm)
                for kind, (center_mm, radius_mm) in kinds.items()
            ),
        )
        for view, label, axis in (("front", "X, mm", 0), ("side", "Z, mm", 2))
    )
    title = f"{len(j)} found, {len(missed[1])} missed, {len(ghosts[1])} ghosts"
    return Figure(
        "errors", title, panels, inch=_inch(np.concatenate([true.center_mm, found.center_mm]))
    )


JET = {
    "penetration_percent": "penetration_mm",
    "angle_percent": "angle_deg",
    "weight_percent": "weight",
    "width_percent": "width",
}
_WRONG_ROTATION = rotation_matrices(np.array([0.1, -0.2, 0.05]))


class BubblesTask(FrameByFrame):
    """Detection of bubbles and drops."""

    name = "bubbles"
    shown = "bubbles"
    estimate = Detections
    # fmt: off
    scores = (
        share("f1_large", 3, "harmonic mean of precision and recall, bubbles of 0.5 mm radius and "
              "more; found: closer than half a radius", heading="F1, large"),
        share("f1", 3, "the same, all bubbles", heading="F1"),
        share("f1_small", 3, "the same, bubbles below 0.5 mm", heading="F1, small"),
        share("precision", 3, "share of the detections that are bubbles, one to one"),
        share("recall", 3, "share of the bubbles that were found"),
        share("recall_hidden", 3, "recall of bubbles of which the cameras see less than nine "
              "tenths, mean over cameras", heading="recall, hidden"),
        share("recall_dense", 3, "recall of bubbles around which, within 6 mm, others fill a "
              "hundredth or more", heading="recall, dense"),
        Score("radius_percent", "smaller", 2,
              "median error of the radius of found bubbles of 0.5 mm and more"),
        Score("axes_percent", "smaller", 2, "median error of their semi-axes"),
        Score("tilt_deg", "smaller", 1,
              "median error of the short axis's direction, of found bubbles flatter than 0.9"),
        Score("plane_mm", "smaller", 3,
              "median error across Z of found bubbles of 0.5 mm and more"),
        Score("depth_mm", "smaller", 3, "median error along Z"),
        Score("sizes_percent", "smaller", 1,
              "distance of the distributions of radii (Wasserstein) over the mean radius"),
        Score("sizes_mm", "smaller", 3, "the same in mm: mean difference of radii of equal rank"),
        Score("mean_percent", "smaller", 1, "error of the mean radius of all bubbles, regardless "
              "of sign", heading="mean radius %"),
        Score("sauter_percent", "smaller", 1,
              "the same of the Sauter mean diameter, sum of d^3 over sum of d^2", heading="d32 %"),
        Score("void_percent", "smaller", 1, "error of the volume of all bubbles"),
        Score("penetration_percent", "smaller", 1, "error of a jet's penetration depth, against "
              "the same analysis of the true bubbles", heading="Y_p %"),
        Score("angle_percent", "smaller", 1, "error of its spreading angle"),
        Score("weight_percent", "smaller", 1, "error of A of equation 5.18", heading="A %"),
        Score("width_percent", "smaller", 1, "error of s of equation 5.18", heading="s %"),
        share("link_recall", 3,
              "share of the bubbles found in two consecutive frames that one trajectory joins"),
        share("link_precision", 3,
              "share of the links between such frames that join the same bubble"),
        share("effectiveness", 3, "share of a bubble's frames in which its longest trajectory has "
              "it, mean over the bubbles"),
        Score("velocity_mm_s", "smaller", 2, "median error of the velocity of correct links, "
              "against the true mean velocity between the frames"),
        Score("velocity_percent", "smaller", 2, "the same over that velocity"),
    )
    # fmt: on
    sufficient = 0.8
    gate = Gate("precision", 0.02)
    captions = Captions(
        heading="Bubbles from the front and from the side",
        estimates="Every bubble as a circle of its radius, coloured by radius; X or Z to the "
        "right, Y down.",
        cameras="First frame of every camera.",
        errors="Found: a bubble paired with a true one, closer than half its radius; missed: a "
        "true one without a pair; ghost: an estimated one without a pair.",
        wide=True,
    )

    def run(self, algorithm: Any, name: str, data: Dataset, writer: ResultWriter) -> list[float]:
        """Find every frame's bubbles and link them; return the seconds of each frame."""
        seconds, every = [], []
        for frame in self.frames(data):
            estimate, took = self.call(algorithm, name, data, frame)
            seconds.append(took)
            every.append(estimate)
            memory.trim()
        self._store(data, every, writer)
        return seconds

    def copy(self, data: Dataset, result: Result, writer: ResultWriter) -> None:
        """Write the bubbles of a foreign result anew, linked if it has no trajectories."""
        every = [self.read(data, result, frame) for frame in self.frames(data)]
        check_tracks(result, every)
        self._store(data, every, writer)

    def _store(self, data: Dataset, every: list[Detections], writer: ResultWriter) -> None:
        for frame, number in enumerate(trajectories(data.setup, every)):
            writer.add(replace(every[frame], trajectory=number), frame)

    def truth(self, data: Dataset, frame: int) -> Bubbles:
        """Make the true bubbles."""
        return data.bubbles(frame)

    def empty(self, data: Dataset, frame: int) -> Detections:
        """Make no bubbles."""
        return Detections.balls(np.zeros((0, 3)), np.zeros(0))

    def wrong(self, data: Dataset, frame: int) -> Detections:
        """Move, enlarge and rotate most true bubbles, and add some that are not there."""
        true = data.bubbles(frame)
        rows = np.flatnonzero(np.arange(len(true)) % 5 != 3)
        far = true.radius_mm[rows, None] * (1.5 + np.sin(rows + frame)[:, None])
        aside = np.array([0.08, -0.05, 0.2]) * far
        ghosts = np.asarray(true.center_mm)[::6] + 2.5 * true.radius_mm[::6, None]
        return Detections(
            np.concatenate([true.center_mm[rows] + aside, ghosts]),
            np.concatenate([true.semi_axes_mm[rows] * [1.05, 0.97, 1.02], true.semi_axes_mm[::6]]),
            np.concatenate([true.turn[rows] @ _WRONG_ROTATION, true.turn[::6]]),
        )

    def score(self, data: Dataset, source: Source) -> Figures:
        """Average the frames' scores; those of jets and trajectories are of all frames."""
        frames, estimates, every = [], [], []
        for frame in progress_bar(self.frames(data), "score"):
            estimate, true = self.read(data, source, frame), data.bubbles(frame)
            if isinstance(source, Result):
                where = f"{source.path}: {frame_group(frame)}/bubbles"
                check_number(len(estimate.center_mm), len(true), where)
            cameras = data.setup.cameras
            visibility = np.mean([data.sight(frame, camera).visible for camera in cameras], axis=0)
            frames.append(detection_scores(estimate, true, visibility))
            estimates.append(estimate)
            every.append(true)
        if isinstance(source, Result):
            check_tracks(source, estimates)
        numbers = trajectories(data.setup, estimates)
        times = [data.setup.time_s(frame) for frame in self.frames(data)]
        links = trajectory_scores(estimates, numbers, every, times, data.setup.sequences())
        over_time = {key: finite_or_none(value) for key, value in links.items()}
        return mean_of_each(frames) | _jet_scores(data, estimates, every) | over_time

    def alike(self, data: Dataset, one: Detections, other: Detections) -> bool:
        """Compare bubbles by the share detected in both."""
        return share_near(one.center_mm, other.center_mm, NEAR * one.radius_mm) >= AGREEING

    def picture(self, data: Dataset, source: Source) -> bytes:
        """Draw the bubbles of the first frame, front and side view, as a PNG."""
        return draw(bubble_figure(self.read(data, source, 0), "bubbles"))

    def error_picture(self, data: Dataset, result: Result) -> bytes:
        """Draw the found, missed and ghost bubbles as a PNG."""
        return draw(detection_figure(self.read(data, result, 0), data.bubbles(0)))


def trajectories(setup: CamerasFile, found: Sequence[AnyBubbles]) -> list[I64]:
    """Assign trajectory numbers (n,) to every frame's bubbles.

    The numbers are the solver's own, or come from linking. A trajectory of linked bubbles lies
    within one group of pulses.
    """
    numbers = [frame.id if isinstance(frame, Bubbles) else frame.trajectory for frame in found]
    given = [number for number in numbers if number is not None]
    if given and len(given) == len(found):
        return given
    out: list[I64] = []
    for frames in setup.sequences():
        centers, radii = zip(
            *((found[n].center_mm, found[n].radius_mm) for n in frames), strict=True
        )
        part = link(centers, radii, [setup.time_s(n) for n in frames])
        first = max((int(ids.max(initial=-1)) for ids in out), default=-1) + 1
        out.extend(first + ids for ids in part)
    return out


def _jet_scores(data: Dataset, every: Sequence[AnyBubbles], truth: Sequence[AnyBubbles]) -> Figures:
    """Score a jet's figures against those of the true bubbles; None without a jet."""
    if jet_of(data.scene) is None:
        return dict.fromkeys(JET)
    estimate, true = (jet_figures(data.scene, bubbles) for bubbles in (every, truth))
    pairs = {key: (getattr(estimate, name), getattr(true, name)) for key, name in JET.items()}
    return {
        key: finite_or_none(100.0 * abs(figure / other - 1.0)) if other else None
        for key, (figure, other) in pairs.items()
    }


def jet_of(scene: Scene) -> GeneratorTable | None:
    """Find the parameters of a scene's plunging jet; None without one."""
    world = scene.world
    if not isinstance(world, BubbleWorld) or world.bubbles is None:
        return None
    return world.bubbles if world.bubbles["generator"] == "plunging_jet" else None


def jet_figures(scene: Scene, every: Sequence[AnyBubbles]) -> JetFigures:
    """Analyse the bubbles of several frames as those of a scene's plunging jet."""
    if (jet := jet_of(scene)) is None:
        raise InputError(f"{scene.title}: bubbles.generator: expected plunging_jet, got no jet")
    impact, volume = np.asarray(jet["impact_mm"]), scene.volume
    return analyse(
        np.concatenate([bubbles.center_mm for bubbles in every]),
        np.concatenate([bubbles.radius_mm for bubbles in every]),
        impact,
        volume.center_mm[1] + volume.size_mm[1] / 2.0 - impact[1],
        EDGE,
        len(every),
    )


TASK = BubblesTask()
