"""Density of particles: tables 2.1 and beyond, figures 2-6 and 3-8."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from scipy.optimize import brentq

from sabench.api.make import make_solver
from sabench.evaluation.reproduction import Row
from sabench.evaluation.suites import SceneCase
from sabench.geometry.camera import Camera
from sabench.metrics.quality_factor import quality
from sabench.metrics.reconstruction_error import true_field
from sabench.scenes import Scene, build_rig
from sabench.utils.arrays import F64

from .common import (
    ADEQUATE,
    at_least,
    cases,
    claim,
    coarsen,
    density,
    make_row,
    per_pixel,
    simulate_frame,
    with_density,
)
from .refocused_frames import METHODS, Quality, count_methods, detection_rows, measure_quality
from .theory import plane_spacing_ratio

SUITE = "table-2-1"
BOUNDED = {
    "50x50x10-D0.2": 15.0
}  # the thesis gives this array's density as a lower bound: a look beyond it
_RATIO = 1.25  # of two densities between which Q is taken for a straight line
_FARTHEST = 100.0  # voxels: no planes are that far apart
_STEPS = 12  # of that ratio, up or down, after which the search ends

Trial = Callable[[float, int], Quality]  # of a density and a seed


def table_2_1(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure plane spacing and density of every array of the table."""
    for case in cases(SUITE):
        yield _spacing_row(case)
        for method in METHODS:
            trial, label = _trial(case.scene, pixels, method), f"{case.name}, {method}"
            yield from (
                _bound_rows(label, case, trial, seeds)
                if case.name in BOUNDED
                else _density_rows(label, case, trial, seeds)
            )


def _trial(scene: Scene, pixels: int | None, method: str) -> Trial:
    return lambda per_mm3, seed: measure_quality(
        coarsen(with_density(scene, per_mm3), pixels), seed
    )[method]


def _bound_rows(label: str, case: SceneCase, trial: Trial, seeds: Sequence[int]) -> Iterator[Row]:
    for per_mm3 in (density(case.scene), BOUNDED[case.name]):
        qualities = [trial(per_mm3, seed) for seed in seeds]
        first, q = qualities[0], np.mean([quality.blind for quality in qualities])
        blind = f"k = {first.best_k:.3g}; automatic k = {first.blind_k:.3g}: Q = {q:.3g}"
        name, values = f"{label}: Q at {per_mm3:g} per mm3", [quality.best for quality in qualities]
        yield (
            at_least(name, ADEQUATE, values, blind)
            if per_mm3 == density(case.scene)
            else make_row(name, None, values, blind)
        )


def _density_rows(label: str, case: SceneCase, trial: Trial, seeds: Sequence[int]) -> Iterator[Row]:
    """Measure the largest density, with thresholds tuned with and without truth.

    The thesis tunes them with the truth.
    """
    thesis = density(case.scene)
    tuned = crossings(lambda per_mm3, seed: trial(per_mm3, seed).best, thesis, seeds)
    yield make_row(
        f"{label}: particles per mm3",
        thesis,
        tuned,
        f"thesis: {per_pixel(case.scene):.2f} ppp",
        "larger",
    )
    blind = crossings(lambda per_mm3, seed: trial(per_mm3, seed).blind, thesis, seeds)
    yield make_row(
        f"{label}, automatic k: particles per mm3",
        None,
        blind,
        "the threshold does not know the truth",
    )


def crossings(
    quality: Callable[[float, int], float], start: float, seeds: Sequence[int]
) -> list[float]:
    """Find the density where Q falls to 0.75, for every seed.

    Empty if the first seed has none near `start`.

    The first seed finds two densities on either side; between these, Q is a straight line for every
    seed. Source: thesis section 2.2.4, which interpolates linearly.
    """
    low = high = start
    for _ in range(_STEPS):
        if quality(low, seeds[0]) < ADEQUATE:
            low, high = low / _RATIO, low
        elif quality(high, seeds[0]) >= ADEQUATE:
            low, high = high, high * _RATIO
    if not quality(low, seeds[0]) >= ADEQUATE > quality(high, seeds[0]):
        return []
    ends = [(quality(low, seed), quality(high, seed)) for seed in seeds]
    return [low + (high - low) * (above - ADEQUATE) / (above - below) for above, below in ends]


def _spacing_row(case: SceneCase) -> Row:
    """Compare dZ / dX of the exact cameras with the table's, the voxels' shape."""
    across, _, along = case.scene.grid.voxel_mm
    # find the central camera and its nearest neighbour
    cameras = build_rig(case.scene).cameras
    positions = np.array([camera.center_mm for camera in cameras])
    order = np.argsort(np.linalg.norm(positions - positions.mean(axis=0), axis=1))
    center, neighbour = cameras[order[0]], cameras[order[1]]
    distance = -center.center_mm[2]
    predicted = plane_spacing_ratio(
        float(np.linalg.norm(np.subtract(neighbour.center_mm, center.center_mm))) / distance,
        across,
        0.0,
        distance,
    )
    spacing = plane_spacing_mm(center, neighbour, across)
    return make_row(
        f"{case.name}: dZ / dX",
        along / across,
        [spacing / across],
        f"equation 2.10 at Z = 0: {predicted:.4g}",
    )


