"""Frames refocused by the thesis's two methods, with Q and detected particles.

**Map-shift-average** uses the thesis's own voxels. Its planes are one pixel of shift apart, as the
central camera sees them, so that whole-pixel shifts are exact and nothing is resampled after the
first mapping. Voxels are pixels of the middle plane along x and y and numbers of shifts along z
(thesis section 2.2.4); particles are carried into that space before they are compared.

**Additive** refocusing is equation 3.3 with exact projections onto the scene's grid.

The threshold with the best Q needs the truth: it scores thresholds, and no solver can use it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from sabench.algorithms.refocus import cpu_kernels, refocus_sum
from sabench.algorithms.refocus.rectification import LINEAR, coefficients_of, resample
from sabench.algorithms.refocus.slabs import Slab, make_slab, rectifying_maps
from sabench.algorithms.refocus.synthetic_aperture import shift_maps
from sabench.algorithms.refocus.thresholding import auto_k, extract, occupancy, plane_statistics
from sabench.api import Observation
from sabench.api.truth import Particles
from sabench.evaluation.reproduction import Row
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.metrics.particle_detection import Counts, count_thesis, detect
from sabench.metrics.reconstruction_error import true_field
from sabench.scenes import Scene
from sabench.simulation.in_memory import Shot
from sabench.utils.arrays import F32, F64
from sabench.utils.compiled import numba
from sabench.utils.threads import on_cores

from .common import make_row, simulate_frame

KS = np.linspace(0.0, 20.0, 401)


@dataclass(frozen=True)
class Quality:
    """Quality factor Q of a refocused frame.

    Attributes
    ----------
    best, best_k : at the threshold that makes it largest, as the thesis tunes it with the truth at
        hand.
    blind, blind_k : at the threshold that the images alone suggest.
    """

    best: float
    best_k: float
    blind: float
    blind_k: float


@dataclass(frozen=True)
class Judged:
    """Q of a frame, and its true and ghost particles by the thesis's rule."""

    quality: Quality
    counts: Counts


@dataclass(frozen=True)
class Refocused:
    """Refocused frame without threshold, with the truth in its voxels.

    Attributes
    ----------
    case : the frame with the grid of the volume.
    truths : true particles as fractional voxel indices (n, 3).
    volume, field : what refocusing gave and the E_s that it should become, (z, y, x).
    """

    case: Observation
    truths: F64
    volume: F32
    field: F32

    @classmethod
    def from_shot(cls, shot: Shot, grid: Grid, particles: Particles, volume: F32) -> Refocused:
        """Make one from a volume on its grid and the particles in the grid's space."""
        field = true_field(grid, particles, shot.views)
        return cls(
            replace(shot.observation, grid=grid),
            grid.to_voxels(particles.position_mm),
            volume,
            field,
        )

    def quality(self) -> Quality:
        """Compute Q (equation 2.13) with thresholds subtracted from what exceeds them."""
        values = quality_of_k(self.volume, self.field, KS, "reduced", self.case.grid.scored)
        top, blind = int(values.argmax()), auto_k(self.volume, occupancy(self.case), "reduced")
        return Quality(
            float(values[top]), float(KS[top]), float(np.interp(blind, KS, values)), blind
        )

    def judge(self) -> Judged:
        """Compute Q, and count particles at the threshold with the best Q.

        This is the thesis's procedure. The volume is left thresholded.
        """
        quality, grid = self.quality(), self.case.grid
        peaks = detect(extract(self.volume, quality.best_k, "reduced"))
        return Judged(
            quality,
            count_thesis(peaks, self.truths, grid.in_scored(peaks), grid.in_scored(self.truths)),
        )


def map_shift_average(shot: Shot) -> Refocused:
    """Refocus by the thesis's algorithm of chapter 2, in its own voxels."""
    return Refocused.from_shot(shot, *published_volume(shot))


def additive(shot: Shot) -> Refocused:
    """Refocus additively by equation 3.3 with exact projections.

    Every voxel of the scene's grid is the mean of all cameras.
    """
    case = shot.observation
    volume = refocus_sum(case.normalised_images(), case.cameras, case.grid)
    volume /= np.float32(len(case.cameras))
    return Refocused.from_shot(shot, case.grid, shot.particles, volume)


METHODS: Mapping[str, Callable[[Shot], Refocused]] = {
    "map-shift-average": map_shift_average,
    "additive": additive,
}


_judged: dict[tuple[str, int], Mapping[str, Judged]] = {}


