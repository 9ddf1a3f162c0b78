"""Particles of one frame by defocusing digital PIV (DDPIV).

Three apertures at the corners of an equilateral triangle show every particle three times. On one
common image plane the three images are again the corners of an equilateral triangle, always in the
same orientation, and the closer the particle, the larger the triangle. Sources: Willert and Gharib,
Three-dimensional particle imaging with a single camera, Exp. Fluids 12, 353-358, 1992; Pereira and
Gharib, Defocusing digital particle image velocimetry and the three-dimensional characterization of
two-phase flows, Meas. Sci. Technol. 13, 683-694, 2002.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from sabench.algorithms.particles import matching
from sabench.api import Camera, FoundParticles, Observation
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import AT_ONCE, Grid
from sabench.images.dark_noise import FALSE_ALARMS
from sabench.images.peaks import Peaks
from sabench.utils.arrays import F64, I64

_PARALLEL_DEGREES = 1.0  # between an optical axis and the normal of the apertures' plane
_EQUAL = 0.02  # relative difference of the sides of an equilateral triangle


@dataclass(frozen=True)
class Apertures:
    """Triangle of apertures, and the common image plane behind it.

    Attributes
    ----------
    middle_mm : (3,) of the triangle, in the world.
    axes : (3, 3) rows: two axes in the plane of the apertures, and their normal towards the volume.
    corners_mm : (3, 2) apertures along the first two axes, from the middle.
    focal_px : distance of the common image plane from the apertures, in pixels.
    """

    middle_mm: F64
    axes: F64
    corners_mm: F64
    focal_px: float

    @classmethod
    def of(cls, cameras: Sequence[Camera]) -> Apertures:
        """Measure the triangle of three cameras' apertures, which are not in one line."""
        centers = np.array([camera.center_mm for camera in cameras])
        middle = centers.mean(axis=0)
        right = (centers[1] - centers[0]) / np.linalg.norm(centers[1] - centers[0])
        normal = np.cross(right, centers[2] - centers[0])
        normal *= np.sign(normal @ np.array([camera.rotation[2] for camera in cameras]).sum(axis=0))
        normal /= np.linalg.norm(normal)
        axes = np.stack([right, np.cross(normal, right), normal])
        focal = float(np.mean([camera.focal_px for camera in cameras]))
        return cls(middle, axes, (centers - middle) @ axes[:2].T, focal)

    @property
    def side_mm(self) -> float:
        """Mean side of the triangle."""
        return float(_sides(self.corners_mm).mean())

    def superimpose(self, camera: Camera, pixels: F64) -> F64:
        """Project pixels (n, 2) to the common image plane, origin along the normal."""
        ahead = camera.directions(pixels)[0] @ self.axes.T
        return np.asarray(ahead[:, :2] / ahead[:, 2:] * self.focal_px)

    def locate(self, images: F64) -> tuple[F64, F64]:
        """Locate particles (n, 3) by triangles (n, 3, 2) of images on the common plane.

        A particle at the depth L is seen at f (X - corner) / L: the triangle is the apertures'
        f / L times as large, upside down. Least squares over the three images give f / L and
        f X / L. Also returns the largest distance (n,) of an image from the triangle, px.
        """
        corners, center = self.corners_mm, images.mean(axis=1)
        from_center = images - center[:, None]
        scale = -np.einsum("nij,ij->n", from_center, corners) / np.square(corners).sum()
        off = np.linalg.norm(from_center + scale[:, None, None] * corners, axis=2).max(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = self.focal_px / scale
            local = np.column_stack([center / scale[:, None], depth])
        return local @ self.axes + self.middle_mm, off

    def sizes(self, grid: Grid) -> tuple[float, float]:
        """Compute the least and the largest side of triangles of particles in a grid, px."""
        depths = (_corners(grid) - self.middle_mm) @ self.axes[2]
        product = self.focal_px * self.side_mm
        return product / float(depths.max()), product / float(depths.min())


def find_unsuitable(cameras: Sequence[CameraModel], grid: Grid) -> str | None:
    """Say why cameras are no triangle of parallel pinholes; None if they are."""
    needs = "it needs three cameras at the corners of an equilateral triangle, with axes at right"
    needs += " angles to it and no wall"
    if len(cameras) != 3:
        return f"{needs}, got {len(cameras)} cameras"
    pinholes = [camera for camera in cameras if isinstance(camera, Camera) and camera.wall is None]
    if len(pinholes) != 3:
        other = next(camera for camera in cameras if camera not in pinholes)
        walled = isinstance(other, Camera)
        return f"{needs}, got {other.name} {'behind a wall' if walled else 'of another model'}"
    least, middle, most = sorted(_sides(np.array([camera.center_mm for camera in pinholes])))
    if most - least > _EQUAL * most:
        return f"{needs}, got sides of {least:.4g}, {middle:.4g} and {most:.4g} mm"
    apertures = Apertures.of(pinholes)
    for camera in pinholes:
        angle = np.rad2deg(np.arccos(np.clip(camera.rotation[2] @ apertures.axes[2], -1.0, 1.0)))
        if angle > _PARALLEL_DEGREES:
            return f"{needs}, got {camera.name} at {angle:.1f} degrees"
    if ((_corners(grid) - apertures.middle_mm) @ apertures.axes[2]).min() <= 0.0:
        return "it needs a grid in front of the cameras, got some of it beside or behind them"
    return None


def find_by_defocusing(
    case: Observation,
    *,
    floor: float = 0.05,
    false_alarms: float = FALSE_ALARMS,
    reach_px: float = 0.8,
) -> FoundParticles:
    """Find particles with three images that form a triangle; each image is used once.

    Parameters
    ----------
    case : of cameras that `find_unsuitable` accepts.
    floor, false_alarms : as in `PeakParameters`.
    reach_px : largest distance of an image from the corner of the triangle that fits best.
    """
    cameras = [camera for camera in case.cameras if isinstance(camera, Camera)]
    apertures = Apertures.of(cameras)
    peaks = matching.detect_in_cameras(case, floor, false_alarms)
    every = match_triangles(apertures, cameras, peaks, case.grid, reach_px)
    best = matching.select_rows(every, matching.select_best(every, peaks))
    light = matching.heights_of(best.hit, peaks, case.normalised_images()).mean(axis=1)
    return FoundParticles(best.position, light)


def match_triangles(
    apertures: Apertures,
    cameras: Sequence[Camera],
    peaks: tuple[Peaks, ...],
    grid: Grid,
    reach_px: float,
) -> matching.PeakSets:
    """Match peaks of three cameras that form triangles of particles in a grid.

    The side from the first camera's image to the second's has a known direction, and a length
    between those of the nearest and the farthest particles. Turned by 60 degrees it leads to the
    third image: the sides of a triangle are equal displacements, 120 degrees apart.

    Returns positions in mm.
    """
    views = zip(cameras, peaks, strict=True)
    images = [apertures.superimpose(camera, camera_peaks.pixels) for camera, camera_peaks in views]
    sets = [matching.PeakSets(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64), np.empty(0))]
    if all(map(len, images)):
        for hit in _triples(apertures, images, apertures.sizes(grid), reach_px):
            triangles = [image[numbers] for image, numbers in zip(images, hit.T, strict=True)]
            position, off = apertures.locate(np.stack(triangles, axis=1))
            voxels = grid.to_voxels(position)
            last = np.asarray(grid.shape[::-1]) - 1.0
            inside = ((voxels >= -matching.MARGIN) & (voxels <= last + matching.MARGIN)).all(axis=1)
            good = inside & (off <= reach_px)
            sets.append(matching.PeakSets(position[good], hit[good], off[good]))
    return matching.join_sets(sets)


