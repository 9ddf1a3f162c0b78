"""Common parts of figures 4-23 to 4-31: a traversed grid in three tests.

The images are the same in all tests; the nominal spacing of the planes is right, half of the true
one, or a quarter of it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.api import Calibration
from sabench.evaluation.thesis.chapter_4 import Board, draw, places_of, solve_case, with_points
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.utils.arrays import F64

SOLVERS = {"randomised": "refractive_autocal_randomised", "joint": "refractive_autocal"}
STEPS = {"test 1": 4.0, "test 2": 2.0, "test 3": 1.0}  # nominal mm between planes
PLANES, STEP_MM, MIDDLE_MM = 11, 4.0, 132.0
MIDDLE = PLANES // 2  # the reference plane
_DISTANCE_MM, _SPACING_MM = 760.0, 150.0
_PLACES = [
    (x, y) for y in (-1, 0, 1) for x in (-1, 0, 1) if (x, y) != (-1, -1)
]  # the ninth camera's firmware was too old


@dataclass(frozen=True)
class Traversed:
    """Calibration of one test.

    Attributes
    ----------
    given : its case, with the truth.
    answer, points_mm : what a solver returns: cameras, and points (plane, point, 3).
    """

    given: Board
    answer: Calibration
    points_mm: F64


def make_traverse() -> Scene:
    """Make the scene: eight cameras behind a wall, a grid at eleven positions.

    Images have 1024 x 768 pixels; the level grid moves by 4 mm.
    """
    values: dict[str, Any] = load_scene("calibration").to_dict()
    array = MIDDLE_MM - _DISTANCE_MM
    positions = [{"center_mm": [x * _SPACING_MM, y * _SPACING_MM, array]} for x, y in _PLACES]
    values["cameras"] |= {
        "rows": 768,
        "columns": 1024,
        "pixel_mm": 0.00465,
        "focal_length_mm": 50.0,
        "layout": {"kind": "list", "places": positions},
    }
    depth = STEP_MM * (PLANES - 1)
    values["volume"] = {"center_mm": [0.0, 0.0, MIDDLE_MM], "size_mm": [55.0, 40.0, depth]}
    values["targets"] |= {
        "columns": 11,
        "rows": 9,
        "pitch_mm": 4.5,
        "tilt_deg": 0.0,
        "roll_deg": 0.0,
        "wander": 0.0,
    }
    known = [{"frame": MIDDLE, "point": 49}]
    values["calibration"] = {
        "center_mm": 5.0,
        "turn_deg": 0.5,
        "focal_percent": 2.0,
        "known": known,
    }
    return parse_scene(values | {"frames": PLANES}, "traversed grid")


@functools.cache
def calibrate(solver: str, step_mm: float, seed: int) -> Traversed:
    """Solve from a nominal distance of the planes, once for all figures."""
    given = draw(make_traverse(), seed)
    nominal = given.points_mm.copy()
    nominal[..., 2] = MIDDLE_MM + step_mm * (np.arange(PLANES) - MIDDLE)[:, None]
    start = with_points(given, nominal)
    answer = solve_case(solver, start)
    return Traversed(start, answer, places_of(answer, start))