def judge_methods(scene: Scene, seed: int) -> Mapping[str, Judged]:
    """Refocus one frame by each method; cached, because several tables use it."""
    key = scene.hash, seed
    if key not in _judged:
        shot = simulate_frame(scene, seed)
        _judged[key] = {name: method(shot).judge() for name, method in METHODS.items()}
    return _judged[key]


def measure_quality(scene: Scene, seed: int) -> dict[str, Quality]:
    """Compute Q of one frame by each method."""
    return {name: frame.quality for name, frame in judge_methods(scene, seed).items()}


def count_methods(scene: Scene, seed: int) -> dict[str, Counts]:
    """Count true and ghost particles of one frame by each method."""
    return {name: frame.counts for name, frame in judge_methods(scene, seed).items()}


def detection_rows(name: str, found: Sequence[Counts], note: str = "") -> list[Row]:
    """Make rows of true particles and ghosts of several seeds.

    The thesis shows such figures as curves without numbers.
    """
    true = make_row(f"{name}: true %", None, [counts.true_percent for counts in found], note)
    ghosts = [counts.ghost_percent for counts in found]
    return [
        true,
        make_row(f"{name}: ghost %", None, [value for value in ghosts if value is not None], note),
    ]


_LOOKUPS = 2001  # depths between which the number of shifts is interpolated


def published_volume(shot: Shot) -> tuple[Grid, Particles, F32]:
    """Average shifted images of a shot: volume (z, y, x), voxels, particles.

    Particles are in the space of these voxels.

    Equations 2.1 to 2.3. Cameras with fractional shifts, as in unevenly spaced arrays, are
    interpolated bilinearly, as in the thesis. Mapped images are as large as the images, so that a
    shifted one adds zeros to one side of a plane (section 2.2.4): what a tilted camera sees beyond
    is lost.
    """
    case, cameras = shot.observation, shot.observation.cameras
    grid, (center, neighbour) = case.grid, _two_innermost(cameras)
    depths, shift = _shift_of_depth(center, neighbour, grid)
    numbers = np.arange(np.ceil(shift.min()), np.floor(shift.max()) + 1)
    planes = np.column_stack([np.zeros((len(numbers), 2)), np.interp(numbers, shift, depths)])
    low = (grid.low_mm[0], grid.low_mm[1], float(numbers[0]) * grid.voxel_mm[2])
    space = Grid(low, grid.voxel_mm, (len(numbers), *grid.shape[1:]), grid.crop)
    slab = _as_large_as_images(make_slab(cameras, grid, 0, grid.shape[0]), center, grid)
    mapped = np.empty((len(cameras), *slab.shape), dtype=np.float32)
    resample(
        coefficients_of(case.normalised_images(), LINEAR),
        LINEAR,
        *rectifying_maps(slab, cameras, grid),
        0.0,
        mapped,
    )
    across = np.asarray(grid.voxel_mm)[:2]
    shifts = np.stack(
        [
            (_on_middle(camera, planes, grid) - _on_middle(center, planes, grid)) / across
            for camera in cameras
        ],
        axis=1,
    )
    volume = np.empty(space.shape, dtype=np.float32)
    maps = shift_maps(space, shifts.round(6) - slab.corners)
    on_cores(cpu_kernels.sum_planes, len(maps), mapped, LINEAR, maps, 0.0, volume)
    volume /= np.float32(len(cameras))
    position = shot.particles.position_mm
    carried = np.column_stack(
        [
            _on_middle(center, position, grid),
            np.interp(position[:, 2], depths, shift) * grid.voxel_mm[2],
        ]
    )
    return space, replace(shot.particles, position_mm=carried), volume


def _as_large_as_images(slab: Slab, camera: CameraModel, grid: Grid) -> Slab:
    size = np.array([camera.columns, camera.rows])
    corner = (np.asarray(grid.shape[:0:-1]) - size) / 2.0
    return replace(
        slab, corners=np.tile(corner, (len(slab.corners), 1)), shape=(camera.rows, camera.columns)
    )


def _two_innermost(cameras: Sequence[CameraModel]) -> tuple[CameraModel, CameraModel]:
    """Find the camera nearest to the array's centre, and its neighbour."""
    positions = np.array([camera.center_mm for camera in cameras])
    center = int(np.linalg.norm(positions - positions.mean(axis=0), axis=1).argmin())
    order = np.argsort(np.linalg.norm(positions - positions[center], axis=1), kind="stable")
    return cameras[center], cameras[int(order[1])]


