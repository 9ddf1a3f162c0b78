"""Figures 4-23 and 4-24: reprojection errors in three tests of a traversed grid.

Figure 4-24 is drawn over rendered images of the grid, in which the circles are also detected: this
shows what noise of measured points to expect.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from sabench.algorithms.calibration.target_detection import detect
from sabench.evaluation.suite_loading import override
from sabench.evaluation.thesis.chapter_4 import by_camera, photograph, reprojection
from sabench.evaluation.thesis.common import AGREES, Item, claim, make_row
from sabench.evaluation.thesis.traverse import (
    MIDDLE,
    PLANES,
    SOLVERS,
    STEPS,
    Traversed,
    calibrate,
    make_traverse,
)
from sabench.plotting.charts import Cloud, Curve, Figure, Panel, Picture
from sabench.utils.arrays import F64, U16
from sabench.utils.progress import progress_bar
from sabench.worlds.calibration_targets import place

SEEDS = 5
_SMALL_PX = 0.4  # error of the mapping from which refocusing suffers, as chapter 4 says
_SHOWN = ((1, PLANES - 1), (3, MIDDLE))  # camera and plane of figure 4-24, a and b
_POINT = 27  # of the grid, shown in detail
_ZOOM_PX = 25
_LIGHT: Mapping[str, Any] = {
    "targets.pattern": "circles",
    "lighting": {"lamps": [{"center_mm": [side, 0.0, -400.0]} for side in (-300.0, 300.0)]},
    "sensor": {"read_noise_e": 10.0, "black_level_dn": 50.0},
    "render": {"samples_per_pixel": 16},
}


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure each camera's reprojection error, per solver and test."""
    means: dict[tuple[str, str], list[F64]] = {}
    scatters: dict[tuple[str, str], list[F64]] = {}
    for seed in progress_bar(seeds, "traversed grids"):
        for name, solver in SOLVERS.items():
            for test, step in STEPS.items():
                errors = _errors(calibrate(solver, step, seed))
                means.setdefault((name, test), []).append(by_camera(errors))
                scatters.setdefault((name, test), []).append(np.nanstd(errors, axis=(1, 2)))
    for (name, test), draws in means.items():
        spread = float(np.mean([own.mean() for own in scatters[name, test]]))
        yield make_row(
            f"{name}, {test}: mean reprojection error, px",
            None,
            [float(own.mean()) for own in draws],
            f"standard deviation {spread:.3g} px; worst camera {np.max(draws):.3g} px",
        )
    for name in SOLVERS:
        yield from _claims(name, {test: np.array(means[name, test]) for test in STEPS})
    yield _bars(means, scatters)
    yield from _images(seeds[0])


def _errors(done: Traversed) -> F64:
    return reprojection(done.answer, done.given, done.given.case.pixels)


def _claims(name: str, means: dict[str, F64]) -> Iterator[Item]:
    """Judge the claims on figure 4-23; means are (seed, camera) per test."""
    first = means["test 1"]
    change = float(max(np.abs(own / first - 1.0).max() for own in means.values()))
    yield claim(
        f"{name}: largest change of a camera's mean error between the tests",
        "little impact of the initial planes",
        change,
        change <= AGREES,
        "as a share of test 1",
    )
    largest = float(max(own.max() for own in means.values()))
    yield claim(
        f"{name}: largest mean error of a camera, px",
        "relatively small in each camera",
        largest,
        largest < _SMALL_PX,
        f"0.1 px of noise make {0.1 * np.sqrt(np.pi / 2.0):.3g} px",
    )


def _bars(
    means: dict[tuple[str, str], list[F64]], scatters: dict[tuple[str, str], list[F64]]
) -> Figure:
    """Draw figure 4-23, mean over the seeds."""
    numbers = range(1, len(means["joint", "test 1"][0]) + 1)
    panels = [
        Panel(
            f"{name}: {what}",
            "camera",
            "px",
            tuple(
                Curve(test, numbers, np.mean(values[name, test], axis=0).tolist()) for test in STEPS
            ),
        )
        for name in SOLVERS
        for what, values in (("mean", means), ("standard deviation", scatters))
    ]
    return Figure(
        "fig-4-23", "Figure 4-23: reprojection error by camera and test", tuple(panels), across=2
    )


def _images(seed: int) -> Iterator[Item]:
    """Draw figure 4-24, and measure how well circles are detected in its images."""
    scene = override(make_traverse(), dict(_LIGHT), "traversed grid of circles")
    target = place(scene, seed).target
    panels: list[Panel] = []
    for letter, (camera, plane) in zip("ab", _SHOWN, strict=True):
        image = photograph(scene, plane, camera - 1, seed)
        points = _points(camera - 1, plane, seed)
        title = f"({letter}) camera {camera}, plane {plane + 1}"
        panels += [_overlay(title, image, points), *_detail(title, image, points)]
        off = detect(image, target, points["true"]) - points["true"]
        yield make_row(
            f"{title}, rendered: noise of a detected coordinate, px",
            None,
            [float(np.nanstd(off))],
            f"{np.isfinite(off).all(axis=1).sum()} of {len(off)} circles",
        )
    words = "Figure 4-24: measured and reprojected points, randomised solver"
    yield Figure("fig-4-24", words, tuple(panels), across=3)


def _points(camera: int, plane: int, seed: int) -> dict[str, F64]:
    """Collect true, measured and reprojected pixels (point, 2) of a camera and plane."""
    done = {test: calibrate(SOLVERS["randomised"], step, seed) for test, step in STEPS.items()}
    given = done["test 1"].given
    points = {"true": given.exact[camera, plane], "measured": given.case.pixels[camera, plane]}
    return points | {
        test: one.answer.cameras[camera].project(one.points_mm[plane])[0]
        for test, one in done.items()
    }


def _overlay(title: str, image: U16, points: dict[str, F64]) -> Panel:
    """Show a whole image with all points."""
    clouds = (Cloud(name, *own.T) for name, own in points.items() if name != "true")
    rows, columns = image.shape
    seen = Picture(image.astype(np.float64), (0.0, 0.0), (columns - 1.0, rows - 1.0))
    return Panel(title, "px", "px", (seen, *clouds))


def _detail(title: str, image: U16, points: dict[str, F64]) -> tuple[Panel, Panel]:
    """Show one circle, and its points relative to the true one."""
    true = points["true"][_POINT]
    (left, top), (right, bottom) = (
        np.rint(true + side * _ZOOM_PX).astype(int).tolist() for side in (-1, 1)
    )
    cut = image[top : bottom + 1, left : right + 1].astype(np.float64)
    seen = Picture(cut, (float(left), float(top)), (float(right), float(bottom)))
    marks = [
        (name, own[_POINT].tolist(), (own[_POINT] - true).tolist()) for name, own in points.items()
    ]
    circle = (Curve(name, [at[0]], [at[1]]) for name, at, _ in marks)
    near = tuple(Curve(name, [off[0]], [off[1]]) for name, _, off in marks)
    return (
        Panel(f"{title}, point {_POINT}", "px", "px", (seen, *circle)),
        Panel("relative to the true point", "columns, px", "rows, px", near),
    )
