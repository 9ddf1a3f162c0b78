"""What the tables and figures of bubbles share: frames rendered in memory."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sabench.algorithms.bubbles.feature_potential import (
    STACK,
    WINDOW,
    attenuate,
    darkness,
    feature,
    minimum_images,
    outlines,
)
from sabench.api import Observation
from sabench.dataset.reader import observed
from sabench.geometry.grid import Grid
from sabench.plotting.charts import Figure, Panel, Picture
from sabench.scenes import Scene, build_rig
from sabench.scenes.nominal_cameras import nominal_cameras
from sabench.scenes.sensor import white_level
from sabench.simulation.frames_of_bubbles import PhaseWorld, Worlds, record
from sabench.utils.arrays import F64
from sabench.utils.progress import track

_OFF_MM = 10.0  # of the refocused planes before and behind the middle one: figure 5-6
_EDGE, _SMALL_PX = 0.05, 4.0  # as `minimum_image` takes them


def photographed(scene: Scene, seed: int) -> tuple[PhaseWorld, Observation]:
    """Simulate the first frame of a data set in memory: its truth and observation."""
    rig = build_rig(scene, scene.title)
    world = Worlds(scene, rig, seed).at(0)
    images = [
        record(world, camera).grey
        for camera in track(rig.cameras, f"render {scene.title}, seed {seed}")
    ]
    levels = scene.sensor.black_level_dn, white_level(scene.sensor)
    return world, observed(
        np.stack(images),
        nominal_cameras(scene, rig.cameras, seed),
        rig.grid,
        levels,
        scene.preprocessing or (),
    )


def pictures(case: Observation) -> Iterator[Figure]:
    """Draw figures 5-5, 5-6 and 5-11.

    They show a view, the middle third of three refocused planes, and that of a minimum image with
    the outlines detected in it.
    """
    grid, view = case.grid, case.images[len(case.images) // 2].astype(np.float64)
    ends = (0.0, 0.0), (view.shape[1] - 1.0, view.shape[0] - 1.0)
    yield Figure(
        "fig-5-5",
        "a backlit view",
        (Panel("", "px", "px", (Picture(view, *ends),)),),
        inch=(5.5, 5.5),
    )
    volume = darkness(case)
    middle, step = len(volume) // 2, round(_OFF_MM / grid.voxel_mm[2])
    planes = [int(np.clip(middle + off, 0, len(volume) - 1)) for off in (-step, 0, step)]
    panels = [
        _plane(grid, f"Z = {grid.axes_mm[2][plane]:.1f} mm", 1.0 - volume[plane].astype(np.float64))
        for plane in planes
    ]
    yield Figure("fig-5-6", "refocused planes", tuple(panels), inch=(4.6, 4.2))
    attenuate(volume, feature(volume, WINDOW), WINDOW)
    dark, depth = minimum_images(volume)[middle // STACK]
    found = outlines(dark, depth, _EDGE, _SMALL_PX).shapes
    rings = np.column_stack(
        [
            found[:, :2] * grid.voxel_mm[:2] + np.asarray(grid.low_mm[:2]),
            np.sqrt(found[:, 2] * found[:, 3]) * grid.voxel_mm[0],
        ]
    )
    seen = 1.0 - dark.astype(np.float64)
    yield Figure(
        "fig-5-11",
        "minimum image of 50 planes",
        (_plane(grid, "", seen), _plane(grid, "outlines", seen, rings)),
        inch=(5.4, 4.8),
    )


def _plane(grid: Grid, title: str, values: F64, rings: F64 | None = None) -> Panel:
    third = slice(len(values) // 3, 2 * len(values) // 3)
    x, y, values = grid.axes_mm[0], grid.axes_mm[1][third], values[third]
    rings = rings[(rings[:, 1] >= y[0]) & (rings[:, 1] <= y[-1])] if rings is not None else None
    return Panel(
        title,
        "X, mm",
        "Y, mm",
        (Picture(values, (float(x[0]), float(y[0])), (float(x[-1]), float(y[-1])), rings),),
    )
