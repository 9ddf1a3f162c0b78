"""Figure 2-7: Q against the number of cameras and against the mapping error.

Part (a) varies the number of cameras, part (b) the mapping error of 13 cameras. Two values of
section 2.3.2 are with 9 cameras.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from sabench.evaluation.suites import SceneCase
from sabench.evaluation.thesis.common import (
    ADEQUATE,
    METHODS,
    Row,
    cases,
    claim,
    coarsen,
    density,
    make_row,
    measure_quality,
    per_pixel,
)
from sabench.scenes import build_rig

SEEDS = 10  # the thesis makes ten draws of every mapping error
CAMERAS, ERRORS = "fig-2-7a", "fig-2-7b"
_STATED = {(9, 3.0): 0.77, (9, 5.0): 0.71}  # cameras, particles per mm3
_LIMIT_PX = 0.45
_FEW, _ENOUGH = 5, 13  # "the most efficient number seems to be in the range of 10-15"
_FLAT = 0.5


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure both parts of the figure."""
    yield from _camera_rows(seeds, pixels)
    yield from _error_rows(seeds, pixels)


def by_cameras(suite: str) -> list[tuple[int, SceneCase]]:
    """List a suite's cases with their numbers of cameras, from few to many."""
    counted = [(len(build_rig(case.scene).cameras), case) for case in cases(suite)]
    return sorted(counted, key=lambda pair: (density(pair[1].scene), pair[0]))


def _camera_rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    curves: dict[tuple[str, float], dict[int, float]] = {}
    for cameras, case in by_cameras(CAMERAS):
        found = [measure_quality(coarsen(case.scene, pixels), seed) for seed in seeds]
        per_mm3, note = density(case.scene), f"{per_pixel(case.scene):.3f} ppp"
        for method in METHODS:
            values = [frame[method].best for frame in found]
            curves.setdefault((method, per_mm3), {})[cameras] = float(np.mean(values))
            yield make_row(
                f"Q of {cameras} cameras at {per_mm3:g} per mm3, {method}",
                _STATED.get((cameras, per_mm3)),
                values,
                note,
                "larger",
            )
    for (method, per_mm3), curve in curves.items():
        yield _saturation(f"Q at {per_mm3:g} per mm3 saturates, {method}", curve)


def _saturation(name: str, curve: Mapping[int, float]) -> Row:
    most = max(curve)
    share = (curve[most] - curve[_ENOUGH]) / (curve[_ENOUGH] - curve[_FEW])
    said = f"beyond 10 to 15 cameras, taken as: from {_ENOUGH} on it gains less than half of before"
    return claim(
        name,
        said,
        share,
        share < _FLAT,
        f"gain from {_ENOUGH} to {most} cameras over gain from {_FEW} to {_ENOUGH}",
    )


def _error_rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    errors: list[float] = []
    curves: dict[str, list[list[float]]] = {method: [] for method in METHODS}
    for case in cases(ERRORS):
        errors.append(float(case.axes["calibration.shift_px"]))
        found = [measure_quality(coarsen(case.scene, pixels), seed) for seed in seeds]
        for method, curve in curves.items():
            curve.append([frame[method].best for frame in found])
            thesis = ADEQUATE if errors[-1] == _LIMIT_PX else None
            yield make_row(
                f"Q of 13 cameras with a mapping error of {errors[-1]:g} px, {method}",
                thesis,
                curve[-1],
            )
    for method, curve in curves.items():
        limits = [falls_to(ADEQUATE, errors, values) for values in zip(*curve, strict=True)]
        known = [limit for limit in limits if limit is not None]
        row = f"mapping error at which Q falls to 0.75, px, {method}"
        yield make_row(row, _LIMIT_PX, known, better="larger")


def falls_to(level: float, x: Sequence[float], y: Sequence[float]) -> float | None:
    """Find where straight lines between points first fall below a level, or None."""
    for (x0, y0), (x1, y1) in itertools.pairwise(zip(x, y, strict=True)):
        if y0 >= level > y1:
            return x0 + (x1 - x0) * (y0 - level) / (y0 - y1)
    return None
