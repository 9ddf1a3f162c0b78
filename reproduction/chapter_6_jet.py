"""Liquid jet in a cross-flow: figures 6-4 to 6-6, and its drops over time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sabench.algorithms.bubbles.backlit_images import transmission
from sabench.algorithms.bubbles.features import darkness
from sabench.algorithms.particles.linking import link
from sabench.algorithms.refocus import find_edges, refocus_sum
from sabench.api import Observation
from sabench.api.truth import Bubbles, Solid
from sabench.evaluation.reproduction import Item
from sabench.geometry.grid import Grid
from sabench.metrics.bubble_detection import LARGE_MM, AnyBubbles, detection_scores, match_bubbles
from sabench.metrics.trajectories import trajectory_scores
from sabench.plotting.drawing import Figure, Panel, Picture, Slice
from sabench.scenes import Scene, load_scene
from sabench.simulation.frames import FrameContent
from sabench.utils.arrays import F64, I64

from .chapter_5 import render_first_frame, render_frames
from .common import coarsen, curve_of_means, finite_row, image_panel, make_row, report, run
from .edge_depth import count_views, edge_scores, find_rim, silhouette, sphere_mesh

_DEPTHS_MM = (-8.0, 0.0, 8.0)
_SOLVERS_OF_FRAMES = ("minimum_image", "local_feature")


def fig_6_5(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure F1 and errors of drops per solver; the thesis shows only images.

    One camera's image and refocused planes at several depths are drawn.
    """
    scene = coarsen(load_scene("jet-in-crossflow"), pixels)
    scores: dict[str, list[dict[str, float]]] = {name: [] for name in _SOLVERS_OF_FRAMES}
    for seed in seeds:
        _, bubbles, case = render_first_frame(scene, seed)
        if seed == seeds[0]:
            volume, (x, y, z) = darkness(case), case.grid.axes_mm
            panels = [image_panel("one view", case.images[len(case.images) // 2])]
            for depth in _DEPTHS_MM:
                plane = int(np.abs(z - depth).argmin())
                picture = Picture(
                    1.0 - volume[plane].astype(np.float64),
                    (float(x[0]), float(y[0])),
                    (float(x[-1]), float(y[-1])),
                )
                panels.append(Panel(f"Z = {z[plane]:.1f} mm", "X, mm", "Y, mm", (picture,)))
            yield Figure(
                "fig-6-5", "a liquid jet in a cross-flow", tuple(panels), across=2, inch=(5.0, 4.4)
            )
        for name in _SOLVERS_OF_FRAMES:
            scores[name].append(detection_scores(run(name, case), bubbles, np.ones(len(bubbles))))
    for name, every in scores.items():
        for key, what in {
            "f1_large": "F1 of drops of 0.5 mm radius and more",
            "f1": "F1 of all drops",
            "depth_mm": "depth error, mm",
        }.items():
            yield make_row(f"{name}: {what}", None, [score[key] for score in every])


_LEAST = 0.3  # step of the transmission, mean over the cameras: chosen on seed 1
_REACH_MM = 1.0
_MOST = 0.5  # share of the cameras that see an edge, from which it is visible
_STEP_PX = 2.0  # beside the rim, where light passes and where none does
_BIN = 3  # voxels of a figure's pixel
_WHAT = {
    "median_mm": "depth error of visible edges, median, mm",
    "bias_mm": "depth error, signed median, mm",
    "located": "visible edges with an edge found within 0.3 mm in X and Y",
    "recall": "visible edges with one found within 1 mm in depth, too",
    "precision": "edges found that are true edges to within 1 mm in depth",
}


def fig_6_6(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure depth errors of the edges of column and ligaments, and of all edges.

    The thesis shows edges and no figures. Here their depths are compared with the true rim of the
    column, its ligaments and the drops, as far as most cameras see it against the light.
    """
    scene = coarsen(load_scene("jet-in-crossflow"), pixels)
    scores: dict[str, list[dict[str, float | None]]] = {"column and ligaments": [], "drops": []}
    for seed in seeds:
        frame, bubbles, case = render_first_frame(scene, seed)
        edges = find_visible(case)
        column, drops = visible_edges(frame, bubbles)
        if seed == seeds[0]:
            yield _edges_figure(case.grid, edges, np.concatenate([column, drops]))
        every = edge_scores(edges, np.concatenate([column, drops]))
        for name, truth in zip(scores, (column, drops), strict=True):
            scores[name].append(edge_scores(edges, truth) | {"precision": every["precision"]})
    for name, several in scores.items():
        for key, what in _WHAT.items():
            if key == "precision" and name == "drops":
                continue
            values = [value for score in several if (value := score[key]) is not None]
            yield make_row(what if key == "precision" else f"{name}: {what}", None, values)


def find_visible(case: Observation) -> F64:
    """Find the edges (n, 3) of a backlit scene in refocused planes, mm."""
    light = np.clip(transmission(case), 0.0, 1.0)
    stack = refocus_sum(light, case.cameras, case.grid, outside=1.0)
    stack /= np.float32(len(case.cameras))
    return find_edges(stack, case.grid, least=_LEAST, reach_mm=_REACH_MM).position_mm


def visible_edges(frame: FrameContent, bubbles: Bubbles) -> tuple[F64, F64]:
    """Compute the visible rims (n, 3) of the bodies and of the drops, mm."""
    cameras = frame.rig.cameras
    eye = np.mean([camera.center_mm for camera in cameras], axis=0)
    balls = [sphere_mesh(matrix, center) for matrix, center in _shapes(bubbles)]
    masks = [silhouette(camera, [*frame.solids, *balls]) for camera in cameras]
    distance = float(np.linalg.norm(bubbles.center_mm.mean(axis=0) - eye))
    step = _STEP_PX * cameras[0].pixel_mm / cameras[0].principal_distance_mm * distance

    def visible(solids: Sequence[Solid]) -> F64:
        parts = []
        for solid in solids:
            rim = find_rim(solid, eye)
            parts.append(rim.position_mm[count_views(rim, cameras, masks, step) > _MOST])
        return np.concatenate(parts) if parts else np.zeros((0, 3))

    return visible(frame.solids), visible(balls)


def _shapes(bubbles: Bubbles) -> Iterator[tuple[F64, F64]]:
    """Give matrices from the unit ball to every drop, and its centre."""
    yield from zip(np.linalg.inv(bubbles.to_ball), bubbles.center_mm, strict=True)


def _edges_figure(grid: Grid, edges: F64, truth: F64) -> Figure:
    """Draw found and true edges, coloured by their depths."""
    panels = [
        Panel(name, "X, mm", "Y, mm", (_depth_map(grid, points),))
        for name, points in (("found in refocused planes", edges), ("visible rim", truth))
    ]
    return Figure("fig-6-6", "edges of a liquid jet and their depths", tuple(panels), inch=(7, 6))


def _depth_map(grid: Grid, points: F64) -> Slice:
    """Enter the depths of points into a map; NaN where there are none."""
    x, y = (axis[::_BIN] for axis in grid.axes_mm[:2])
    values = np.full((len(y), len(x)), np.nan)
    low, step = np.asarray(grid.low_mm[:2]), _BIN * np.asarray(grid.voxel_mm[:2])
    column, row = np.round((points[:, :2] - low) / step).astype(np.int64).T
    inside = (row >= 0) & (row < len(y)) & (column >= 0) & (column < len(x))
    values[row[inside], column[inside]] = points[inside, 2]
    return Slice("depth Z, mm", x, y, values)


FRAMES = 8
_PLANE_MM = 45.0  # from the nozzle along the gas: behind the column
_SOLVERS_OVER_TIME = ("minimum_image", "local_feature")
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


def drops_over_time(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure numbers, diameters, passages and links of large drops.

    Drops are detected frame by frame and linked. Their number, their mean and Sauter diameters, and
    the number that has passed a plane across the gas are compared with those of the true drops.
    """
    scene = coarsen(load_scene("jet-in-crossflow"), pixels).with_frames(FRAMES)
    counts: dict[str, list[Counted]] = {name: [] for name in (_TRUTH, *_SOLVERS_OVER_TIME)}
    scores: dict[str, list[dict[str, float]]] = {name: [] for name in _SOLVERS_OVER_TIME}
    for seed in seeds:
        truth, detected = _detect(scene, seed)
        counts[_TRUTH].append(count_drops([drops.id for drops in truth], truth))
        times = [scene.time_s(frame) for frame in range(scene.frames)]
        for name, every in detected.items():
            centers = [drops.center_mm for drops in every]
            radii = [drops.radius_mm for drops in every]
            numbers = link(centers, radii, times)
            counts[name].append(count_drops(numbers, every))
            scores[name].append(
                _recall(every, truth)
                | trajectory_scores(every, numbers, truth, times, [range(scene.frames)])
            )
        report(f"drops over time, seed {seed}")
    for name in _SOLVERS_OVER_TIME:
        yield from _rows(name, counts[_TRUTH], counts[name], scores[name])
    yield _drops_figure(scene, counts)


def _detect(scene: Scene, seed: int) -> tuple[list[Bubbles], dict[str, list[AnyBubbles]]]:
    """Render all frames and detect their drops by every solver."""
    truth, detected = list[Bubbles](), {name: list[AnyBubbles]() for name in _SOLVERS_OVER_TIME}
    for _, bubbles, case in render_frames(scene, seed):
        truth.append(bubbles)
        for name, every in detected.items():
            every.append(run(name, case))
    return truth, detected


def count_drops(trajectory: Sequence[I64], drops: Sequence[AnyBubbles]) -> Counted:
    """Count drops of 0.5 mm radius and more in every frame.

    Small ones are as wide as a few pixels. A trajectory passes with those of its detections that
    are large.
    """
    masks = [bubbles.radius_mm >= LARGE_MM for bubbles in drops]
    radii = [bubbles.radius_mm[large] for bubbles, large in zip(drops, masks, strict=True)]
    along = [bubbles.center_mm[large, 0] for bubbles, large in zip(drops, masks, strict=True)]
    numbers = [number[large] for number, large in zip(trajectory, masks, strict=True)]
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


def _recall(detected: Sequence[AnyBubbles], truth: Sequence[AnyBubbles]) -> dict[str, float]:
    """Compute recall and ghosts of large drops in percent, over all frames."""
    hits, total, ghosts = 0, 0, 0
    for bubbles, true in zip(detected, truth, strict=True):
        i, j = match_bubbles(bubbles.center_mm, true.center_mm, true.radius_mm)
        hits += int((true.radius_mm[j] >= LARGE_MM).sum())
        total += int((true.radius_mm >= LARGE_MM).sum())
        ghost = np.setdiff1d(np.arange(len(bubbles.center_mm)), i)
        ghosts += int((bubbles.radius_mm[ghost] >= LARGE_MM).sum())
    return {
        "recall_percent": 100.0 * hits / max(total, 1),
        "ghost_percent": 100.0 * ghosts / max(hits, 1),
    }


def _rows(
    name: str,
    truth: Sequence[Counted],
    detected: Sequence[Counted],
    scores: Sequence[dict[str, float]],
) -> Iterator[Item]:
    pairs = list(zip(detected, truth, strict=True))
    figures = {
        "drops, found over true": [got.number.mean() / true.number.mean() for got, true in pairs],
        "mean diameter, found over true": [
            np.nanmean(got.mean_mm) / np.nanmean(true.mean_mm) for got, true in pairs
        ],
        "Sauter diameter, found over true": [
            np.nanmean(got.sauter_mm) / np.nanmean(true.sauter_mm) for got, true in pairs
        ],
        "passages, counted over true": [
            got.passed[-1] / max(true.passed[-1], 1.0) for got, true in pairs
        ],
    } | {
        what: [score[key] for score in scores]
        for key, what in {
            "recall_percent": "recall, %",
            "ghost_percent": "ghosts, %",
            "link_recall": "link recall",
            "link_precision": "link precision",
            "velocity_percent": "velocity error, %",
        }.items()
    }
    for what, values in figures.items():
        yield finite_row(f"{name}: {what}", values)


def _drops_figure(scene: Scene, counts: dict[str, list[Counted]]) -> Figure:
    """Draw number, diameters and passages over time, with intervals over the seeds."""
    times = [1e3 * scene.time_s(frame) for frame in range(scene.frames)]
    kinds = {
        "number": "drops of 0.5 mm radius and more",
        "mean_mm": "mean diameter, mm",
        "sauter_mm": "Sauter diameter, mm",
        "passed": f"passed X = {_PLANE_MM:g} mm",
    }
    panels = []
    for kind, label in kinds.items():
        curves = tuple(
            curve_of_means(name, times, np.array([getattr(one, kind) for one in draws]).T)
            for name, draws in counts.items()
        )
        panels.append(Panel("", "time, ms", label, curves))
    return Figure("drops-over-time", "drops over time", tuple(panels), across=2)


def count_passages(
    along_mm: Sequence[F64], trajectory: Sequence[I64], plane_mm: float
) -> list[int]:
    """Count the trajectories that have passed a plane until each frame.

    A trajectory passes once: when it is first found beyond the plane, after a frame in which it was
    found before it.

    `along_mm` are the coordinates (n,) of each frame's objects along the plane's normal, and
    `trajectory` the numbers of their trajectories. Returns one count for each frame; the first is
    0.
    """
    before, passed, counts = set[int](), set[int](), list[int]()
    for along, number in zip(along_mm, trajectory, strict=True):
        beyond = np.asarray(along) > plane_mm
        passed |= before & set(number[beyond].tolist())
        before |= set(number[~beyond].tolist())
        counts.append(len(passed))
    return counts
