"""Table 2.3: particles per pixel of all cameras.

A large number is efficient only if the reconstruction is adequate. The thesis takes tomographic
PIV, defocusing digital PIV (DDPIV) and particle tracking (PTV) from the literature; here they are
simulated. Holography is not.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from sabench.algorithms.particles.defocusing import Apertures, match_triangles
from sabench.algorithms.particles.matching import select_best, select_rows
from sabench.api import Camera, ImageSequence
from sabench.api.make import make_solver
from sabench.evaluation.reproduction import Row
from sabench.evaluation.suite_loading import override
from sabench.geometry.grid import Grid
from sabench.images.peaks import Peaks, sort_peaks
from sabench.metrics.particle_detection import Counts, count_thesis
from sabench.metrics.reconstruction_error import score_frame
from sabench.scenes import Scene, build_rig, load_scene
from sabench.simulation.in_memory import Shot
from sabench.utils.arrays import F64
from sabench.utils.rng import stream

from .common import (
    ADEQUATE,
    at_least,
    cases,
    coarsen,
    density,
    make_row,
    per_pixel,
    run,
    simulate_frame,
)
from .refocused_frames import METHODS, detection_rows, measure_quality

_PER_PIXEL, _PER_TOTAL_PIXEL, _PARTICLES = 0.125, 0.01, 125_000
_NOISE_PX, _REACH_PX = (0.0, 0.2), (0.05, 0.8)  # of images without overlaps, and triangles' reach


def table_2_3(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Load the table's arrays with their particles."""
    yield from _synthetic_aperture(seeds, pixels)
    for name, per_total, per_px, scene in _tomographic_scenes():
        yield _efficiency(name, per_total, per_px, scene)
        yield from _tomography(name, coarsen(scene, pixels), seeds)
    for name, per_total, scene, solvers in _particle_scenes():
        images = scene.cameras.rows * scene.cameras.columns
        count = scene.particle_world.particles["count"]
        yield _efficiency(name, per_total, count / images, scene)
        yield from _particle_solvers(name, coarsen(scene, pixels), solvers, seeds)


