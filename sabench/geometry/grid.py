"""Voxel grids, a perfect reconstruction's field, vector calculus on lattices.

The field is that of the intensity.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from sabench.images.gaussians import gaussian_shares
from sabench.utils import memory
from sabench.utils.arrays import F32, F64, I64, Bool
from sabench.utils.errors import InputError

AT_ONCE = 1 << 22  # numbers in memory at a time: bounds memory, not results
REACH = 4.0  # standard deviations after which a Gaussian is cut: 3e-4 of its peak


@dataclass(frozen=True)
class Grid:
    """Box of voxels along the world's axes; volumes on it are (z, y, x), float32.

    Attributes
    ----------
    low_mm : centre of voxel (0, 0, 0), as (x, y, z).
    voxel_mm : spacing (x, y, z).
    shape : number of voxels (z, y, x).
    crop : voxels (x, y, z) at either side that scores leave out.
    """

    low_mm: tuple[float, float, float]
    voxel_mm: tuple[float, float, float]
    shape: tuple[int, int, int]
    crop: tuple[int, int, int] = (0, 0, 0)

    def __str__(self) -> str:
        edges = " x ".join(f"{edge:.4g}" for edge in self.voxel_mm)
        return f"{' x '.join(map(str, self.shape[::-1]))} voxels of {edges} mm"

    @property
    def axes_mm(self) -> tuple[F64, F64, F64]:
        """Voxel centres along x, y and z."""
        counts = self.shape[::-1]
        x, y, z = (
            np.asarray(low + step * np.arange(n), np.float64)
            for low, step, n in zip(self.low_mm, self.voxel_mm, counts, strict=True)
        )
        return x, y, z

    @property
    def box_mm(self) -> tuple[F64, F64]:
        """Corners (3,) of the box of all voxels: smallest and largest coordinates."""
        low, voxel = np.asarray(self.low_mm), np.asarray(self.voxel_mm)
        return low - voxel / 2.0, low + voxel * (np.asarray(self.shape[::-1]) - 0.5)

    def centers_mm(self, margin: float = 0.0) -> tuple[F64, F64]:
        """Corners (3,) of the box of voxels' centres, widened by so many voxels."""
        low, voxel = np.asarray(self.low_mm), np.asarray(self.voxel_mm)
        high = low + voxel * (np.asarray(self.shape[::-1]) - 1)
        return low - margin * voxel, high + margin * voxel

    @property
    def scored_box_mm(self) -> tuple[F64, F64]:
        """Corners (3,) of the box that scores see."""
        (low, high), cut = self.box_mm, np.asarray(self.crop) * np.asarray(self.voxel_mm)
        return low + cut, high - cut

    def to_voxels(self, points_mm: F64) -> F64:
        """Convert world points (n, 3) to fractional voxel indices (x, y, z)."""
        return np.asarray((points_mm - np.asarray(self.low_mm)) / np.asarray(self.voxel_mm))

    @property
    def scored(self) -> tuple[slice, slice, slice]:
        """The part of a volume (z, y, x) that scores see."""
        z, y, x = (slice(cut, n - cut) for cut, n in zip(self.crop[::-1], self.shape, strict=True))
        return z, y, x

    def in_scored(self, voxels: F64) -> Bool:
        """Mark fractional voxel indices (n, 3) in the scored part.

        Each voxel is a cell around its centre.
        """
        low = np.asarray(self.crop) - 0.5
        high = np.asarray(self.shape[::-1]) - np.asarray(self.crop) - 0.5
        return np.asarray(((voxels >= low) & (voxels < high)).all(axis=1))


def check_volume(grid: Grid) -> None:
    """Raise an InputError if a volume of the grid does not fit into memory."""
    free, need = memory.available_mb(), math.prod(grid.shape) * 4 / 1e6
    if free is not None and need > free:
        voxels = " x ".join(map(str, grid.shape))
        raise InputError(
            f"grid: expected it to fit into memory, but its {voxels} voxels "
            f"(z, y, x) need {need:.0f} MB where {free:.0f} MB are there"
        )


