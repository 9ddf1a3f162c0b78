"""Projection operator W from a sparse volume to its images.

The footprint is the spread of one voxel's light over the pixels around its projection.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter

from sabench.algorithms.tomography.kernels import KernelGeometry, back_project, project_volume
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.geometry.plane_polynomials import plane_maps
from sabench.utils.arrays import F32, I64
from sabench.utils.threads import on_cores

_BRIGHT = 0.3  # of a bright particle's peak: dimmer local maxima are not measured


@dataclass(frozen=True)
class Footprint:
    """Weights W_ij of a voxel: bilinear in the four pixels around its projection.

    Then, along either axis, pixels give `spread` to both neighbours.

    The weights of a voxel add up to 1. Voxels should be about as large as pixels: those of a coarse
    grid would leave pixels between them dark.

    Attributes
    ----------
    spread : 0 for bilinear weights, at most 1/3.
    """

    spread: float

    @property
    def margin(self) -> int:
        """Pixels that it reaches beyond the four."""
        return 1 if self.spread else 0

    def smooth(self, images: F32) -> F32:
        """Spread light of images (camera, row, column), dark outside, symmetrically."""
        if not self.spread:
            return images
        kernel = np.array([self.spread, 1.0 - 2.0 * self.spread, self.spread])
        filters = -1, kernel, kernel
        border = cv2.BORDER_CONSTANT
        return np.stack([cv2.sepFilter2D(image, *filters, borderType=border) for image in images])


BILINEAR = Footprint(0.0)


def gaussian(sigma_px: float) -> Footprint:
    """Make the footprint of a Gaussian's variance: sigma^2 + 1/12 = 2 spread + 1/6."""
    return Footprint((sigma_px**2 - 1.0 / 12.0) / 2.0)


def image_sigma_px(images: F32) -> float | None:
    """Estimate the standard deviation of the particles' images, pixel included.

    The images (camera, row, column) are scaled by `normalise`. Returns None without any particle.
    A Gaussian through three pixels of a local maximum has sigma^2 = 1 / (2 ln m - ln l - ln r).
    Particles that overlap look larger and none looks smaller, so the lower quartile is returned.
    """
    sigmas = []
    for image in images:
        peak = (image == maximum_filter(image, 5)) & (image > _BRIGHT)
        peak[[0, -1]] = peak[:, [0, -1]] = False
        row, column = np.nonzero(peak)
        for down, right in ((0, 1), (1, 0)):  # along rows and columns
            light = np.stack([image[row + k * down, column + k * right] for k in (-1, 0, 1)])
            before, middle, after = np.log(np.maximum(light.astype(np.float64), 1e-6))
            curvature = 2.0 * middle - before - after
            sigmas.append(1.0 / np.sqrt(curvature[curvature > 0.0]))
    widths = np.concatenate(sigmas)
    return float(np.percentile(widths, 25.0)) if len(widths) else None


# voxels with values that stay in the cache while one camera after the other is looked up
_BLOCK = 1 << 16
# images that are added up by themselves; a fixed number, so that sums do not depend on how many
# threads there are
TASKS = 32


@dataclass(frozen=True)
class Support:
    """Existing voxels of a grid.

    They are listed row by row over (z, y), with x indices in increasing order. Voxels' values are
    (n,) arrays in this order.

    Attributes
    ----------
    shape : of the grid (z, y, x).
    start : (z * y + 1,) where each row begins.
    x : (n,) int16, or int32 on wide grids.
    """

    shape: tuple[int, int, int]
    start: I64
    x: npt.NDArray[np.signedinteger]

    def __len__(self) -> int:
        """Count the voxels."""
        return len(self.x)

    def sample(self, volume: F32) -> F32:
        """Read the voxels' values (n,) from a volume (z, y, x) of the whole grid."""
        rows = np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))
        return np.asarray(volume.reshape(-1, self.shape[2])[rows, self.x])

    def parts(self, count: int) -> I64:
        """Cut the voxels into parts of about the same size: rows (count + 1,)."""
        cuts = np.searchsorted(self.start, np.linspace(0, len(self.x), count + 1))
        cuts[[0, -1]] = 0, len(self.start) - 1
        return np.asarray(cuts, dtype=np.int64)


def make_geometry(cameras: Sequence[CameraModel], grid: Grid, margin: int) -> KernelGeometry:
    """Convert cameras and grid for the kernels.

    The images of all cameras are of one size.

    Raises
    ------
    ValueError
        Some of the grid has no light path to a camera.
    """
    planes = plane_maps(cameras, grid)
    maps = np.stack([[view.coefficients for view in maps] for maps in zip(*planes, strict=True)])
    image = cameras[0].rows, cameras[0].columns
    return KernelGeometry(maps, planes[0][0].degree, *grid.shape[1:], *image, margin)


@dataclass(frozen=True)
class ProjectionOperator:
    """Projection P_i = sum_j W_ij I_j over the voxels of a support, and its adjoint.

    The adjoint is exact. Source: thesis, equation 3.8.

    W is not stored: projections come from polynomials. A camera that does not see all of a voxel's
    footprint is left out for that voxel.

    Attributes
    ----------
    geometry : its margin is the footprint's.
    """

    geometry: KernelGeometry
    support: Support
    footprint: Footprint

    @property
    def cameras(self) -> range:
        """Their numbers."""
        return range(len(self.geometry.maps))

    def forward(self, values: F32, cameras: Sequence[int] | None = None) -> F32:
        """Project voxels (n,) to images (camera, row, column) of some cameras, or all."""
        chosen = self._numbers(cameras)
        parts = self.support.parts(max(1, TASKS // len(chosen)))
        size = self.geometry.rows, self.geometry.columns
        images = np.zeros((len(chosen), len(parts) - 1, math.prod(size)), dtype=np.float32)
        voxels = self.support.start, self.support.x, values
        jobs = len(chosen) * (len(parts) - 1)
        on_cores(project_volume, jobs, self.geometry, chosen, parts, *voxels, images)
        return self.footprint.smooth(images.sum(axis=1).reshape(-1, *size))

    def adjoint(self, images: F32, cameras: Sequence[int] | None = None) -> F32:
        """Compute sum_i W_ij images_i for every voxel (n,), over some cameras, or all."""
        flat = self.footprint.smooth(images).reshape(len(images), -1)
        chosen, support = self._numbers(cameras), self.support
        out = np.zeros(len(support), dtype=np.float32)
        parts = support.parts(len(out) // _BLOCK + 1)
        voxels = support.start, support.x
        on_cores(back_project, len(parts) - 1, self.geometry, chosen, parts, *voxels, flat, out)
        return out

    def _numbers(self, cameras: Sequence[int] | None) -> I64:
        return np.asarray(self.cameras if cameras is None else cameras, dtype=np.int64)
