"""Prepared cases of the tomographic solvers, their parameters, and first guesses.

A first guess finds the voxels that can hold light, and their light.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from sabench.algorithms.tomography import projection_operator as operators, supersampling
from sabench.algorithms.tomography.art_updates import Iterate, RecordedLight
from sabench.algorithms.tomography.kernels import KernelGeometry, locate, sample_image, scratch
from sabench.api import Observation, Parameters
from sabench.geometry.grid import AT_ONCE, Grid
from sabench.utils.arrays import F32, I64
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.progress import progress_bar
from sabench.utils.threads import on_cores

# of voxels: one camera after the other is looked up, and its part of the image stays in the
# cache
_ROWS = 32


def product_guess(
    geometry: KernelGeometry, images: F32, threshold: float
) -> tuple[operators.Support, F32]:
    """Find the voxels where every camera that sees them has light, and their product.

    The product is raised to one over the number of these cameras. Voxels that no camera sees are
    left out. Sources: Atkinson and Soria (2009) for MLOS, Worth and Nickels (2008) for MFG; thesis
    section 3.2.

    Parameters
    ----------
    geometry : its interpolation samples the images: linear gives MLOS, the nearest pixel MFG.
    images : (camera, row, column).
    threshold : darker pixels are black.
    """
    planes, shape = geometry.maps.shape[1], (geometry.height, geometry.width)
    step = max(1, AT_ONCE // (shape[0] * shape[1]))
    flat = images.reshape(len(images), -1)
    slabs = [
        _slab(geometry, flat, threshold, first, min(step, planes - first))
        for first in progress_bar(range(0, planes, step), "first guess")
    ]
    counts, x, values = (np.concatenate(part) for part in zip(*slabs, strict=True))
    return operators.Support((planes, *shape), np.concatenate([[0], np.cumsum(counts)]), x), values


def every_voxel(geometry: KernelGeometry) -> tuple[operators.Support, F32]:
    """Return all voxels, all equally bright."""
    shape = geometry.maps.shape[1], geometry.height, geometry.width
    rows = shape[0] * shape[1]
    x = np.tile(np.arange(shape[2], dtype=_index_type(shape[2])), rows)
    support = operators.Support(shape, np.arange(rows + 1) * shape[2], x)
    return support, np.ones(len(x), dtype=np.float32)


def _index_type(width: int) -> type[np.signedinteger]:
    return np.int16 if width < 1 << 15 else np.int32


def _slab(
    geometry: KernelGeometry, images: F32, threshold: float, first: int, planes: int
) -> tuple[I64, npt.NDArray[np.signedinteger], F32]:
    """List the voxels of some planes: their number in each row, x indices and values."""
    rows = planes * geometry.height
    x = np.empty((rows, geometry.width), dtype=_index_type(geometry.width))
    values = np.empty(x.shape, dtype=np.float32)
    counts = np.empty(rows, dtype=np.int64)
    limits = threshold, first * geometry.height
    on_cores(_multiply_rows, -(-rows // _ROWS), geometry, images, *limits, x, values, counts)
    start = np.concatenate([[0], np.cumsum(counts)])
    packed = np.empty(start[-1], dtype=x.dtype), np.empty(start[-1], dtype=np.float32)
    on_cores(_pack, len(start) - 1, start, x, values, *packed)
    return counts, *packed


@numba.njit(cache=True, nogil=True)
def _pack(jobs: slice, start: Any, x: Any, values: Any, packed_x: Any, packed_values: Any) -> None:
    for row in range(jobs.start, jobs.stop):
        for i in range(start[row + 1] - start[row]):
            packed_x[start[row] + i] = x[row, i]
            packed_values[start[row] + i] = values[row, i]


@numba.njit(cache=True, nogil=True)
def _multiply_rows(
    jobs: slice,
    geometry: Any,
    images: Any,
    threshold: float,
    first: int,
    x: Any,
    values: Any,
    counts: Any,
) -> None:
    """Multiply rows, move survivors to the beginning, and count them in every row."""
    for block in range(jobs.start, jobs.stop):
        top, end = block * _ROWS, min((block + 1) * _ROWS, len(x))
        _multiply_block(
            geometry, images, threshold, first + top, x[top:end], values[top:end], counts[top:end]
        )


@inner_kernel()
def _multiply_block(
    geometry: Any, images: Any, threshold: float, first: int, x: Any, values: Any, counts: Any
) -> None:
    """Multiply rows of voxels by the images of one camera after the other."""
    work, product, views = scratch(geometry), np.ones(x.shape), np.zeros(x.shape, dtype=np.int32)
    for row in range(len(x)):
        counts[row] = geometry.width
        for i in range(geometry.width):
            x[row, i] = i
    for camera in range(len(images)):
        for row in range(len(x)):
            voxels = x[row], product[row], views[row]
            place = camera, first + row, counts[row]
            counts[row] = _multiply_camera(geometry, images[camera], threshold, place, work, voxels)
    for row in range(len(x)):
        counts[row] = _take_root(counts[row], x[row], product[row], views[row], values[row])


@inner_kernel()
def _multiply_camera(
    geometry: Any, image: Any, threshold: float, place: Any, work: Any, voxels: Any
) -> int:
    """Multiply one camera's samples, remove black voxels, and count the others."""
    (camera, row, left), (x, product, views) = place, voxels
    base, across, down = locate(geometry, camera, row, x[:left], work)
    written = 0
    for i in range(left):
        light, counts = np.float32(1.0), 0
        if base[i] >= 0:
            light, counts = sample_image(image, geometry.columns, base[i], across[i], down[i]), 1
        x[written], product[written], views[written] = x[i], product[i] * light, views[i] + counts
        # what comes next is written over what was black: cheaper than an unforeseeable branch
        written += int(light >= threshold)
    return written