def synthesise(grid: Grid, positions_mm: F64, weights: F64, sigma_mm: float) -> F32:
    """Synthesise the field E_s.

    It is the sum of a spherical Gaussian in physical space for every particle, averaged over each
    voxel; (z, y, x).

    Parameters
    ----------
    positions_mm : (n, 3).
    weights : (n,) peak value of each Gaussian.
    sigma_mm : its standard deviation, in mm along all axes.

    Source: thesis section 2.2.3, the field that equation 2.13 compares with. The average over the
    voxel, as a pixel averages an image, keeps the field's integral where a voxel is longer than the
    particle: values at voxel centres would miss particles between two planes.
    """
    voxels = grid.to_voxels(positions_mm)
    sigma = sigma_mm / np.asarray(grid.voxel_mm)
    radius = np.ceil(REACH * sigma + 0.5).astype(np.int64)
    size = np.asarray(grid.shape[::-1])
    near = ((voxels >= -1.0 - radius) & (voxels <= size + radius)).all(axis=1) & (weights != 0.0)
    nearest = np.rint(voxels[near]).astype(np.int64)
    offset = nearest - voxels[near]
    # images at a wrong camera may be of any width: a window wider than the field is the field
    whole = 2 * radius + 1 > size
    count = np.where(whole, size, 2 * radius + 1)
    first, light = np.where(whole, 0, nearest - radius), weights[near].astype(np.float32)
    begin = first - nearest
    field: F32 = np.zeros(grid.shape, dtype=np.float32)
    at_once = max(1, AT_ONCE // int(count.prod()))
    for row in range(0, len(first), at_once):
        some = slice(row, row + at_once)
        x, y, z = (
            _profile(
                offset[some, i], begin[some, i], int(count[i]), int(radius[i]), float(sigma[i])
            )
            for i in range(3)
        )
        _add_particles(field, first[some], light[some, None] * z, y, x)
    return field


def _add_particles(field: F32, first: I64, along_z: F32, along_y: F32, along_x: F32) -> None:
    """Add products of profiles (n, k) to the field (z, y, x), particle by particle.

    They begin at the voxels `first` (x, y, z); parts outside the field are dropped.
    """
    indices, profiles = [], (along_z, along_y, along_x)
    for profile, begin, size in zip(profiles, first.T[::-1], field.shape, strict=True):
        index = begin[:, None] + np.arange(profile.shape[1])
        profile *= (index >= 0) & (index < size)
        indices.append(np.clip(index, 0, size - 1))
    z, y, x = indices
    rows = z[:, :, None] * field.shape[1] + y[:, None]
    voxels = rows[..., None] * field.shape[2] + x[:, None, None]
    light = (along_z[:, :, None] * along_y[:, None])[..., None] * along_x[:, None, None]
    np.add.at(field.reshape(-1), voxels.reshape(-1), light.reshape(-1))


def _profile(offset: F64, begin: I64, count: int, radius: int, sigma: float) -> F32:
    """Compute means of Gaussians of peak 1 over voxels; 0 beyond the radius.

    Returns (n, count), along one axis.

    Parameters
    ----------
    offset : (n,) of the nearest voxel from the Gaussian's centre.
    begin : (n,) the first voxel, counted from the nearest.
    """
    edges = begin[:, None] + np.arange(count + 1) - 0.5 + offset[:, None]
    mean = sigma * np.sqrt(2.0 * np.pi) * gaussian_shares(edges, sigma)
    mean[np.abs(begin[:, None] + np.arange(count)) > radius] = 0.0
    return np.asarray(mean, dtype=np.float32)


def cut_box(low_mm: F64, high_mm: F64, point_mm: F64, normal: F64) -> F64:
    """Cut the edges of a box along the world's axes with a plane.

    Parameters
    ----------
    low_mm, high_mm : (3,) corners of the box with the smallest and largest coordinates.
    point_mm, normal : (3,) a point of the plane, and its unit normal.

    Returns corners (n, 3) of the part of the plane in the box, in no order, some of them repeatedly
    where the plane passes through corners of the box; none where it misses the box.
    """
    corners = np.array(list(itertools.product(*zip(low_mm, high_mm, strict=True))))
    away = (corners - point_mm) @ normal
    cuts = []
    for first, second in itertools.combinations(range(8), 2):
        if (first ^ second).bit_count() == 1 and away[first] * away[second] <= 0.0:
            length = away[first] - away[second]
            share = away[first] / length if length else 0.0
            cuts.append(corners[first] + share * (corners[second] - corners[first]))
    return np.array(cuts).reshape(-1, 3)


def gradient(velocity: F64, step_mm: tuple[float, float, float]) -> F64:
    """Compute gradients du_i / dx_j of a field on a lattice by central differences.

    Parameters
    ----------
    velocity : (z, y, x, 3).
    step_mm : spacing of the nodes along x, y, z.

    Returns (z, y, x, 3, 3), one-sided differences at the lattice's ends, NaN along axes of a single
    node.
    """
    parts: list[F64] = []
    for axis in range(3):
        along = 2 - axis  # x varies along the last of the first three
        if velocity.shape[along] < 2:
            parts.append(np.full(velocity.shape, np.nan))
        else:
            parts.append(np.asarray(np.gradient(velocity, step_mm[axis], axis=along)))
    return np.stack(parts, axis=-1)


def inner(shape: tuple[int, int, int]) -> Bool:
    """Mark nodes (z, y, x) with central differences along all axes of several nodes."""
    out = np.zeros(shape, dtype=np.bool_)
    out[tuple(slice(1, -1) if count > 1 else slice(None) for count in shape)] = True
    return out


def vorticity(gradient: F64) -> F64:
    """Compute the curl (..., 3) of a field with gradients (..., 3, 3), du_i / dx_j."""
    parts = [gradient[..., i, j] - gradient[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))]
    return np.stack(parts, axis=-1)


def divergence(gradient: F64) -> F64:
    """Compute the divergence (...) of a field with gradients (..., 3, 3)."""
    return np.asarray(np.trace(gradient, axis1=-2, axis2=-1))