def _shift_of_depth(center: CameraModel, neighbour: CameraModel, grid: Grid) -> tuple[F64, F64]:
    """Compute the disparity of two cameras over the grid's depths, in voxels.

    It is that of a point on the axis at each depth, on the middle plane. Returns depths and
    disparities.
    """
    x, y, z = grid.axes_mm
    depths = np.linspace(z[0] - grid.voxel_mm[2] / 2.0, z[-1] + grid.voxel_mm[2] / 2.0, _LOOKUPS)
    axis = np.column_stack([np.full(_LOOKUPS, x.mean()), np.full(_LOOKUPS, y.mean()), depths])
    apart = (_on_middle(neighbour, axis, grid) - _on_middle(center, axis, grid)) / np.asarray(
        grid.voxel_mm
    )[:2]
    along = apart[-1] - apart[0]
    return depths, np.asarray(apart @ (along / np.linalg.norm(along)))


def _on_middle(camera: CameraModel, points: F64, grid: Grid) -> F64:
    """Intersect lines of sight through points (n, 3) with the grid's middle plane.

    Returns x, y in mm (n, 2).
    """
    z = grid.axes_mm[2]
    return camera.carry(points, (z[0] + z[-1]) / 2.0)


_ALL = (slice(None), slice(None), slice(None))
_KS = np.linspace(0.0, 40.0, 801)
_FLAT = 1e-30


def quality_of_k(
    volume: F32,
    synthesised: F32,
    ks: F64,
    keep: Literal["reduced", "whole"],
    scored: tuple[slice, slice, slice] = _ALL,
) -> F64:
    """Compute Q (K,) of `extract(volume, k, keep)` for ascending thresholds (K,).

    It takes one pass and does not change the volume.

    Parameters
    ----------
    volume, synthesised : (z, y, x) refocused planes as they are, and E_s.
    scored : the part of the volume that Q sums over; mean and standard deviation are those of whole
        planes.

    What lies between two thresholds enters both sums of equation 2.13 through its number, sum and
    sum of squares: with t the threshold, sum (E - t)^2 = sum E^2 - 2 t sum E + n t^2, and so on.
    """
    means, spreads = plane_statistics(volume[scored[0]])
    thresholds = (means[:, None] + spreads[:, None] * ks).astype(
        np.float32
    )  # single precision, as in `extract`
    sums = np.zeros((len(means), len(ks) + 1, 6))
    on_cores(_sum_between, len(sums), volume[scored], synthesised[scored], thresholds, sums)
    count, light, square, truth, product, _ = np.moveaxis(
        np.cumsum(sums[:, :0:-1], axis=1)[:, ::-1], 2, 0
    )
    if keep == "reduced":
        t = thresholds.astype(np.float64)
        product, square = product - t * truth, square - 2.0 * t * light + t**2 * count
    norm = np.sqrt(np.maximum(square.sum(axis=0), 0.0) * sums[:, :, 5].sum())
    return np.asarray(np.divide(product.sum(axis=0), norm, out=np.zeros(len(ks)), where=norm > 0.0))


def best_k(
    volume: F32,
    synthesised: F32,
    keep: Literal["reduced", "whole"],
    scored: tuple[slice, slice, slice] = _ALL,
) -> tuple[float, float]:
    """Find the threshold k, to 0.05, with the highest Q, and that Q.

    The thesis selects it so in its simulations, with the truth. Arguments as for `quality_of_k`.
    """
    q = quality_of_k(volume, synthesised, _KS, keep, scored)
    return float(_KS[q.argmax()]), float(q.max())


@numba.njit(cache=True, nogil=True)
def _sum_between(jobs: slice, volume: Any, synthesised: Any, thresholds: Any, sums: Any) -> None:
    """Sum over the voxels above exactly i thresholds of their plane.

    sums[plane, i] is their number, and the sums of E, E^2, E_s, E E_s and E_s^2 over them.

    Of voxels above none, which are most, only the last sum is taken: nothing else of theirs enters
    Q.
    """
    for plane in range(jobs.start, jobs.stop):
        lowest, last = thresholds[plane, 0], thresholds.shape[1]
        scale = (last - 1) / max(thresholds[plane, last - 1] - lowest, _FLAT)
        for row in range(volume.shape[1]):
            rest = 0.0
            for column in range(volume.shape[2]):
                value = volume[plane, row, column]
                truth = np.float64(synthesised[plane, row, column])
                if value <= lowest:
                    rest += truth * truth
                    continue
                above = min(
                    int((value - lowest) * scale), last
                )  # right or nearly, if thresholds are evenly spaced
                while above < last and thresholds[plane, above] < value:
                    above += 1
                while thresholds[plane, above - 1] >= value:
                    above -= 1
                total = sums[plane, above]
                total[0] += 1.0
                total[1] += value
                total[2] += np.float64(value) * value
                total[3] += truth
                total[4] += value * truth
                total[5] += truth * truth
            sums[plane, 0, 5] += rest