@inner_kernel()
def _take_root(left: int, x: Any, product: Any, views: Any, values: Any) -> int:
    """Take the root of the product for voxels that any camera sees; count them."""
    written = 0
    for i in range(left):
        if views[i] > 0:
            x[written], values[written] = x[i], product[i] ** (1.0 / views[i])
            written += 1
    return written


# standard deviation of a blob against that of the particles' images: best Q of .6 to 1 (seeds from
# 100 on)
_BLOB = 0.75
_SIGMA_PX = (0.3, 0.8)  # what a footprint of four pixels holds


class TomographyParameters(Parameters):
    """Parameters of the algorithms on all voxels."""

    iterations: int = Field(
        10, ge=1, le=1000, description="how often all cameras correct the volume"
    )
    relaxation: float = Field(1.0, gt=0.0, le=1.0, description="mu of equation 3.9")
    tolerance: float = Field(
        0.0,
        ge=0.0,
        lt=1.0,
        description="stop when the residual |P - W I| changes by less than this fraction in an "
        "iteration",
    )
    footprint: Literal["gaussian", "bilinear"] = Field(
        "gaussian",
        description="a voxel's projection: of a Gaussian blob, or a share of four pixels",
    )
    sigma_px: float | None = Field(
        None,
        ge=_SIGMA_PX[0],
        le=_SIGMA_PX[1],
        description="standard deviation of the blobs; by default three quarters of the particle "
        "images'",
    )
    floor: float = Field(
        0.25,
        ge=0.0,
        lt=1.0,
        description="voxels darker than this fraction of a bright one become zero",
    )


class SparseParameters(TomographyParameters):
    """The same on the voxels that no camera sees black."""

    threshold: float = Field(
        0.1,
        gt=0.0,
        lt=1.0,
        description="darker pixels are black, as a fraction of a bright particle's peak",
    )


@dataclass(frozen=True)
class TomographyProblem:
    """A case as the algorithms take it.

    Attributes
    ----------
    measured : images as fractions of a bright particle's peak.
    grid, splits : the requested grid, and into how many fine voxels its voxels are split.
    sigma_mm : of the blobs; 0 for points.
    geometry, footprint : cameras and fine grid, and what a fine voxel casts.
    """

    measured: RecordedLight
    grid: Grid
    splits: supersampling.Splits
    sigma_mm: float
    geometry: KernelGeometry
    footprint: operators.Footprint

    @classmethod
    def from_case(cls, case: Observation, parameters: TomographyParameters) -> TomographyProblem:
        """Scale the images, split the grid's voxels where needed, choose the footprint."""
        light, unknown = case.normalised_images(), case.repaired.flaws.unknown
        scale = supersampling.scale_of(case.cameras, case.grid)
        splits, footprint, sigma_px = supersampling.splits(scale), operators.BILINEAR, 0.0
        if parameters.footprint == "gaussian":
            estimate = np.clip(_BLOB * (operators.image_sigma_px(light) or 0.0), *_SIGMA_PX)
            sigma_px = parameters.sigma_px or float(estimate)
            footprint = operators.gaussian(sigma_px)
        fine = supersampling.split(case.grid, splits)
        geometry = operators.make_geometry(case.cameras, fine, footprint.margin)
        measured = RecordedLight.of(light, case.images >= case.white_dn, unknown)
        return cls(measured, case.grid, splits, sigma_px / scale.px_per_mm, geometry, footprint)

    def mlos(self, threshold: float) -> Iterate:
        """Multiply lines of sight (MLOS): the cameras' bilinear samples."""
        return self._start(*product_guess(self.geometry, self.measured.possible(), threshold))

    def mfg(self, threshold: float) -> Iterate:
        """Make the multiplicative first guess (MFG): the cameras' nearest pixels."""
        nearest = self.geometry._replace(shift=0.5, mask=0)
        return self._start(*product_guess(nearest, self.measured.possible(), threshold))

    def uniform(self) -> Iterate:
        """Make all voxels equal, as bright as the images on average."""
        state = self._start(*every_voxel(self.geometry))
        projected = float(state.lines.forward(state.values).sum())
        state.values[:] *= self.measured.light.sum() / max(projected, 1e-30)
        return state

    def volume(self, state: Iterate, floor: float) -> F32:
        """Return the volume (z, y, x) on the requested grid."""
        light = state.lines.support, state.values
        volume = supersampling.gather(*light, self.grid, self.splits, self.sigma_mm)
        return supersampling.clear_dark(volume, floor)

    def blobs(self, state: Iterate) -> F32:
        """Return the volume (z, y, x) of the fine voxels' blobs on the fine grid."""
        fine = supersampling.split(self.grid, self.splits)
        light = state.lines.support, state.values
        return supersampling.gather(*light, fine, (1, 1, 1), self.sigma_mm)

    def _start(self, support: operators.Support, values: F32) -> Iterate:
        lines = operators.ProjectionOperator(self.geometry, support, self.footprint)
        coverage = np.rint(lines.adjoint(np.ones_like(self.measured.light)))
        values[coverage == 0.0] = 0.0
        unknown = self.measured.unknown()
        if unknown.any():
            coverage -= lines.adjoint(unknown.astype(np.float32))
        return Iterate(lines, values, np.maximum(coverage, np.float32(1.0)))
