"""Figure 6-6: edges of a liquid jet found in refocused planes, with their depths.

The thesis shows edges and no figures. Here their depths are compared with the true rim of the
column, its ligaments and the drops, as far as most cameras see it against the light.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.algorithms.bubbles.transmission import transmission
from sabench.algorithms.refocus import find_edges, refocus_sum
from sabench.api import Observation
from sabench.api.truth import Bubbles, Solid
from sabench.evaluation.thesis.chapter_5 import render_first_frame
from sabench.evaluation.thesis.common import Item, coarsen, make_row
from sabench.geometry.grid import Grid
from sabench.metrics.edge_depth import (
    count_views,
    edge_scores,
    find_rim,
    silhouette,
    sphere_mesh,
)
from sabench.plotting.charts import Figure, Panel, Slice
from sabench.scenes import load_scene
from sabench.simulation.frames import FrameContent
from sabench.utils.arrays import F64

SEEDS = 3
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


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure depth errors of the edges of column and ligaments, and of all edges."""
    scene = coarsen(load_scene("jet-in-crossflow"), pixels)
    scores: dict[str, list[dict[str, float | None]]] = {"column and ligaments": [], "drops": []}
    for seed in seeds:
        frame, bubbles, case = render_first_frame(scene, seed)
        found = find_visible(case)
        column, drops = visible_edges(frame, bubbles)
        if seed == seeds[0]:
            yield _figure(case.grid, found, np.concatenate([column, drops]))
        every = edge_scores(found, np.concatenate([column, drops]))
        for name, truth in zip(scores, (column, drops), strict=True):
            scores[name].append(edge_scores(found, truth) | {"precision": every["precision"]})
    for name, several in scores.items():
        for key, what in _WHAT.items():
            if key == "precision" and name == "drops":
                continue
            values = [value for one in several if (value := one[key]) is not None]
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


def _figure(grid: Grid, found: F64, truth: F64) -> Figure:
    """Draw found and true edges, coloured by their depths."""
    panels = [
        Panel(name, "X, mm", "Y, mm", (_depth_map(grid, points),))
        for name, points in (("found in refocused planes", found), ("visible rim", truth))
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
