"""Voxel grids, and the intensity field that a perfect reconstruction would show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from sabench.arrays import F32, F64, I64, Bool

_REACH = 4.0  # standard deviations after which a particle's field is cut: 3e-4 of its peak


@dataclass(frozen=True)
class Grid:
    """A box of voxels along the world's axes; volumes on it are (z, y, x), float32.

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

    @property
    def axes_mm(self) -> tuple[F64, F64, F64]:
        """Voxel centres along x, y and z."""
        counts = self.shape[::-1]
        x, y, z = (np.asarray(low + step * np.arange(n), np.float64) for low, step, n in zip(self.low_mm, self.voxel_mm, counts, strict=True))
        return x, y, z

    def to_voxels(self, points_mm: F64) -> F64:
        """World points (n, 3) as fractional voxel indices (x, y, z)."""
        return np.asarray((points_mm - np.asarray(self.low_mm)) / np.asarray(self.voxel_mm))

    @property
    def scored(self) -> tuple[slice, slice, slice]:
        """The part of a volume (z, y, x) that scores see."""
        z, y, x = (slice(cut, n - cut) for cut, n in zip(self.crop[::-1], self.shape, strict=True))
        return z, y, x

    def in_scored(self, voxels: F64) -> Bool:
        """Whether fractional voxel indices (n, 3) lie in the scored part, each voxel being a cell around its centre."""
        low = np.asarray(self.crop) - 0.5
        high = np.asarray(self.shape[::-1]) - np.asarray(self.crop) - 0.5
        return np.asarray(((voxels >= low) & (voxels < high)).all(axis=1))


def synthesise(grid: Grid, positions_mm: F64, weights: F64, sigma_mm: float) -> F32:
    """The field E_s: a spherical Gaussian in physical space for every particle, added up and averaged over each voxel; (z, y, x).

    Parameters
    ----------
    positions_mm : (n, 3).
    weights : (n,) peak value of each Gaussian.
    sigma_mm : its standard deviation, in mm along all axes.

    Source: thesis section 2.2.3, the field that equation 2.13 compares with. The average over the voxel, as a pixel averages an image, keeps
    the field's integral where a voxel is longer than the particle: values at voxel centres would miss particles between two planes.
    """
    voxels = grid.to_voxels(positions_mm)
    nearest = np.rint(voxels).astype(np.int64)
    sigma = sigma_mm / np.asarray(grid.voxel_mm)
    reach = np.ceil(_REACH * sigma + 0.5).astype(int)
    factors = [_profile(voxels[:, i], nearest[:, i], int(reach[i]), float(sigma[i])) for i in range(3)]
    padded = np.zeros(tuple(n + 2 * int(r) for n, r in zip(grid.shape, reach[::-1], strict=True)), dtype=np.float32)
    keep = ((nearest >= -reach) & (nearest < np.asarray(grid.shape[::-1]) + reach)).all(axis=1)
    weight = weights.astype(np.float32)
    for a in range(-reach[2], reach[2] + 1):
        for b in range(-reach[1], reach[1] + 1):
            row = weight * factors[2][a + reach[2]] * factors[1][b + reach[1]]
            _add_row(padded, nearest, keep, (a, b), row, factors[0], reach)
    z, y, x = (slice(int(r), int(r) + n) for n, r in zip(grid.shape, reach[::-1], strict=True))
    return np.ascontiguousarray(padded[z, y, x])


def _profile(voxels: F64, nearest: I64, reach: int, sigma: float) -> F32:
    """Mean of a Gaussian of peak 1 along one axis over the voxels -reach..reach from the nearest: (2 reach + 1, n)."""
    edges = np.arange(-reach, reach + 2)[:, None] - 0.5 + (nearest - voxels)[None]
    mean = sigma * np.sqrt(np.pi / 2.0) * np.diff(erf(edges / (sigma * np.sqrt(2.0))), axis=0)
    return np.asarray(mean, dtype=np.float32)


def _add_row(padded: F32, nearest: I64, keep: Bool, offset: tuple[int, int], row: F32, profile: F32, reach: I64) -> None:
    """Add every particle's row of voxels at one (z, y) offset; voxels outside the padded volume are dropped."""
    z = nearest[:, 2] + offset[0] + reach[2]
    y = nearest[:, 1] + offset[1] + reach[1]
    for c in range(-reach[0], reach[0] + 1):
        x = nearest[:, 0] + c + reach[0]
        inside = keep & (z >= 0) & (z < padded.shape[0]) & (y >= 0) & (y < padded.shape[1]) & (x >= 0) & (x < padded.shape[2])
        np.add.at(padded, (z[inside], y[inside], x[inside]), (row * profile[c + reach[0]])[inside])
