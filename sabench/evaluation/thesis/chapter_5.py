"""Frames rendered in memory for the tables and figures of bubbles."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sabench.algorithms.bubbles.feature_potential import (
    STACK,
    WINDOW,
    attenuate,
    darkness,
    feature_potential,
    find_outlines,
    minimum_images,
)
from sabench.api import Observation
from sabench.api.truth import Bubbles
from sabench.geometry.grid import Grid
from sabench.plotting.charts import Figure, Panel, Picture
from sabench.scenes import Scene, build_rig
from sabench.simulation.camera_view import render
from sabench.simulation.frame_content import FrameContent
from sabench.simulation.frames import Frames
from sabench.simulation.in_memory import observation_of
from sabench.simulation.rendering.sensor import expose
from sabench.utils.arrays import F64
from sabench.utils.progress import progress_bar

_OFF_MM = 10.0  # of the refocused planes before and behind the middle one: figure 5-6
_EDGE, _SMALL_PX = 0.05, 4.0  # as `minimum_image` takes them


Rendered = tuple[FrameContent, Bubbles, Observation]  # a frame, its bubbles, what a solver gets


def render_first_frame(scene: Scene, seed: int) -> Rendered:
    """Render the first frame of the data set that `generate` would make, in memory."""
    return next(render_frames(scene, seed))


def render_frames(scene: Scene, seed: int) -> Iterator[Rendered]:
    """Render all frames of the data set that `generate` would make."""
    frames = Frames(scene, build_rig(scene, scene.title), seed)
    for time in range(scene.frames):
        frame = frames.at(time)
        if frame.bubbles is None:
            raise ValueError(f"{scene.title}: expected a scene with bubbles")
        numbers = range(len(frame.rig.cameras))
        images = [
            expose(scene.sensor, render(frame, number).photons, frame.sensor_noise(number))
            for number in progress_bar(numbers, f"render {scene.title}, seed {seed}, frame {time}")
        ]
        yield frame, frame.bubbles, observation_of(frame, images)


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
    attenuate(volume, feature_potential(volume, WINDOW), WINDOW)
    dark, depth = minimum_images(volume)[middle // STACK]
    found = find_outlines(dark, depth, _EDGE, _SMALL_PX).shapes
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
