"""Table 4.1: variables of the simulated calibrations, measured in our draws."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.thesis.chapter_4 import (
    BASELINE,
    CAMERAS,
    D_PIX,
    EVERY_NOISE,
    STARTS,
    Board,
    board,
)
from sabench.evaluation.thesis.common import Item, make_row
from sabench.geometry.camera import Camera

SEEDS = 5
_EDGE_MM = 50.0


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure noise and initial errors as drawn, and sizes of array and boards."""
    for noise in EVERY_NOISE:
        drawn = [board(13, BASELINE, noise, 0.2, seed) for seed in seeds]
        yield make_row(
            f"noise of a pixel coordinate {noise:g} px: as drawn",
            noise,
            [float(np.nanstd(own.case.pixels - own.exact)) for own in drawn],
        )
    for start in STARTS:
        drawn = [board(13, BASELINE, 0.5, start, seed) for seed in seeds]
        values = [float(np.std(own.case.initial_mm - own.points_mm)) for own in drawn]
        yield make_row(
            f"initial error of a point {start:g} of the edge: as drawn",
            start,
            [value / _EDGE_MM for value in values],
            f"{np.mean(values):.3g} mm; cameras {200.0 * start:g} mm, {20.0 * start:g} degrees, "
            f"{30.0 * start:g} % of the focal length",
        )
    given = board(13, BASELINE, 0.5, 0.2, seeds[0])
    yield from _sizes(given)
    yield make_row(
        "combinations of cameras, noise and initial error",
        3.0 * 5.0 * 5.0,
        [float(len(CAMERAS) * len(EVERY_NOISE) * len(STARTS))],
        f"cameras {CAMERAS}, measured by `appendix-c`; noise and starts are those that the text, "
        "figure 4-12 and appendix C name",
    )


def _sizes(given: Board) -> Iterator[Item]:
    """Compare the array and the boards with section 4.4.2."""
    camera, boards, points = given.cameras[0], *given.points_mm.shape[:2]
    wall = camera.wall
    thickness = wall.layers[0].thickness_mm if wall else 0.0
    yield make_row("calibration planes", 5.0, [float(boards)])
    yield make_row("points of a plane", 121.0, [float(points)], "11 x 11")
    yield make_row("thickness of the wall, mm", 5.0, [thickness])
    yield make_row(
        "pixel of the central camera in the middle of the volume, mm",
        D_PIX,
        [_pixel_mm(given.cameras[4])],
    )


def _pixel_mm(camera: Camera) -> float:
    """Project a short line in the middle of the volume."""
    ends = np.array([[-0.5, 0.0, 35.0], [0.5, 0.0, 35.0]])
    seen = camera.project(ends)[0]
    return float(1.0 / np.linalg.norm(seen[1] - seen[0]))
