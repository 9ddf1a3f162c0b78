"""Figures 4-25 and 4-26: plane spacing of a traversed grid.

It is calibrated from poorer and poorer initial guesses, in the camera array of the vortex ring's
experiment.

The experiment's traverse moved the grid by 4 mm, to 0.01 mm; here it does so exactly, so that all
that is left is the calibration's own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sabench.evaluation.thesis.chapter_4 import Board, draw, places_of, solve_case
from sabench.evaluation.thesis.common import Item, claim, make_row
from sabench.geometry.rigid_motion import fit_rigid_motion
from sabench.plotting.charts import Curve, Figure, Panel
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.utils.arrays import F64
from sabench.utils.progress import progress_bar

SEEDS = 5
_SOLVERS = {"randomised": "refractive_autocal_randomised", "joint": "refractive_autocal"}
_STEPS = {"test 1": 4.0, "test 2": 2.0, "test 3": 1.0}  # nominal mm between planes
_PLANES, _STEP_MM, _MIDDLE_MM = 11, 4.0, 132.0
_DISTANCE_MM, _SPACING_MM = 760.0, 150.0
_PLACES = [
    (x, y) for y in (-1, 0, 1) for x in (-1, 0, 1) if (x, y) != (-1, -1)
]  # the ninth camera's firmware was too old
_FLUCTUATION_MM = 0.02


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure errors of mean spacings per solver and test; compare the tests."""
    found: dict[tuple[str, str], list[F64]] = {}
    turns: dict[tuple[str, str], list[float]] = {}
    for seed in progress_bar(seeds, "traversed grids"):
        given = draw(make_traverse(), seed)
        for name, solver in _SOLVERS.items():
            first: F64 | None = None
            for test, step in _STEPS.items():
                positions = _planes(solver, given, step)
                first = positions if first is None else first
                found.setdefault((name, test), []).append(
                    np.stack([np.diff(positions[..., 2], axis=0).mean(axis=1), _scatter(positions)])
                )
                turns.setdefault((name, test), []).append(_turn_deg(positions, first))
    for (name, test), draws in found.items():
        off = [float(np.abs(own[0] - _STEP_MM).max()) for own in draws]
        head = f"{name}, {test} (nominal {_STEPS[test]:g} mm)"
        yield make_row(
            f"{head}: largest error of a mean spacing, mm",
            None,
            off,
            f"points scatter by {np.mean([own[1] for own in draws]):.3g} mm",
        )
        if test == "test 1":
            continue
        between = [
            float(np.abs(own[0] - ref[0]).max())
            for own, ref in zip(draws, found[name, "test 1"], strict=True)
        ]
        mean = float(np.mean(between))
        yield claim(
            f"{head}: largest difference of a spacing to test 1, mm",
            "all tests alike to 0.02 mm",
            mean,
            mean <= _FLUCTUATION_MM,
        )
        yield make_row(
            f"{head}: turn of all points against test 1, degrees",
            None,
            turns[name, test],
            "thesis, figure 4-26: seen, without a number",
        )
    yield _figure(found)


def make_traverse() -> Scene:
    """Make the scene: eight cameras behind a wall, a grid at eleven positions.

    Images have 1024 x 768 pixels; the level grid moves by 4 mm.
    """
    values: dict[str, Any] = load_scene("calibration").to_dict()
    array = _MIDDLE_MM - _DISTANCE_MM
    positions = [{"center_mm": [x * _SPACING_MM, y * _SPACING_MM, array]} for x, y in _PLACES]
    values["cameras"] |= {
        "rows": 768,
        "columns": 1024,
        "pixel_mm": 0.00465,
        "focal_length_mm": 50.0,
        "layout": {"kind": "list", "places": positions},
    }
    depth = _STEP_MM * (_PLANES - 1)
    values["volume"] = {"center_mm": [0.0, 0.0, _MIDDLE_MM], "size_mm": [55.0, 40.0, depth]}
    values["targets"] |= {
        "columns": 11,
        "rows": 9,
        "pitch_mm": 4.5,
        "tilt_deg": 0.0,
        "roll_deg": 0.0,
        "wander": 0.0,
    }
    known = [{"frame": 5, "point": 49}]
    values["calibration"] = {
        "center_mm": 5.0,
        "turn_deg": 0.5,
        "focal_percent": 2.0,
        "known": known,
    }
    return parse_scene(values | {"frames": _PLANES}, "traversed grid")


def _planes(solver: str, given: Board, step_mm: float) -> F64:
    """Solve for points (plane, point, 3) from a nominal distance of the planes."""
    nominal = given.points_mm.copy()
    nominal[..., 2] = _MIDDLE_MM + step_mm * (np.arange(_PLANES) - _PLANES // 2)[:, None]
    start = replace(given, case=replace(given.case, initial_mm=nominal))
    return places_of(solve_case(solver, start), start)


def _scatter(positions: F64) -> F64:
    return np.asarray(np.diff(positions[..., 2], axis=0).std(axis=1))


def _turn_deg(positions: F64, reference: F64) -> float:
    turn = fit_rigid_motion(positions.reshape(-1, 3), reference.reshape(-1, 3)).rotation
    return float(np.rad2deg(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))))


def _figure(found: dict[tuple[str, str], list[F64]]) -> Figure:
    """Draw the first seed, as the thesis shows its one experiment."""
    numbers = range(1, _PLANES)
    panels = []
    for name in _SOLVERS:
        curves = tuple(
            Curve(test, numbers, found[name, test][0][0], found[name, test][0][1])
            for test in _STEPS
        )
        panels.append(Panel(name, "k", "spacing of planes k and k + 1, mm", curves))
    return Figure("fig-4-25", "Figure 4-25: spacing of the planes, 0.1 px", tuple(panels))