def _synthetic_aperture(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    for case in cases("table-2-3"):
        cameras = len(build_rig(case.scene).cameras)
        count = density(case.scene) * float(np.prod(case.scene.volume.size_mm))
        yield make_row("particles", _PARTICLES, [count])
        yield make_row("particles per pixel", _PER_PIXEL, [per_pixel(case.scene)])
        yield make_row(
            "particles per pixel of all cameras",
            _PER_TOTAL_PIXEL,
            [per_pixel(case.scene) / cameras],
            "the thesis rounds",
        )
        frames = [measure_quality(coarsen(case.scene, pixels), seed) for seed in seeds]
        for method in METHODS:
            values = [frame[method].best for frame in frames]
            yield at_least(
                f"Q of {cameras} cameras, {method}",
                ADEQUATE,
                values,
                "the thesis calls 0.75 adequate and states no value",
            )


def _tomographic_scenes() -> Iterator[tuple[str, float, float, Scene]]:
    """Make scenes of Tomo-PIV [15] to [17], with both particles per pixel.

    The two deep ones are cut: 500 x 500 voxels of full depth, and images that hold what the cut
    shows. Their edges, where fewer lines of sight meet, are not scored.
    """
    scene = load_scene("elsinga-35x35x7")
    yield "Tomo-PIV [15]", 0.013, 0.05, scene
    for name, per_total, per_px, depth, side in (
        ("Tomo-PIV [16]", 0.02, 0.08, 297, 584),
        ("Tomo-PIV [17]", 0.006, 0.024, 410, 640),
    ):
        cut: dict[str, Any] = {
            "volume.size_mm": [25.0, 25.0, depth * 0.05],
            "grid.crop_mm": [depth * 0.0125, depth * 0.0125, 0.0],
            "cameras.rows": side,
            "cameras.columns": side,
            "particles.per_pixel": per_px * (500 / side) ** 2,
        }
        yield f"{name}, cut", per_total, per_px, override(scene, cut, name)


def _particle_scenes() -> Iterator[tuple[str, float, Scene, tuple[str, ...]]]:
    """Make scenes of DDPIV [9] and [34] and PTV [4], with efficiency, solvers.

    DDPIV [34] has other lengths and as many pixels: in pixels it is [9] with fewer particles.
    """
    scene, both = load_scene("ddpiv-100x100x100"), ("ddpiv", "ray_triangulation")
    yield "DDPIV [9]", 0.013, scene, both
    fewer = override(scene, {"particles.count": 35_000}, "DDPIV [34]")
    yield "DDPIV [34]", 0.011, fewer, both
    yield "DDPIV, a tenth", 0.0013, override(scene, {"particles.count": 4_000}, "DDPIV"), both
    yield "PTV [4]", 0.0013, load_scene("ptv-200x160x50"), ("ray_triangulation",)


def _efficiency(name: str, thesis: float, per_px: float, scene: Scene) -> Row:
    cameras = len(build_rig(scene).cameras)
    return make_row(f"{name}: particles per pixel of all cameras", thesis, [per_px / cameras])


def _tomography(name: str, scene: Scene, seeds: Sequence[int]) -> Iterator[Row]:
    """Score the tomographic solvers of a scene."""
    scores: dict[str, list[dict[str, float | None]]] = {"mart": [], "mlos_smart": []}
    for seed in seeds:
        shot = simulate_frame(scene, seed)
        for solver, figures in scores.items():
            guess = make_solver(solver, {}).solve(shot.observation)
            figures.append(score_frame(shot.observation.grid, shot.particles, shot.views, guess))
    for solver, figures in scores.items():
        yield at_least(f"{name}: Q, {solver}", ADEQUATE, _values(figures, "q"))
        yield make_row(f"{name}: {solver}: true %", None, _values(figures, "true_percent"))
        yield make_row(f"{name}: {solver}: ghost %", None, _values(figures, "ghost_percent"))


def _values(scores: Sequence[dict[str, float | None]], key: str) -> list[float]:
    return [value for score in scores if (value := score[key]) is not None]


def _particle_solvers(
    name: str, scene: Scene, solvers: Sequence[str], seeds: Sequence[int]
) -> Iterator[Row]:
    """Count particles of a scene by the thesis's rule.

    For DDPIV also those of triangles of images that do not overlap, exact or with noise.
    """
    counts: dict[str, list[Counts]] = {solver: [] for solver in solvers}
    apart: dict[float, list[Counts]] = {noise: [] for noise in _NOISE_PX if "ddpiv" in solvers}
    for seed in seeds:
        shot = simulate_frame(scene, seed)
        case = ImageSequence.of([shot.observation])
        for solver, tallies in counts.items():
            (estimate,) = run(solver, case)
            tallies.append(_count(shot, estimate.position_mm))
        for (noise, tallies), reach in zip(apart.items(), _REACH_PX, strict=False):
            # match the places of all images with noise, also of those that overlap. Returns
            # positions (n, 3)
            frame, rng = shot.observation, stream(seed, "image noise")
            cameras = [camera for camera in frame.cameras if isinstance(camera, Camera)]
            peaks: list[Peaks] = []
            for camera in cameras:
                exact = camera.project(shot.particles.position_mm)[0]
                pixels = exact + noise * rng.standard_normal(exact.shape)
                size = camera.rows, camera.columns
                peaks.append(sort_peaks(pixels[camera.contains(pixels)], size))
            every = match_triangles(Apertures.of(cameras), cameras, tuple(peaks), frame.grid, reach)
            best = select_best(every, tuple(peaks))
            tallies.append(_count(shot, select_rows(every, best).position))
    for solver, tallies in counts.items():
        yield from detection_rows(f"{name}: {solver}", tallies)
    for noise, tallies in apart.items():
        yield from detection_rows(f"{name}: ddpiv, images apart, {noise:g} px noise", tallies)


def _count(shot: Shot, position_mm: F64) -> Counts:
    grid: Grid = shot.observation.grid
    here, true = grid.to_voxels(position_mm), grid.to_voxels(shot.particles.position_mm)
    return count_thesis(here, true, grid.in_scored(here), grid.in_scored(true))
