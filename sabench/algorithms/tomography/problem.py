"""Parameters and prepared cases of the tomographic solvers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from sabench.algorithms.tomography import supersampling
from sabench.algorithms.tomography.art_updates import Iterate, RecordedLight
from sabench.algorithms.tomography.first_guess import every_voxel, product_guess
from sabench.algorithms.tomography.footprint import BILINEAR, Footprint, gaussian, image_sigma_px
from sabench.algorithms.tomography.kernels import KernelGeometry
from sabench.algorithms.tomography.projection_operator import (
    ProjectionOperator,
    Support,
    make_geometry,
)
from sabench.api import Observation, Parameters
from sabench.geometry.grid import Grid
from sabench.utils.arrays import F32

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
    grid, splits : the grid that is asked for, and into how many fine voxels its voxels are split.
    sigma_mm : of the blobs; 0 for points.
    geometry, footprint : cameras and fine grid, and what a fine voxel casts.
    """

    measured: RecordedLight
    grid: Grid
    splits: supersampling.Splits
    sigma_mm: float
    geometry: KernelGeometry
    footprint: Footprint

    @classmethod
    def from_case(cls, case: Observation, parameters: TomographyParameters) -> TomographyProblem:
        """Scale the images, split the grid's voxels where needed, choose the footprint."""
        light, unknown = case.normalised_images(), case.repaired.flaws.unknown
        scale = supersampling.scale_of(case.cameras, case.grid)
        splits, (footprint, sigma_px) = supersampling.splits(scale), _footprint(light, parameters)
        geometry = make_geometry(
            case.cameras, supersampling.split(case.grid, splits), footprint.margin
        )
        measured = RecordedLight.of(light, case.images >= case.white_dn, unknown)
        return cls(measured, case.grid, splits, sigma_px / scale.px_per_mm, geometry, footprint)

    def mlos(self, threshold: float) -> Iterate:
        """Multiply lines of sight (MLOS): the cameras' bilinear samples."""
        return self._start(*product_guess(self.geometry, self.measured.possible(), threshold))

    def mfg(self, threshold: float) -> Iterate:
        """Make the multiplicative first guess (MFG): the cameras' nearest pixels."""
        return self._start(
            *product_guess(
                self.geometry._replace(shift=0.5, mask=0), self.measured.possible(), threshold
            )
        )

    def uniform(self) -> Iterate:
        """Make all voxels alike, as bright as the images on the mean."""
        state = self._start(*every_voxel(self.geometry))
        state.values[:] *= self.measured.light.sum() / max(
            float(state.lines.forward(state.values).sum()), 1e-30
        )
        return state

    def volume(self, state: Iterate, floor: float) -> F32:
        """Return the volume (z, y, x) on the grid that was asked for."""
        return supersampling.clear_dark(
            supersampling.gather(
                state.lines.support, state.values, self.grid, self.splits, self.sigma_mm
            ),
            floor,
        )

    def blobs(self, state: Iterate) -> F32:
        """Return the volume (z, y, x) of the fine voxels' blobs on the fine grid."""
        fine = supersampling.split(self.grid, self.splits)
        return supersampling.gather(
            state.lines.support, state.values, fine, (1, 1, 1), self.sigma_mm
        )

    def _start(self, support: Support, values: F32) -> Iterate:
        lines = ProjectionOperator(self.geometry, support, self.footprint)
        seen = np.rint(lines.adjoint(np.ones_like(self.measured.light)))
        values[seen == 0.0] = 0.0
        unknown = self.measured.unknown()
        if unknown.any():
            seen -= lines.adjoint(unknown.astype(np.float32))
        return Iterate(lines, values, np.maximum(seen, np.float32(1.0)))


def _footprint(light: F32, parameters: TomographyParameters) -> tuple[Footprint, float]:
    if parameters.footprint == "bilinear":
        return BILINEAR, 0.0
    sigma = parameters.sigma_px or float(
        np.clip(_BLOB * (image_sigma_px(light) or 0.0), *_SIGMA_PX)
    )
    return gaussian(sigma), sigma