def _triples(
    apertures: Apertures, images: list[F64], sizes: tuple[float, float], reach_px: float
) -> Iterator[I64]:
    """Yield numbers (n, 3) of images that are nearly corners of a triangle."""
    first, second, third = images
    tree, near = cKDTree(third), matching.SEARCHED * reach_px
    to_third = (apertures.corners_mm[2] - apertures.corners_mm[0]) / apertures.side_mm
    # sides between the first two images run along the first axis
    order = np.argsort(second[:, 1], kind="stable")
    down = second[order, 1]
    at_once = max(1, AT_ONCE // max(len(second), 1))
    for start in range(0, len(first), at_once):
        batch = first[start : start + at_once]
        low = np.searchsorted(down, batch[:, 1] - 2.0 * reach_px)
        high = np.searchsorted(down, batch[:, 1] + 2.0 * reach_px)
        member = np.repeat(np.arange(len(batch)), high - low)
        rows = np.arange(len(member)) - np.repeat(np.cumsum(high - low) - (high - low), high - low)
        other = order[rows + low[member]]
        side = batch[member, 0] - second[other, 0]
        fits = (side >= sizes[0] - 2.0 * reach_px) & (side <= sizes[1] + 2.0 * reach_px)
        member, other, side = member[fits], other[fits], side[fits]
        middle = (batch[member, 1] + second[other, 1]) / 2.0
        corner = np.column_stack([batch[member, 0], middle]) - side[:, None] * to_third
        last = tree.query_ball_point(corner, near)
        pair = np.repeat(np.arange(len(last)), [len(each) for each in last])
        thirds = np.fromiter(itertools.chain.from_iterable(last), dtype=np.int64)
        yield np.column_stack([member[pair] + start, other[pair], thirds])


def _sides(corners: F64) -> F64:
    return np.array([np.linalg.norm(a - b) for a, b in itertools.combinations(corners, 2)])


def _corners(grid: Grid) -> F64:
    """List the corners (8, 3) of a grid with its margin, mm."""
    return np.array(list(itertools.product(*np.transpose(grid.centers_mm(matching.MARGIN)))))
