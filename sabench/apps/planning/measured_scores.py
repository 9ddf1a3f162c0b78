"""Scores that solvers reach on a reduced twin of a scene.

The twin keeps cameras, walls, light and density. Its images and its volume across the lines of
sight are smaller, as far as the figures that scores depend on stay the same.
"""

import contextlib
import math
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sabench.apps.planning.expected_scores import EDGE, SCORES, ExpectedScore, feature_values
from sabench.apps.planning.plan import Plan, plan
from sabench.apps.planning.viewing import Quantity, Section
from sabench.scenes import Scene, parse_scene
from sabench.simulation.pipeline import generate
from sabench.tasks.solve_and_score import score, solve
from sabench.utils.arrays import F64
from sabench.utils.errors import DeclinedError, InputError
from sabench.utils.progress import say

_LEAST_PX = 100  # rows or columns: fewer show too few particles


def measure_scores(planned: Plan, draws: int = 3) -> Plan:
    """Replace the expected scores of a plan by measured ones.

    `draws` data sets differ in particles, noise and calibration errors.

    Raises
    ------
    InputError
        A scene whose cameras see no lit particles, or one that cannot be generated or solved.
    """
    figures = feature_values(planned.sections)
    if figures is None:
        raise InputError(f"{planned.scene.title}: expected a scene with lit particles to measure")
    twin = _reduce(planned, figures)
    size = f"{draws} data sets of {twin.cameras.columns} x {twin.cameras.rows} px"
    say(f"measure scores on {size}")
    found: dict[str, list[float]] = {key: [] for key in SCORES}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(draws):
            data = generate(twin, Path(folder) / f"{seed}", seed=seed)
            scores: dict[str, Mapping[str, Any]] = {}
            for name in dict.fromkeys(one.solver for one in SCORES.values()):
                with contextlib.suppress(DeclinedError):  # such as too few cameras
                    scores[name] = score(
                        data, solve(name, data, Path(folder) / f"{name}-{seed}.h5")
                    )
            for key, one in SCORES.items():
                found[key].append(_value(one, scores.get(one.solver, {})))
    quantities = tuple(_together(key, got, size) for key, got in found.items())
    kept = tuple(one for one in planned.sections if one.title != "expected scores")
    return replace(planned, sections=(*kept, Section("measured scores", quantities)))


def _value(expected: ExpectedScore, scores: Mapping[str, Any]) -> float:
    peaks = {"ghosts": "peak_ghost_percent"} | ({"f1": "peak_f1"} if "peak_f1" in scores else {})
    value = scores.get(peaks.get(expected.score, expected.score))
    unit = 0.01 if expected.score == "ghosts" else 1.0
    return math.nan if value is None else unit * value


def _together(key: str, got: list[float], size: str) -> Quantity:
    value, scatter = float(np.mean(got)), float(np.std(got, ddof=1))
    words = "no score" if math.isnan(value) else f"+- {scatter:.2g} between them"
    meaning = f"{SCORES[key].meaning}, {words}"
    return Quantity(key, None if math.isnan(value) else value, meaning, size)


def _reduce(planned: Plan, wanted: F64) -> Scene:
    """Find a small twin with the figures of the scene; or return a small scene."""
    scene, axis = planned.scene.with_frames(1), planned.viewing.axis
    size_px = min(scene.cameras.rows, scene.cameras.columns)
    share = _LEAST_PX / size_px
    while share < min(1.0, 4.0 * _LEAST_PX / size_px):
        values = scene.to_dict()
        for key in ("rows", "columns"):
            values["cameras"][key] = round(share * values["cameras"][key])
        shares = [1.0 if edge == axis else share for edge in range(3)]
        size = [one * part for one, part in zip(scene.volume.size_mm, shares, strict=True)]
        values["volume"]["size_mm"] = size
        if "count" in values["particles"]:
            values["particles"]["count"] = round(values["particles"]["count"] * share**2)
        with contextlib.suppress(InputError):  # margins may not fit into a small volume
            twin = parse_scene(values, scene.title)
            got = feature_values(plan(twin).sections)
            if got is not None and np.allclose(got, wanted, rtol=2.0 * EDGE, atol=EDGE):
                return twin
        share *= 1.5
    if size_px > 4.0 * _LEAST_PX:
        why = "no small scene has the figures of this one: generate it, solve it and score it"
        raise InputError(f"{scene.title}: {why}")
    return scene