def plane_spacing_mm(center: Camera, neighbour: Camera, voxel_mm: float) -> float:
    """Compute the distance from Z = 0 to the next focal plane.

    Two cameras see its point on the Z axis one voxel apart on Z = 0.

    Source: thesis section 2.2.2, where a plane is one pixel of shift from the next.
    """

    def apart(z_mm: float) -> float:
        return (
            float(np.linalg.norm(_seen_on_zero(center, z_mm) - _seen_on_zero(neighbour, z_mm)))
            - voxel_mm
        )

    return float(brentq(apart, 0.0, _FARTHEST * voxel_mm))


def _seen_on_zero(camera: Camera, z_mm: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Compute where on the plane Z = 0 a camera sees the point (0, 0, z)."""
    rays = camera.back_project(camera.project([[0.0, 0.0, z_mm]])[0])
    origin, direction = rays.origins_mm[0], rays.directions[0]
    return np.asarray(origin[:2] - origin[2] / direction[2] * direction[:2], dtype=np.float64)


SOLVERS = (
    "mlos_smart",
    "mlos_sart",
    "block_mart",
    "smart",
    "mfg_mart",
    "mart",
)  # the quickest first
_DENSER = 1.5
_TRIAL_PX = 100  # side of the images on which the solver is chosen: at full size each takes minutes
_AS_GOOD = 0.01  # in Q


def table_2_1_best(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure Q of the fastest of the solvers that are best on a coarse array."""
    for case in cases(SUITE):
        per_mm3 = _DENSER * density(case.scene)
        scene = with_density(case.scene, per_mm3)
        trial = coarsen(scene, min(pixels or _TRIAL_PX, _TRIAL_PX))
        tried = {name: solved_quality(name, trial, seeds[0]) for name in SOLVERS}
        best = next(name for name in SOLVERS if tried[name] >= max(tried.values()) - _AS_GOOD)
        values = [solved_quality(best, coarsen(scene, pixels), seed) for seed in seeds]
        others = ", ".join(f"{name} {value:.3f}" for name, value in tried.items())
        yield at_least(
            f"{case.name}: Q at {per_mm3:.4g} per mm3",
            ADEQUATE,
            values,
            f"{best}; coarse: {others}",
        )


def solved_quality(solver: str, scene: Scene, seed: int) -> float:
    """Compute Q of a solver with its own parameters on one frame."""
    shot = simulate_frame(scene, seed)
    grid = shot.observation.grid
    volume = make_solver(solver, {}).solve(shot.observation).volume
    return quality(volume[grid.scored], true_field(grid, shot.particles, shot.views)[grid.scored])


PARTS = (0.25, 0.5, 1.0, 1.5, 2.0)  # of the density that the thesis gives for Q = 0.75
_ABSENT = "40x40x30-D0.4-uneven"  # it has no curve


def fig_2_6(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure the points of each curve.

    The thesis prints only the density where Q crosses 0.75, which is in table 2.1.
    """
    for case in curves():
        for part in PARTS:
            scene = with_density(case.scene, part * density(case.scene))
            frames = [measure_quality(coarsen(scene, pixels), seed) for seed in seeds]
            thesis = ADEQUATE if part == 1.0 and case.name not in BOUNDED else None
            for method in METHODS:
                name = f"{case.name}, {method}: Q at {density(scene):.4g} per mm3"
                yield make_row(
                    name,
                    thesis,
                    [frame[method].best for frame in frames],
                    f"{per_pixel(scene):.3f} ppp",
                )


def curves() -> list[SceneCase]:
    """List the arrays of table 2.1 that figures 2-6 and 3-8 show."""
    return [case for case in cases(SUITE) if case.name != _ABSENT]


_LINEAR = 0.9  # share of the variance that a straight line explains


def fig_3_8(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure the curves, and the thesis's claims about their shapes."""
    for case in curves():
        points: dict[str, list[list[Row]]] = {method: [] for method in METHODS}
        for part in PARTS:
            scene = with_density(case.scene, part * density(case.scene))
            frames = [count_methods(coarsen(scene, pixels), seed) for seed in seeds]
            count = round(density(scene) * float(np.prod(scene.volume.size_mm)))
            for method, curve in points.items():
                curve.append(
                    detection_rows(
                        f"{case.name}, {method}, {count} particles",
                        [frame[method] for frame in frames],
                    )
                )
                yield from curve[-1]
        for method, curve in points.items():
            yield from _claims(f"{case.name}, {method}", *zip(*curve, strict=True))


def _claims(where: str, true: Sequence[Row], ghosts: Sequence[Row]) -> Iterator[Row]:
    slope, straight = _line(np.array(PARTS), np.array([row.measured or 0.0 for row in true]))
    falls = slope < 0.0 and straight >= _LINEAR
    yield claim(
        f"{where}: true %",
        "falls linearly",
        straight,
        falls,
        "share of the variance that a straight line explains",
    )
    pairs = [(part, row.measured) for part, row in zip(PARTS, ghosts, strict=True) if row.measured]
    power = _line(*np.log(np.transpose(pairs)))[0] if len(pairs) > 1 else None
    yield claim(
        f"{where}: ghost %",
        "grows faster than linearly",
        power,
        power is not None and power > 1.0,
        "power of the number of particles",
    )


def _line(x: F64, y: F64) -> tuple[float, float]:
    """Fit a line: its slope, and the fraction of the variance that it explains."""
    slope, _ = np.polyfit(x, y, 1)
    return float(slope), float(np.corrcoef(x, y)[0, 1] ** 2)
